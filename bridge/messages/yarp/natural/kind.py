"""What each pair of a ROS message and a YARP type says of itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from bridge.messages.yarp.codec import split_time
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer

Message = dict[str, Any]
"""A ROS message as `bridge.messages.values` has it."""


@dataclass(frozen=True, slots=True)
class Missing:
    """What YARP's types do not say and ROS's need.

    Attributes:
        frame: the header's frame, "" for the type's own default.
        child_frame: an odometry's frame of the robot, "" for its default.
        joints: names of the joints, in the order of the numbers.
    """

    frame: str = ""
    child_frame: str = ""
    joints: tuple[str, ...] = field(default=())


class Kind(Protocol):
    """One pair. Both methods may raise `ConversionError`, and `to_ros` what a `Reader` raises."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        """Write the YARP type."""

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        """Read the YARP type that comes next; ``stamp_ns`` is the time of its envelope, else the present."""


def header(stamp_ns: int, frame: str) -> Message:
    """A header."""
    seconds, rest = split_time(stamp_ns)
    return {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": frame}


def heading(orientation: Mapping[str, float]) -> float:
    """The angle about the vertical of a quaternion, in degrees."""
    x, y, z, w = (orientation[name] for name in "xyzw")
    return math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def turned(degrees: float) -> Message:
    """The quaternion of an angle about the vertical."""
    half = math.radians(degrees) / 2
    return {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
