"""Rotations as quaternions (`yarp/math/Quaternion.h`): w comes first on the wire, last in C++'s constructor."""

from __future__ import annotations

from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer


class Quaternion(Portable):
    """A rotation."""

    TYPE = "yarp/quaternion"

    def __init__(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 1.0) -> None:
        self._values = (w, x, y, z)

    def w(self) -> float:
        """The real part."""
        return self._values[0]

    def x(self) -> float:
        """The part of the first axis."""
        return self._values[1]

    def y(self) -> float:
        """The part of the second axis."""
        return self._values[2]

    def z(self) -> float:
        """The part of the third axis."""
        return self._values[3]

    def __eq__(self, other: object) -> bool:
        return self._values == other._values if isinstance(other, Quaternion) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._values)

    def __repr__(self) -> str:
        w, x, y, z = self._values
        return f"Quaternion(x={x}, y={y}, z={z}, w={w})"

    def _write(self, out: Writer) -> None:
        out.begin(4, out.profile.float64_tag)
        for value in self._values:
            out.float64(value, tagged=False)

    def _read(self, source: Reader) -> None:
        count = source.begin()
        if count != 4:
            raise WireError(f"a quaternion has four numbers, not {count}")
        w, x, y, z = (source.float64() for _ in range(4))
        source.end()
        self._values = (w, x, y, z)
