"""Time stamps inside prepared messages; standard library only, because ROS 1 programs run on the system's Python."""

from __future__ import annotations

import ctypes
import struct
import time

DIGITS = 16
"""Characters of a stamp in a string field: CLOCK_MONOTONIC in nanoseconds, in hexadecimal."""

_CONTENT = bytes.__basicsize__ - 1
"""Offset of a bytes object's content from its address in CPython."""


class Stamped:
    """A message's wire bytes with space for a stamp.

    Args:
        content: the bytes.
        offset: offset of the stamp.
        form: ``text`` for 16 hexadecimal digits, ``float64`` for a little-endian number, exact up to 104 days of
            uptime, ``numbered`` for ``text`` followed by the message's number in another 16 digits.
    """

    def __init__(self, content: bytes, offset: int, form: str) -> None:
        self._content, self._offset, self._text = bytearray(content), offset, form != "float64"
        self._numbered = form == "numbered"
        self.sent = 0

    def fresh(self) -> bytes:
        """Return a copy to be stamped, made beforehand so that copying does not count as latency."""
        return bytes(self._content)

    def stamp(self, fresh: bytes) -> None:
        """Write the current time into an unpublished copy."""
        self.write(fresh, time.monotonic_ns())
        if self._numbered:
            ctypes.memmove(id(fresh) + _CONTENT + self._offset + DIGITS, b"%016x" % self.sent, DIGITS)
        self.sent += 1

    def age(self, payload: bytes) -> int:
        """Return the nanoseconds since a received copy was stamped."""
        now = time.monotonic_ns()
        return now - self.read(payload)

    def number(self, payload: bytes) -> int:
        """Return the number of a received copy, from 0."""
        return int(payload[self._offset + DIGITS : self._offset + 2 * DIGITS], 16)

    def write(self, fresh: bytes, value: int) -> None:
        """Write a number below 2**53 into an unpublished copy."""
        mark = b"%016x" % value if self._text else struct.pack("<d", value)
        ctypes.memmove(id(fresh) + _CONTENT + self._offset, mark, len(mark))

    def read(self, payload: bytes) -> int:
        """Return the number in a received copy."""
        if self._text:
            return int(payload[self._offset : self._offset + DIGITS], 16)
        value: float = struct.unpack_from("<d", payload, self._offset)[0]
        return int(value)
