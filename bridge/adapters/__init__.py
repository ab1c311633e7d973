"""The edges, one package per side, so that a worker loads the code of its side only; and ROS 1's XML-RPC client."""
