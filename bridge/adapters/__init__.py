"""Edges: one package per side, the only one that imports the side's middleware; also the XML-RPC client for ROS 1."""
