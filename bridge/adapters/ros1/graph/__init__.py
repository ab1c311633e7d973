"""The ROS 1 graph: the master, Midspan's registrations, and the other nodes."""
