"""Names and rates of the demo's topics; standard library only."""

from __future__ import annotations

SCAN, ODOM, TF, TF_STATIC, MAP, IMAGE = "/scan", "/odom", "/tf", "/tf_static", "/map", "/camera/image_raw"
CMD_VEL = "/cmd_vel"
FROM_ROS1, FROM_ROS2 = "/hello/from_ros1", "/hello/from_ros2"
FROM_ZENOH, FROM_YARP = "/hello/from_zenoh", "/hello/from_yarp"
"""On each of these one program says something once in a while, and the others listen."""

HELLOS = (FROM_ROS1, FROM_ROS2, FROM_ZENOH, FROM_YARP)

BASE_RATE, SCAN_RATE, IMAGE_RATE, HELLO_RATE, DRIVE_RATE = 20.0, 10.0, 5.0, 2.0, 10.0
"""Messages per second; BASE_RATE is that of odometry and tf."""

BEAMS = 360
STATIC_FRAMES = ("camera", "laser", "odom")
"""Child frames on /tf_static, sorted."""
