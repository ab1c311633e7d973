"""The interface builder: definitions are checked, and packages are built and used by real ROS 2 programs."""
