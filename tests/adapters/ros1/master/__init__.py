"""Tests of the embedded ROS 1 master."""
