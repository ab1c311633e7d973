"""ROS 1: the master, rospy programs, and the adapter in its own process."""
