"""The ROS 1 graph: the master, our registrations there, and the other nodes."""
