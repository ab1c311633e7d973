"""Names and rates of the demo's topics, and short descriptions of messages.

The message classes of rclpy and of rosbags have the same fields.
"""

from __future__ import annotations

import math
import zlib
from typing import Any

SCAN, ODOM, TF, TF_STATIC, MAP, IMAGE = "/scan", "/odom", "/tf", "/tf_static", "/map", "/camera/image_raw"
CMD_VEL = "/cmd_vel"
FROM_ROS1, FROM_ROS2 = "/hello/from_ros1", "/hello/from_ros2"
FROM_ZENOH, FROM_YARP = "/hello/from_zenoh", "/hello/from_yarp"
"""On each of these topics, one program publishes a greeting periodically, and all four programs subscribe."""

HELLOS = (FROM_ROS1, FROM_ROS2, FROM_ZENOH, FROM_YARP)

BASE_RATE, SCAN_RATE, IMAGE_RATE, HELLO_RATE, DRIVE_RATE = 20.0, 10.0, 5.0, 2.0, 10.0
"""Messages per second; BASE_RATE is the rate of odometry and tf."""

BEAMS = 360
STATIC_FRAMES = ("camera", "laser", "odom")
"""Child frames on /tf_static, sorted."""


def stamp(message: Any) -> tuple[int, int]:
    """Return the stamp, which distinguishes messages."""
    return message.header.stamp.sec, message.header.stamp.nanosec


def first_stamp(message: Any) -> tuple[int, int, str]:
    """Return the first transform's stamp and child frame, which distinguish messages of transforms."""
    first = message.transforms[0]
    return first.header.stamp.sec, first.header.stamp.nanosec, first.child_frame_id


def text(message: Any) -> str:
    """Return a string's content."""
    return str(message.data)


def scan(message: Any) -> str:
    """Describe a laser scan."""
    return f"{len(message.ranges)} ranges, nearest {min(message.ranges):.2f} m"


def frames(message: Any) -> str:
    """Describe transforms."""
    return ", ".join(f"{t.header.frame_id} to {t.child_frame_id}" for t in message.transforms)


def image(message: Any) -> str:
    """Describe an image."""
    return f"{message.width} x {message.height} {message.encoding}, {len(message.data)} bytes"


def grid(message: Any) -> str:
    """Describe a map, with a checksum of all its cells."""
    return grid_text(message.info.width, message.info.height, message.data.tobytes())


def grid_text(width: int, height: int, cells: bytes) -> str:
    """Describe a map by its size and cells."""
    return f"{width} x {height} cells, CRC {zlib.crc32(cells):08x}"


def pose(message: Any) -> list[float]:
    """Return x, y in meters and yaw in radians of an odometry message."""
    at = message.pose.pose
    return [at.position.x, at.position.y, 2 * math.atan2(at.orientation.z, at.orientation.w)]


def position(message: Any) -> str:
    """Describe an odometry message."""
    at = message.pose.pose.position
    return f"at {at.x:.2f}, {at.y:.2f} m"
