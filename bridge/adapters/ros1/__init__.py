"""The ROS 1 side: rospy. Nothing outside this package imports rospy."""
