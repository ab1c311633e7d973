"""Which types of ROS 1 and ROS 2 are counterparts."""
