"""Rotations as quaternions (`yarp/math/Quaternion.h`): w comes first on the wire, last in C++'s constructor."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from yarp_compat.sig.matrix import Matrix
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

    def toRotationMatrix3x3(self) -> Matrix:
        """The rotation as a matrix; as in YARP the quaternion's length does not matter."""
        return self.toRotationMatrix4x4().submatrix(0, 2, 0, 2)

    def toRotationMatrix4x4(self) -> Matrix:
        """The rotation as a transform that moves nothing.

        Raises:
            ValueError: the quaternion is zero.
        """
        length = math.sqrt(sum(value * value for value in self._values))
        if not length:
            msg = "a quaternion of zeros is no rotation"
            raise ValueError(msg)
        w, x, y, z = (value / length for value in self._values)
        return Matrix([
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y), 0.0],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x), 0.0],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ])  # fmt: skip

    def fromRotationMatrix(self, R: Matrix | ArrayLike) -> None:
        """Become the rotation of a matrix of 3 by 3 or more.

        Where YARP has a choice it takes w, else the largest of the others, as positive.
        """
        r = np.asarray(R, float)
        trace = r[0, 0] + r[1, 1] + r[2, 2]
        if trace > 0.0:
            twice = math.sqrt(trace + 1.0)
            part = 0.5 / twice
            w, x, y, z = 0.5 * twice, (r[2, 1] - r[1, 2]) * part, (r[0, 2] - r[2, 0]) * part, (r[1, 0] - r[0, 1]) * part
            self._values = (float(w), float(x), float(y), float(z))
            return
        i = 1 if r[1, 1] > r[0, 0] and r[1, 1] > r[2, 2] else 2 if r[2, 2] > r[0, 0] else 0
        j, k = (i + 1) % 3, (i + 2) % 3
        twice = math.sqrt(max(r[i, i] - r[j, j] - r[k, k] + 1.0, 0.0))
        part = 0.5 / twice if twice > 0.0 else 0.0
        axes = [0.0, 0.0, 0.0]
        axes[i] = 0.5 * twice
        axes[j], axes[k] = float((r[j, i] + r[i, j]) * part), float((r[k, i] + r[i, k]) * part)
        self._values = (float((r[k, j] - r[j, k]) * part), axes[0], axes[1], axes[2])

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
