"""Bags: files of recorded messages, in the formats of ROS 1, rosbag2 and MCAP."""
