"""The messages whose contents the bridge changes: static transforms, and initial poses for a localizer.

ROS 1 latches one message per publisher, and tf2's Python broadcaster does not repeat its earlier transforms. This
module therefore stores the static transforms of a topic by child frame, and sends all of them in one message. Such a
topic is recognized by its type and by being latched.

With a covariance of zeros, amcl places all particles on one point and cannot correct its error (amcl 1.17.3 then had a
variance of 1e-12). Programs that set only the pose send such a covariance, so it is replaced by the covariance that
rviz sends. This applies only to messages that leave the hub: Midspan's own localizer, which subscribes on the hub, has
a setting for such initial poses.
"""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from typing import NamedTuple

from bridge.messages.transcode.conversion import Conversion

TF_TYPE = "tf2_msgs/msg/TFMessage"
MAX_FRAMES = 100_000


_ENCAPSULATION = {b"\0\0": ">", b"\0\1": "<"}
"""The byte order, in the notation of Python's `struct`, for the first two bytes of a CDR message."""

_LITTLE = b"\0\1\0\0"


class StaticTransforms:
    """The static transforms of one topic, by child frame; a frame's newest transform wins."""

    def __init__(self) -> None:
        self._by_child: dict[bytes, _Transform] = {}

    def __len__(self) -> int:
        return len(self._by_child)

    def merge(self, cdr: bytes) -> bytes:
        """Merge a TFMessage (CDR), and return a TFMessage with all transforms.

        Raises `ValueError` if the message is invalid or there are more than `MAX_FRAMES` frames.
        """
        try:
            transforms = _transforms(cdr)
        except (ValueError, struct.error) as err:
            raise ValueError(f"not a {TF_TYPE}: {err}") from err
        merged = self._by_child | {transform.child: transform for transform in transforms}
        if len(merged) > MAX_FRAMES:  # later messages with known frames must still be merged
            raise ValueError(f"more than {MAX_FRAMES} static frames")
        self._by_child = merged
        parts = bytearray(struct.pack("<I", len(self._by_child)))
        for transform in self._by_child.values():
            transform.write(parts)
        return _LITTLE + parts


class _Transform(NamedTuple):
    """A geometry_msgs/TransformStamped: stamp (s, ns), frame names with their terminating NUL, seven numbers."""

    stamp: tuple[int, int]
    frame: bytes
    child: bytes
    numbers: tuple[float, ...]

    def write(self, parts: bytearray) -> None:
        parts += bytes(-len(parts) % 4) + struct.pack("<iI", *self.stamp)
        for text in (self.frame, self.child):
            parts += bytes(-len(parts) % 4) + struct.pack("<I", len(text)) + text
        parts += bytes(-len(parts) % 8) + struct.pack("<7d", *self.numbers)


def _transforms(cdr: bytes) -> list[_Transform]:
    """Return the transforms of a TFMessage; raises `ValueError` or `struct.error` for invalid bytes."""
    order = _ENCAPSULATION.get(cdr[:2])
    if order is None:
        raise ValueError("it does not begin with a CDR header")
    data, at = memoryview(cdr)[len(_LITTLE) :], 4
    (count,) = struct.unpack_from(f"{order}I", data)

    def text() -> bytes:
        nonlocal at
        at += -at % 4
        (length,) = struct.unpack_from(f"{order}I", data, at)
        at += 4 + length
        if at > len(data):
            raise ValueError("a frame's name is longer than the message")
        raw = bytes(data[at - length : at])
        if raw[-1:] != b"\0":
            raise ValueError("a frame's name has no closing NUL")
        str(raw, "utf-8")  # raises UnicodeDecodeError, which is a ValueError
        return raw

    transforms = []
    for _ in range(count):
        at += -at % 4
        seconds, nanoseconds = struct.unpack_from(f"{order}iI", data, at)
        at += 8
        frame, child = text(), text()
        at += -at % 8
        transforms.append(_Transform((seconds, nanoseconds), frame, child, struct.unpack_from(f"{order}7d", data, at)))
        at += 56
    if len(data) - at > 3:  # up to three bytes of padding are allowed
        raise ValueError(f"{len(data) - at} bytes are left over")
    return transforms


POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TOPIC = "initialpose"
"""Last part of the topic's name in amcl, Nav2 and rviz."""

SPREAD = (0.5, math.radians(15.0))
"""Standard deviations in x and y (m) and in yaw (rad), as in rviz (rviz 1.14, initial_pose_tool.cpp)."""

_ROWS = 36
_NONE = struct.pack(f"<{_ROWS}d", *[0.0] * _ROWS)
_GIVEN = struct.pack(
    f"<{_ROWS}d", *(SPREAD[0] ** 2 if n in (0, 7) else SPREAD[1] ** 2 if n == _ROWS - 1 else 0.0 for n in range(_ROWS))
)
_AFTER_FRAME = 7 * 8
"""Bytes of the pose, between the header and the covariance."""


def with_spread(conversion: Conversion, hub_topic: str) -> Conversion:
    """Return ``conversion``; for initial poses, extended so that it replaces a covariance of zeros."""
    if conversion.source.name != POSE_TYPE or hub_topic.rpartition("/")[2] != TOPIC:
        return conversion
    then = conversion.convert
    return replace(conversion, convert=filled_in if then is None else lambda cdr: then(filled_in(cdr)))


def filled_in(cdr: bytes) -> bytes:
    """Return the message (CDR, little-endian), with `SPREAD` as its covariance if that is all zeros."""
    begin = _covariance(cdr)
    end = begin + len(_NONE)
    return cdr[:begin] + _GIVEN + cdr[end:] if begin and cdr[begin:end] == _NONE else cdr


def _covariance(cdr: bytes) -> int:
    """Return the offset of the covariance; 0 if the message is too short, which its converter reports."""
    if len(cdr) < 16:
        return 0
    frame = int.from_bytes(cdr[12:16], "little")  # after the encapsulation (4) and the stamp (8)
    return 4 + (12 + frame + 7) // 8 * 8 + _AFTER_FRAME  # aligned relative to the end of the encapsulation
