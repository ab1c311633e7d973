"""The ROS 2 types of velocity commands: since Kilted, Nav2 publishes stamped ones by default."""

import re
import struct

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
VELOCITIES = (TWIST, TWIST_STAMPED)

_ROS1_NAMES = tuple(name.replace("/msg/", "/") for name in VELOCITIES)
_VELOCITY = 48
"""Size in bytes of the six float64 at the end of these messages, as CDR and as in ROS 1."""


_VALUES = struct.Struct("<6d")

COMMAND_NAME = re.compile(r"(^|[/_])(cmd|command)", re.IGNORECASE)
"""Topic names that imply a velocity command."""


def is_velocity(type_name: str) -> bool:
    """Return whether a type, by its name in ROS 2 or ROS 1, is that of velocities."""
    return type_name in VELOCITIES or type_name in _ROS1_NAMES


def is_zero(type_name: str, payload: bytes) -> bool:
    """Return whether a message (CDR, or ROS 1 bytes) is a velocity of zero, which stops a base however late it is."""
    return is_velocity(type_name) and len(payload) >= _VELOCITY and not any(_VALUES.unpack(payload[-_VELOCITY:]))


def stop_after(type_name: str, payload: bytes) -> bytes:
    """Return a command (CDR, or ROS 1 bytes) with its velocity set to zero; "" if the type is not a velocity."""
    return payload[:-_VELOCITY] + bytes(_VELOCITY) if is_velocity(type_name) else b""
