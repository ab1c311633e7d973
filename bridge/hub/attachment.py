"""The attachment that rmw_zenoh puts on each sample: sequence number, source time, GID.

33 bytes since Jazzy's 0.2.4: int64 and int64 in little endian, then the GID as zenoh's serialisation writes an array:
its length (16) in one byte, and the bytes (rmw_zenoh_cpp, attachment_helpers.cpp).
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from bridge.hub.errors import WireError

GID_SIZE = 16
_LAYOUT = struct.Struct(f"<qqB{GID_SIZE}s")
SIZE = _LAYOUT.size
"""Bytes of an attachment."""


class Attachment(NamedTuple):
    """What a sample tells of itself.

    Attributes:
        sequence: per publisher, 1 for its first sample.
        source_time_ns: system time of the source in nanoseconds since 1970.
        gid: 16 bytes that name the publisher.
    """

    sequence: int
    source_time_ns: int
    gid: bytes


def pack(sequence: int, source_time_ns: int, gid: bytes) -> bytes:
    """The attachment's bytes."""
    return _LAYOUT.pack(sequence, source_time_ns, GID_SIZE, gid)


def unpack(data: bytes) -> Attachment:
    """Read an attachment; raises `WireError` where it is not rmw_zenoh's."""
    if len(data) != SIZE:
        msg = f"attachment of {len(data)} bytes instead of {SIZE}; rmw_zenoh before Jazzy's 0.2.4 wrote another form"
        raise WireError(msg)
    sequence, time_ns, size, gid = _LAYOUT.unpack(data)
    if size != GID_SIZE:
        msg = f"attachment with a GID of {size} bytes instead of {GID_SIZE}"
        raise WireError(msg)
    return Attachment(sequence, time_ns, gid)
