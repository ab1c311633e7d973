"""Which types of ROS 1 and ROS 2 stand for each other."""
