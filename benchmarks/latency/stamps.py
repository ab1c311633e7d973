"""Time stamps inside prepared messages; standard library only, since the ROS 1 ends run on the system's Python."""

from __future__ import annotations

import ctypes
import struct
import time

DIGITS = 16
"""Characters of a stamp in a string field: CLOCK_MONOTONIC in nanoseconds, hexadecimal."""

_CONTENT = bytes.__basicsize__ - 1
"""Where CPython keeps a bytes object's content, from its address on."""


class Stamped:
    """A message's wire bytes with a place for the time.

    Args:
        content: the bytes.
        offset: where the stamp is.
        form: ``text`` for 16 hexadecimal digits, ``float64`` for a little-endian number, exact up to 104 days of
            uptime, ``numbered`` for text with the message's number behind it, as long.
    """

    def __init__(self, content: bytes, offset: int, form: str) -> None:
        self._content, self._offset, self._text = bytearray(content), offset, form != "float64"
        self._numbered = form == "numbered"
        self.sent = 0

    def fresh(self) -> bytes:
        """A copy of its own to be stamped, so that no copying counts as latency."""
        return bytes(self._content)

    def stamp(self, fresh: bytes) -> None:
        """Write the time now into a copy that nobody else has seen yet."""
        self.write(fresh, time.monotonic_ns())
        if self._numbered:
            ctypes.memmove(id(fresh) + _CONTENT + self._offset + DIGITS, b"%016x" % self.sent, DIGITS)
        self.sent += 1

    def age(self, payload: bytes) -> int:
        """Nanoseconds since a received copy was stamped."""
        now = time.monotonic_ns()
        return now - self.read(payload)

    def number(self, payload: bytes) -> int:
        """The number of a received copy, counted from 0."""
        return int(payload[self._offset + DIGITS : self._offset + 2 * DIGITS], 16)

    def write(self, fresh: bytes, value: int) -> None:
        """Write a number below 2**53 into a copy that nobody else has seen yet."""
        mark = b"%016x" % value if self._text else struct.pack("<d", value)
        ctypes.memmove(id(fresh) + _CONTENT + self._offset, mark, len(mark))

    def read(self, payload: bytes) -> int:
        """The number in a received copy."""
        if self._text:
            return int(payload[self._offset : self._offset + DIGITS], 16)
        value: float = struct.unpack_from("<d", payload, self._offset)[0]
        return int(value)
