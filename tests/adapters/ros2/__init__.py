"""Tests of the ROS 2 edge with real rclpy programs over Fast DDS."""
