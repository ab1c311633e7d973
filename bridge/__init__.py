"""Midspan's bridge daemon: joins ROS 1, ROS 2, YARP and zenoh networks of mobile robots."""

__version__ = "0.1.0"
