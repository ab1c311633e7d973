"""The transforms of tf2_msgs/msg/TFMessage, which is read and written directly in CDR.

A robot publishes hundreds of transforms a hundred times a second. Each consists of its stamp (two 32-bit integers), the
names of parent and child (a length that includes the trailing zero, and the text), then seven doubles, aligned to 8
bytes after the encapsulation header.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

from bridge.tf import message
from bridge.tf.transform import Quaternion, Vector

TF_TYPE = "tf2_msgs/msg/TFMessage"
TF, TF_STATIC = "/tf", "/tf_static"

_ENCAPSULATION = b"\0\1\0\0"
_START = len(_ENCAPSULATION)
_SECOND = 1_000_000_000
_COUNT = struct.Struct("<I")
_STAMP = struct.Struct("<iII")
_POSE = struct.Struct("<7d")


class Stamped(NamedTuple):
    """A transform in a message: the pose of the child frame in its parent."""

    frame_id: str
    child_frame_id: str
    stamp: int  #: ns
    translation: Vector  #: x, y, z in m
    rotation: Quaternion  #: x, y, z, w


def read(cdr: bytes) -> list[Stamped]:
    """Return the transforms of a message; raises `ValueError` if the bytes are not a TFMessage."""
    transforms = []
    for stamp, names, at in message.read(cdr):
        x, y, z, qx, qy, qz, qw = _POSE.unpack_from(cdr, at)
        transforms.append(Stamped(*message.split_names(names), stamp, (x, y, z), (qx, qy, qz, qw)))
    return transforms


def write(transforms: Iterable[Stamped]) -> bytes:
    """Return transforms as a message; raises `ValueError` if a name is not valid Unicode, or a stamp out of range."""
    data = bytearray(_START + _COUNT.size)
    count = 0
    for parent, child, stamp, moved, turned in transforms:
        seconds, nanoseconds = divmod(stamp, _SECOND)
        parent_bytes, child_bytes = parent.encode(), child.encode()
        data += bytes(-len(data) % 4)
        try:
            data += _STAMP.pack(seconds, nanoseconds, len(parent_bytes) + 1)
        except struct.error as err:
            raise ValueError(f"the stamp {stamp} of {child!r} does not fit a message: {err}") from None
        data += parent_bytes
        data += bytes(1 + -(len(data) + 1) % 4)
        data += _COUNT.pack(len(child_bytes) + 1)
        data += child_bytes
        data += bytes(1 + (_START - len(data) - 1) % 8)
        data += _POSE.pack(*moved, *turned)
        count += 1
    data[:_START] = _ENCAPSULATION
    _COUNT.pack_into(data, _START, count)
    return bytes(data)
