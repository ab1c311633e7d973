"""How a pose's covariance goes on the wire: always 3x3, as a real client that is sent an empty matrix hangs."""

from __future__ import annotations

from typing import Any

import numpy as np

from yarp_compat.dev.fields import Nested
from yarp_compat.sig.matrix import Matrix
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer

SHAPE = (3, 3)


class Covariance(Nested):
    """A 3x3 matrix; where there is none, zeros are written. It may be an array too.

    An empty one is read as such: servers of YARP 3.12 and 4.0 send it where all went well, having confused two cases.
    """

    def __init__(self) -> None:
        super().__init__(Matrix)

    def write(self, out: Writer, value: Any, *, tagged: bool = True) -> None:
        """Put it on the wire."""
        matrix = self.default() if value is None else value if isinstance(value, Matrix) else Matrix(np.asarray(value))
        if not matrix.numpy().size:
            matrix = self.default()
        _sized(matrix)
        super().write(out, matrix, tagged=tagged)

    def read(self, source: Reader) -> Matrix:
        """Take one."""
        matrix = Matrix()
        matrix._read(source)
        if matrix.numpy().size:
            _sized(matrix)
        return matrix

    def default(self) -> Matrix:
        """Zeros."""
        return Matrix(*SHAPE)


COVARIANCE = Covariance()


def _sized(matrix: Matrix) -> None:
    if matrix.numpy().shape != SHAPE:
        raise WireError(f"a pose's covariance is 3x3, not {matrix.rows()}x{matrix.cols()}")
