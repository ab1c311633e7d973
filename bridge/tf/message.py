"""Transforms straight from the bytes of a ``tf2_msgs/msg/TFMessage``, without a Python object for each part of it."""

from __future__ import annotations

from pathlib import Path

import numba
import numpy as np

from bridge.messages.cache import compiled, entry_point
from bridge.messages.memory import HEAD, load8, load32, load64, store64
from bridge.tf.layout import POSE
from bridge.tf.rotation import jit

_WORD = numba.int64
_HEADER = 4
_LITTLE_ENDIAN = b"\0\1"
_SPAN = 5
_FIRST_ROOM = 256


Span = list[int]
"""One transform: its stamp in ns, and where its names begin and end in the message: parent, child."""


@jit
def _string(source: int, at: int, size: int) -> tuple[int, int]:
    """Where a string begins and how many bytes it has with its NUL; -1 where the message ends before."""
    at = (at + 3) & ~3
    if at + 4 > size:
        return -1, 0
    length = load32(source + at)
    if length > size - at - 4 or (length > 0 and load8(source + at + 3 + length) != 0):
        return -1, 0
    return at + 4, length


def _read(source: int, size: int, spans: int, poses: int, room: int) -> int:
    """Take a message apart.

    Args:
        source: address of what follows the encapsulation header.
        size: its bytes.
        spans: address of ``room`` spans of 5 int64.
        poses: address of ``room`` poses of 7 float64.
        room: transforms that are written at most.

    Returns:
        How many transforms there are; -1 where it is no whole message.
    """
    if size < 4:
        return -1
    count = load32(source)
    at = 4
    for n in range(count):
        at = (at + 3) & ~3
        if at + 8 > size:
            return -1
        seconds, nanoseconds = load32(source + at), load32(source + at + 4)
        if seconds >= 1 << 31:
            seconds -= 1 << 32
        parent, parent_length = _string(source, at + 8, size)
        if parent < 0:
            return -1
        child, child_length = _string(source, parent + parent_length, size)
        if child < 0:
            return -1
        at = (child + child_length + 7) & ~7
        if at + 8 * POSE > size:
            return -1
        if n < room:
            span = spans + 8 * _SPAN * n
            store64(span, seconds * 1_000_000_000 + nanoseconds)
            store64(span + 8, _HEADER + parent)
            store64(span + 16, _HEADER + parent + max(parent_length - 1, 0))
            store64(span + 24, _HEADER + child)
            store64(span + 32, _HEADER + child + max(child_length - 1, 0))
            for k in range(POSE):
                store64(poses + 8 * (POSE * n + k), load64(source + at + 8 * k))
        at += 8 * POSE
    return count


_SIGNATURE = _WORD(*[_WORD] * 5)
_FILES = ("message.py", "layout.py", "rotation.py", "../messages/memory.py")
_SOURCES = [Path(__file__).parent / name for name in _FILES]
_read_compiled = entry_point(compiled(_read, _SIGNATURE, _SOURCES), _SIGNATURE)


class MessageReader:
    """Takes messages apart, one at a time.

    Attributes:
        poses: (x, y, z, qx, qy, qz, qw) of each transform of the last message.
        address: of the poses.
    """

    def __init__(self) -> None:
        self._make_room(_FIRST_ROOM)

    def _make_room(self, count: int) -> None:
        self._room = count
        self._spans = np.empty((count, _SPAN), np.int64)
        self.poses = np.empty((count, POSE), np.float64)
        self._at_spans, self.address = self._spans.ctypes.data, self.poses.ctypes.data

    def read(self, cdr: bytes) -> list[Span]:
        """Take a message apart; its poses are kept until the next.

        Args:
            cdr: with its encapsulation header.

        Raises:
            ValueError: the bytes are no such message.
        """
        found = -1
        if cdr[:2] == _LITTLE_ENDIAN:
            found = self._read(cdr)
            if found > self._room:
                self._make_room(2 * found)
                found = self._read(cdr)
        if found < 0:
            msg = f"{len(cdr)} bytes that are no tf2_msgs/msg/TFMessage (CDR, little-endian)"
            raise ValueError(msg)
        spans: list[Span] = self._spans[:found].tolist()
        return spans

    def _read(self, cdr: bytes) -> int:
        source = id(cdr) + HEAD + _HEADER
        found: int = _read_compiled(source, len(cdr) - _HEADER, self._at_spans, self.address, self._room)
        return found
