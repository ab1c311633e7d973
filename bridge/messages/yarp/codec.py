"""What every converter between the hub and YARP's ports has: its interface, and the message's time and header."""

from __future__ import annotations

import math
import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from bridge.messages.definitions.schema import Schema
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
    stamp_ns: int | None  #: the message's own time, None where its type has none; it travels as the envelope


class Codec(ABC):
    """Converts messages of one type in one content and profile. Methods may be called from any thread."""

    # the time of a message that comes without one, where its ROS type has one
    now_ns: Callable[[], int] = staticmethod(time.time_ns)

    @abstractmethod
    def to_yarp(self, cdr: bytes) -> EncodedMessage:
        """A hub message, which was checked against its type, for a port; raises `ConversionError`."""

    @abstractmethod
    def to_hub(self, payload: Buffer, profile: Profile | None, stamp_ns: int | None) -> bytes:
        """A port's message for the hub; raises `ConversionError`, which says what is wrong and where.

        The sender's profile is None where the bytes must show it; ``stamp_ns`` is the time in the envelope.
        """


def has_header(schema: Schema) -> bool:
    """Whether messages of a ROS 2 type begin with a header."""
    return bool(schema.root.fields) and schema.root.fields[0].type.base in _HEADERS


def stamp_of(cdr: bytes) -> int:
    """The time in the header that a message begins with, in nanoseconds."""
    seconds, rest = _STAMP.unpack_from(cdr, len(HEADER))
    return int(seconds) * 1_000_000_000 + int(rest)


def with_stamp(cdr: bytes, stamp_ns: int | None) -> bytes:
    """The message with this time in its header, where that has none yet."""
    if stamp_ns is None or stamp_of(cdr):
        return cdr
    begin = len(HEADER)
    return cdr[:begin] + _STAMP.pack(*split_time(stamp_ns)) + cdr[begin + _STAMP.size :]


def split_time(stamp_ns: int) -> tuple[int, int]:
    """Seconds and nanoseconds, as far as ROS can say them."""
    seconds, rest = divmod(max(stamp_ns, 0), 1_000_000_000)
    return min(seconds, 2**31 - 1), rest


Message = dict[str, Any]  # a ROS message as `bridge.messages.values` has it


@dataclass(frozen=True, slots=True)
class Missing:
    """What YARP's types do not say and ROS's need."""

    frame: str = ""  #: the header's frame, "" for the type's own default
    child_frame: str = ""  #: an odometry's frame of the robot, "" for its default
    joints: tuple[str, ...] = field(default=())  #: names of the joints, in the order of the numbers


class NaturalType(Protocol):
    """One pair. Both methods may raise `ConversionError`, and `to_ros` what a `Reader` raises."""

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        """Write the YARP type."""

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:
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
