"""Tests of the ROS 1 edge with a real roscore and real rospy programs."""
