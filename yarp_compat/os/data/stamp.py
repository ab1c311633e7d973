"""Stamp: the sequence number and time of a message (`yarp/os/Stamp.h`)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar

from yarp_compat.os.time import now
from yarp_compat.overriding import override
from yarp_compat.wire.accessors import always, getter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.tags import INT32

if TYPE_CHECKING:
    from yarp_compat.wire.elements import ElementReader, ElementWriter

_LARGEST = 2**31 - 1
_TEXT = re.compile(r"\s*([+-]?[0-9]{1,10})\s+([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)")


class Stamp(Portable):
    """A sequence number, below 0 for an invalid stamp, and a time in seconds since 1970."""

    TYPE: ClassVar[str] = "yarp/stamp"

    def __init__(self, count: int = -1, time: float = 0.0) -> None:
        self._count = count
        self._time = time

    getCount = getter("_count", int, "The sequence number.")
    getTime = getter("_time", float, "The time in seconds.")

    def isValid(self) -> bool:
        """Return whether the sequence number is set."""
        return self._count >= 0

    getMaxCount = always(_LARGEST, "The largest sequence number; the next is 0.")

    def update(self, time: float | None = None) -> None:
        """Set the next sequence number, and the given time or the current one."""
        self._count = self._count + 1 if -1 <= self._count < _LARGEST else 0
        self._time = now() if time is None else time

    @override
    def to_text(self) -> str:
        """Return the envelope's text: ``5 123.5``, the time with up to 15 digits."""
        return f"{self._count} {self._time:.15g}"

    toString = to_text

    @override
    def from_text(self, line: str) -> None:
        """Parse an envelope; if it is not an int and a number, becomes invalid and raises `WireError`."""
        match = _TEXT.match(line)
        self._count, self._time = -1, 0.0
        if match is None or not -_LARGEST <= int(match[1]) <= _LARGEST:
            raise WireError(f"invalid stamp {line!r:.80}: expected a count and a time")
        self._count, self._time = int(match[1]), float(match[2])

    @override
    def _write(self, out: ElementWriter) -> None:
        out.begin(2)
        out.integer(self._count)
        out.float64(self._time)

    @override
    def _read(self, source: ElementReader) -> None:
        count = source.begin()
        if count not in (2, 3):
            raise WireError(f"invalid stamp: {count} elements; expected 2, or 3 with a frame's name")
        if source.next_tag() != INT32:
            raise WireError("invalid stamp: its count is not an int32")
        self._count, self._time = source.integer(), source.float64()
        if count == 3:
            source.string()
        source.end()

    def __iter__(self) -> Iterator[float]:
        yield self._count
        yield self._time

    @override
    def __eq__(self, other: object) -> bool:
        return isinstance(other, Stamp) and (self._count, self._time) == (other._count, other._time)

    @override
    def __hash__(self) -> int:
        return hash((self._count, self._time))

    @override
    def __repr__(self) -> str:
        return f"Stamp({self._count}, {self._time!r})"
