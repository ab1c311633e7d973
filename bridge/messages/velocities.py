"""The ROS 2 types of velocity commands: since Kilted, Nav2 publishes stamped ones by default."""

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
VELOCITIES = (TWIST, TWIST_STAMPED)

_ROS1_NAMES = tuple(name.replace("/msg/", "/") for name in VELOCITIES)
_VELOCITY = 48
"""Size in bytes of the six float64 at the end of these messages, as CDR and as in ROS 1."""


def stop_after(type_name: str, payload: bytes) -> bytes:
    """Return a command (CDR, or ROS 1 bytes) with its velocity set to zero; "" if the type is not a velocity."""
    is_velocity = type_name in VELOCITIES or type_name in _ROS1_NAMES
    return payload[:-_VELOCITY] + bytes(_VELOCITY) if is_velocity else b""
