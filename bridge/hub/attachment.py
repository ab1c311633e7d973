"""The attachment that rmw_zenoh puts on each sample: sequence number, source time, GID.

33 bytes since Jazzy's 0.2.4: int64 and int64 in little endian, then the GID as zenoh's serialisation writes an array:
its length (16) in one byte, and the bytes (rmw_zenoh_cpp, attachment_helpers.cpp).
"""

from __future__ import annotations

import struct

from bridge.hub.errors import WireError

GID_SIZE = 16
_LAYOUT = struct.Struct(f"<qqB{GID_SIZE}s")
SIZE = _LAYOUT.size
"""Bytes of an attachment."""


def pack(sequence: int, source_time_ns: int, gid: bytes) -> bytes:
    """The attachment's bytes."""
    return _LAYOUT.pack(sequence, source_time_ns, GID_SIZE, gid)


def unpack(data: bytes) -> tuple[int, int, bytes]:
    """Read an attachment; raises `WireError` where it is not rmw_zenoh's.

    Returns:
        The sample's number (per publisher, 1 for its first), the system time of its source in nanoseconds since 1970,
        and the 16 bytes that name its publisher.
    """
    if len(data) != SIZE:
        msg = f"attachment of {len(data)} bytes instead of {SIZE}; rmw_zenoh before Jazzy's 0.2.4 wrote another form"
        raise WireError(msg)
    sequence, time_ns, size, gid = _LAYOUT.unpack(data)
    if size != GID_SIZE:
        msg = f"attachment with a GID of {size} bytes instead of {GID_SIZE}"
        raise WireError(msg)
    return sequence, time_ns, gid
