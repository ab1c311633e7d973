"""The interface of the converters between the hub and YARP's ports, and helpers for stamps and headers."""

from __future__ import annotations

import math
import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from bridge.messages.definitions.schema import Schema, Shape
from bridge.messages.values import HEADER
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile

_STAMP = struct.Struct("<iI")
_HEADERS = ("std_msgs/msg/Header",)

Check = Callable[[bytes], bytes]  # checks CDR against its type; see `bridge.messages.registry.Registry.hub_check`


class EncodedMessage(NamedTuple):
    """A message for a port."""

    payload: list[Buffer]
    stamp_ns: int | None  #: the message's stamp, to be sent as the envelope; None if it is zero or its type has none


class Codec(ABC):
    """Converts messages of one ROS type to and from one content of a port (such as a Bottle).

    A codec writes one YARP dialect (`Profile`). Methods may be called from any thread.
    """

    # returns the time with which to stamp a message that has no stamp, if its ROS type needs one
    now_ns: Callable[[], int] = staticmethod(time.time_ns)

    @abstractmethod
    def to_yarp(self, cdr: bytes) -> EncodedMessage:
        """Convert a hub message, checked against its type, for a port; raises `ConversionError`."""

    @abstractmethod
    def to_hub(self, payload: Buffer, profile: Profile | None, stamp_ns: int | None) -> bytes:
        """Convert a port's message for the hub; raises `ConversionError`, which names the fault and the field.

        The sender's profile is None if it must be recognized from the bytes; ``stamp_ns`` is the time in the envelope.
        """


def has_header(schema: Schema) -> bool:
    """Return whether messages of a ROS 2 type begin with a header; a list of headers does not count."""
    first = schema.root.fields[0].type if schema.root.fields else None
    return first is not None and first.base in _HEADERS and first.shape is Shape.SINGLE


def stamp_of(cdr: bytes) -> int:
    """Return the stamp of the header that a message begins with, in nanoseconds."""
    seconds, nanoseconds = _STAMP.unpack_from(cdr, len(HEADER))
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def with_stamp(cdr: bytes, stamp_ns: int | None) -> bytes:
    """Return the message with this stamp in its header, unless the header has one."""
    if stamp_ns is None or stamp_of(cdr):
        return cdr
    begin = len(HEADER)
    return cdr[:begin] + _STAMP.pack(*split_time(stamp_ns)) + cdr[begin + _STAMP.size :]


def split_time(stamp_ns: int) -> tuple[int, int]:
    """Return seconds and nanoseconds, within the range of ROS."""
    seconds, nanoseconds = divmod(max(stamp_ns, 0), 1_000_000_000)
    return min(seconds, 2**31 - 1), nanoseconds


Message = dict[str, Any]  # a ROS message as `bridge.messages.values` represents it


@dataclass(frozen=True, slots=True)
class Missing:
    """Values that ROS's types need and YARP's lack."""

    frame: str = ""  #: the header's frame; "" for the type's own default
    child_frame: str = ""  #: the robot's frame in odometry; "" for the default
    joints: tuple[str, ...] = field(default=())  #: names of the joints, in the order of their positions


class NaturalType(Protocol):
    """Converts between a YARP type and the ROS type with the same meaning.

    Both methods may raise `ConversionError`; `to_ros` also raises the errors of an `ElementReader`.
    """

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        """Write the YARP type."""

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
        """Read a value of the YARP type; ``stamp_ns`` is the time in the envelope, or else the current time."""


def header(stamp_ns: int, frame: str) -> Message:
    """Return a header."""
    seconds, nanoseconds = split_time(stamp_ns)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def heading(orientation: Mapping[str, float]) -> float:
    """Return a quaternion's yaw in degrees."""
    x, y, z, w = (orientation[name] for name in "xyzw")
    return math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def yaw_quaternion(degrees: float) -> Message:
    """Return the quaternion of a yaw in degrees."""
    half = math.radians(degrees) / 2
    return {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
