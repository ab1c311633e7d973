"""The edges: one package per side, the only one that uses that side's middleware; and the client of ROS 1 peers."""
