"""The edges, one package per side, so that only a side's worker loads its middleware; and ROS 1's XML-RPC client."""
