"""One type's way from the hub to a YARP port and back, whatever the port carries."""

from __future__ import annotations

import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

from bridge.messages.definition import Schema
from bridge.messages.values import HEADER
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile

_STAMP = struct.Struct("<iI")
_HEADERS = ("std_msgs/msg/Header",)

Check = Callable[[bytes], bytes]
"""Checks CDR against its type; see `bridge.messages.registry.Registry.hub_check`."""


class Outgoing(NamedTuple):
    """A message for a port.

    Attributes:
        payload: its bytes in pieces.
        stamp_ns: the message's own time, None where its type has none; it travels as the envelope.
    """

    payload: list[Buffer]
    stamp_ns: int | None


class Codec(ABC):
    """Converts messages of one type in one content and profile. Methods may be called from any thread.

    Attributes:
        now_ns: the time of a message that comes without one, where its ROS type has one.
    """

    now_ns: Callable[[], int] = staticmethod(time.time_ns)

    @abstractmethod
    def to_yarp(self, cdr: bytes) -> Outgoing:
        """A hub message, which was checked against its type, for a port; raises `ConversionError`."""

    @abstractmethod
    def to_hub(self, payload: Buffer, profile: Profile | None, stamp_ns: int | None) -> bytes:
        """A port's message for the hub.

        Args:
            payload: as it came.
            profile: the sender's, None where the bytes must tell.
            stamp_ns: time in its envelope, None where it has none.

        Raises:
            ConversionError: it is no such message; says what is wrong and where.
        """


def is_stamped(schema: Schema) -> bool:
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
