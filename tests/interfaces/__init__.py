"""The interface builder: definitions checked, packages built, and used by real ROS 2 programs."""
