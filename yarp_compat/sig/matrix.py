"""Matrices of doubles (`yarp/sig/Matrix.h`): ``(rows cols (values row by row))``.

Real YARP refuses to read a matrix without elements, and a real client that waits for one in a reply hangs: send none
there. This reads it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yarp_compat.sig.numbers import as_array, read_numbers, write_numbers
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer

_FLOAT64 = np.dtype("<f8")


class Matrix(Portable):
    """A matrix.

    Args:
        rows: how many, or the matrix as an array or lists of rows.
        cols: how many.
    """

    def __init__(self, rows: int | ArrayLike = 0, cols: int = 0) -> None:
        if isinstance(rows, int):
            self._values: NDArray[Any] = np.zeros((rows, cols), _FLOAT64)
            return
        given = np.array(rows.numpy() if isinstance(rows, Matrix) else rows, _FLOAT64)
        self._values = given.reshape(given.shape if given.ndim == 2 else (1, -1))

    def numpy(self) -> NDArray[Any]:
        """The elements as an array of (rows, cols) that shares the matrix's memory, until the matrix changes its size.

        It cannot be written to where the matrix came in memory that cannot.
        """
        return self._values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return as_array(self._values, dtype, copy)

    def rows(self) -> int:
        """How many rows there are."""
        return int(self._values.shape[0])

    def cols(self) -> int:
        """How many columns there are."""
        return int(self._values.shape[1])

    def resize(self, rows: int, cols: int) -> None:
        """Become of this size; what fits of the old elements stays, new ones are 0."""
        if (rows, cols) == self._values.shape:
            return
        values = np.zeros((rows, cols), _FLOAT64)
        kept = self._values[:rows, :cols]
        values[: kept.shape[0], : kept.shape[1]] = kept
        self._values = values

    def zero(self) -> None:
        """Set every element to 0."""
        self._own()[:] = 0

    def eye(self) -> Self:
        """Become an identity."""
        self._values = np.eye(*self._values.shape, dtype=_FLOAT64)
        return self

    def diagonal(self, values: Vector | Sequence[float]) -> Self:
        """Become 0 but for these values on the diagonal."""
        self.zero()
        given = np.asarray(values)
        np.fill_diagonal(self._values[: len(given), : len(given)], given)
        return self

    def transposed(self) -> Self:
        """A matrix of the columns as rows."""
        return type(self)(self._values.T)

    def submatrix(self, r1: int, r2: int, c1: int, c2: int) -> Self:
        """A copy of the rows and columns from one to another, both included."""
        return type(self)(self._values[r1 : r2 + 1, c1 : c2 + 1])

    def setSubmatrix(self, other: Matrix, row: int, col: int) -> bool:
        """Copy another matrix's elements into this one; False where they do not fit."""
        return self._put(other.numpy(), row, col)

    def getRow(self, row: int) -> Vector:
        """A copy of one row."""
        return Vector(self._values[row])

    def getCol(self, col: int) -> Vector:
        """A copy of one column."""
        return Vector(self._values[:, col])

    def setRow(self, row: int, values: Vector) -> bool:
        """Change one row; False where there is none such or its length is another."""
        return len(values) == self.cols() and self._put(values.numpy()[None, :], row, 0)

    def setCol(self, col: int, values: Vector) -> bool:
        """Change one column; False where there is none such or its length is another."""
        return len(values) == self.rows() and self._put(values.numpy()[:, None], 0, col)

    def get(self, row: int, col: int) -> float:
        """One element."""
        return self[row, col]

    access = get

    def set(self, row: int, col: int, value: float) -> None:
        """Change one element."""
        self[row, col] = value

    def toString(self, precision: int = -1, width: int = -1, endRowStr: str = "\n") -> str:
        """The elements as YARP prints them."""
        digits = 6 if precision < 0 else precision
        between, form = ("\t", f"{{: .{digits}f}}") if width < 0 else (" ", f"{{: {width}.{digits}f}}")
        return endRowStr.join(between.join(map(form.format, row)) for row in self._values.tolist())

    def toString_c(self) -> str:
        """The elements as YARP prints them."""
        return self.toString()

    __str__ = toString_c

    def isEqual(self, other: object) -> bool:
        """Whether both have the same elements."""
        return self == other

    def notEqual(self, other: object) -> bool:
        """Whether they differ."""
        return self != other

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Matrix):
            return NotImplemented
        return np.array_equal(self._values, other.numpy())

    __hash__ = None  # type: ignore[assignment] # it changes

    def __getitem__(self, place: tuple[int, int]) -> float:
        return float(self._values[place])

    def __setitem__(self, place: tuple[int, int], value: float) -> None:
        self._own()[place] = value

    def __repr__(self) -> str:
        return f"Matrix({self._values.tolist()})"

    def _own(self) -> NDArray[Any]:
        """The elements in memory that can be changed."""
        if not self._values.flags.writeable:
            self._values = self._values.copy()
        return self._values

    def _put(self, values: NDArray[Any], row: int, col: int) -> bool:
        if row < 0 or col < 0 or row + values.shape[0] > self.rows() or col + values.shape[1] > self.cols():
            return False
        self._own()[row : row + values.shape[0], col : col + values.shape[1]] = values
        return True

    def _write(self, out: Writer) -> None:
        out.begin(3)
        out.integer(self.rows())
        out.integer(self.cols())
        write_numbers(out, np.ascontiguousarray(self._values).reshape(-1))

    def _read(self, source: Reader) -> None:
        count = source.begin()
        if count != 3:
            raise WireError(f"a matrix has rows, columns and a list, not {count} elements")
        rows, cols = source.integer(), source.integer()
        values = read_numbers(source, _FLOAT64)
        source.end()
        if rows < 0 or cols < 0 or rows * cols != len(values):
            raise WireError(f"a matrix of {rows} rows and {cols} columns does not have {len(values)} elements")
        self._values = values.reshape(rows, cols)
