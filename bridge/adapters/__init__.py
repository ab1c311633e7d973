"""The edges: one package per side, which alone imports the side's middleware; also the XML-RPC client for ROS 1."""
