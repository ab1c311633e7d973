"""2-D vectors (`yarp/math/Vec2D.h`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from yarp_compat.overriding import override
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.tags import INT32, INT64


@dataclass
class Vec2D(Portable):
    """A pair of doubles: a point or a direction in a plane."""

    TYPE = "yarp/vec2D"
    x: float = 0.0
    y: float = 0.0

    @override
    def _write(self, out: ElementWriter) -> None:
        out.begin(2, out.profile.float64_tag)
        out.float64(self.x, tagged=False)
        out.float64(self.y, tagged=False)

    @override
    def _read(self, source: ElementReader) -> None:
        _pair(source)
        x, y = source.float64(), source.float64()
        source.end()
        self.x, self.y = x, y


@dataclass
class Vec2DInt(Portable):
    """A pair of integers of four bytes."""

    TYPE = "yarp/vec2D"
    TAG: ClassVar[int] = INT32
    x: int = 0
    y: int = 0

    @override
    def _write(self, out: ElementWriter) -> None:
        out.begin(2, self.TAG)
        out.integer(self.x, self.TAG, tagged=False)
        out.integer(self.y, self.TAG, tagged=False)

    @override
    def _read(self, source: ElementReader) -> None:
        _pair(source)
        x, y = source.integer(), source.integer()
        source.end()
        self.x, self.y = x, y


@dataclass
class Vec2DSize(Vec2DInt):
    """A pair of integers of eight bytes: the cell of a map."""

    TAG = INT64


def _pair(source: ElementReader) -> None:
    count = source.begin()
    if count != 2:
        raise WireError(f"invalid pair: expected two numbers, not {count}")
