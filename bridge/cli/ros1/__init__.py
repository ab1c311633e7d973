"""Commands for ROS 1."""
