"""The edges, one package per side, so that a worker loads only its own side's code; and ROS 1's XML-RPC client."""
