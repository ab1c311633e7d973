"""Verbs for ROS 1."""
