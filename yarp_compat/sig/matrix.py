"""Quaternions, and matrices of doubles (`yarp/sig/Matrix.h`), on the wire ``(rows cols (values row by row))``.

C++ YARP refuses to read a matrix without elements, and a C++ client hangs if a reply contains such a matrix: do not
send them in replies. This module reads them. A quaternion (`yarp/math/Quaternion.h`) has w first on the wire, last in
C++'s constructor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yarp_compat.overriding import override
from yarp_compat.sig.vector import Comparable, Vector, as_array, read_numbers, write_numbers
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable

_FLOAT64 = np.dtype("<f8")


class Matrix(Comparable, Portable):
    """A matrix, created from numbers of rows and columns, a 2-D array, or a list of rows; a flat list is one row."""

    def __init__(self, rows: int | ArrayLike = 0, cols: int = 0) -> None:
        if isinstance(rows, int):
            self._values: NDArray[Any] = np.zeros((rows, cols), _FLOAT64)
            return
        given = np.array(rows.numpy() if isinstance(rows, Matrix) else rows, _FLOAT64)
        self._values = given.reshape(given.shape if given.ndim == 2 else (1, -1))

    def numpy(self) -> NDArray[Any]:
        """Return the elements (rows, cols) as a view of the current memory, read-only if the memory is.

        The matrix gets new memory when its size changes, from `eye`, from a received message, and from the first write
        to read-only memory.
        """
        return self._values

    def data(self) -> NDArray[Any]:
        """Return the elements, row by row, as a writable view, like C++'s pointer."""
        self._values = np.ascontiguousarray(self._writable())
        return self._values.reshape(-1)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return as_array(self._values, dtype, copy)

    def rows(self) -> int:
        """Return the number of rows."""
        return int(self._values.shape[0])

    def cols(self) -> int:
        """Return the number of columns."""
        return int(self._values.shape[1])

    def resize(self, rows: int, cols: int) -> None:
        """Change the size; elements that fit are preserved, new ones are 0."""
        if (rows, cols) == self._values.shape:
            return
        values = np.zeros((rows, cols), _FLOAT64)
        kept = self._values[:rows, :cols]
        values[: kept.shape[0], : kept.shape[1]] = kept
        self._values = values

    def zero(self) -> None:
        """Set every element to 0."""
        self._writable()[:] = 0

    def eye(self) -> Self:
        """Make this an identity matrix of its size."""
        self._values = np.eye(*self._values.shape, dtype=_FLOAT64)
        return self

    def diagonal(self, values: Vector | Sequence[float]) -> Self:
        """Set the diagonal to these values, and all other elements to 0."""
        self.zero()
        given = np.asarray(values)
        np.fill_diagonal(self._values[: len(given), : len(given)], given)
        return self

    def transposed(self) -> Self:
        """Return the transposed matrix."""
        return type(self)(self._values.T)

    def submatrix(self, r1: int, r2: int, c1: int, c2: int) -> Self:
        """Return a copy of a range of rows and columns, ends included."""
        return type(self)(self._values[r1 : r2 + 1, c1 : c2 + 1])

    def setSubmatrix(self, other: Matrix, row: int, col: int) -> bool:
        """Copy another matrix into this matrix; return False if it does not fit."""
        return self._set_block(other.numpy(), row, col)

    def removeRows(self, first_row: int, how_many: int) -> Self:
        """Remove rows; return a copy of the remaining matrix."""
        return self._without(0, first_row, how_many)

    def removeCols(self, first_col: int, how_many: int) -> Self:
        """Remove columns; return a copy of the remaining matrix."""
        return self._without(1, first_col, how_many)

    def _without(self, axis: int, first: int, count: int) -> Self:
        if first < 0 or count < 0 or first + count > self._values.shape[axis]:
            what = "columns" if axis else "rows"
            raise IndexError(
                f"cannot remove {count} {what} from index {first} on: the matrix has {self.rows()} rows and "
                f"{self.cols()} columns"
            )
        self._values = np.delete(self._values, slice(first, first + count), axis)
        return type(self)(self._values)

    def subrow(self, r: int, c: int, size: int) -> Vector:
        """Return a copy of ``size`` elements of a row; empty if out of range."""
        inside = 0 <= r < self.rows() and c >= 0 and c + size <= self.cols()
        return Vector(self._values[r, c : c + size]) if inside else Vector()

    def subcol(self, r: int, c: int, size: int) -> Vector:
        """Return a copy of ``size`` elements of a column; empty if out of range."""
        inside = 0 <= c < self.cols() and r >= 0 and r + size <= self.rows()
        return Vector(self._values[r : r + size, c]) if inside else Vector()

    def setSubrow(self, v: Vector, r: int, c: int) -> bool:
        """Set elements of a row from ``c`` on; return False if they do not fit."""
        return self._set_block(v.numpy()[None, :], r, c)

    def setSubcol(self, v: Vector, r: int, c: int) -> bool:
        """Set elements of a column from ``r`` on; return False if they do not fit."""
        return self._set_block(v.numpy()[:, None], r, c)

    def getRow(self, row: int) -> Vector:
        """Return a copy of one row."""
        return Vector(self._values[row])

    def getCol(self, col: int) -> Vector:
        """Return a copy of one column."""
        return Vector(self._values[:, col])

    def setRow(self, row: int, values: Vector) -> bool:
        """Set one row; return False if it does not exist or its length differs."""
        return len(values) == self.cols() and self._set_block(values.numpy()[None, :], row, 0)

    def setCol(self, col: int, values: Vector) -> bool:
        """Set one column; return False if it does not exist or its length differs."""
        return len(values) == self.rows() and self._set_block(values.numpy()[:, None], 0, col)

    def get(self, row: int, col: int) -> float:
        """Return one element."""
        return self[row, col]

    access = get

    def set(self, row: int, col: int, value: float) -> None:
        """Set one element."""
        self[row, col] = value

    def toString(self, precision: int = -1, width: int = -1, endRowStr: str = "\n") -> str:
        """Return the elements in YARP's text format."""
        digits = 6 if precision < 0 else precision
        between, form = ("\t", f"{{: .{digits}f}}") if width < 0 else (" ", f"{{: {width}.{digits}f}}")
        return endRowStr.join(between.join(map(form.format, row)) for row in self._values.tolist())

    def toString_c(self) -> str:
        """Return the elements in YARP's text format."""
        return self.toString()

    __str__ = toString_c

    @override
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Matrix):
            return NotImplemented
        return np.array_equal(self._values, other.numpy())

    def __getitem__(self, place: tuple[int, int]) -> float:
        return float(self._values[place])

    def __setitem__(self, place: tuple[int, int], value: float) -> None:
        self._writable()[place] = value

    @override
    def __repr__(self) -> str:
        return f"Matrix({self._values.tolist()})"

    def _writable(self) -> NDArray[Any]:
        """Return the elements in writable memory, copied if needed."""
        if not self._values.flags.writeable:
            self._values = self._values.copy()
        return self._values

    def _set_block(self, values: NDArray[Any], row: int, col: int) -> bool:
        if row < 0 or col < 0 or row + values.shape[0] > self.rows() or col + values.shape[1] > self.cols():
            return False
        self._writable()[row : row + values.shape[0], col : col + values.shape[1]] = values
        return True

    @override
    def _write(self, out: ElementWriter) -> None:
        out.begin(3)
        out.integer(self.rows())
        out.integer(self.cols())
        write_numbers(out, np.ascontiguousarray(self._values).reshape(-1))

    @override
    def _read(self, source: ElementReader) -> None:
        count = source.begin()
        if count != 3:
            raise WireError(f"invalid matrix: expected rows, columns and a list, not {count} elements")
        rows, cols = source.integer(), source.integer()
        values = read_numbers(source, _FLOAT64)
        source.end()
        if rows < 0 or cols < 0 or rows * cols != len(values):
            raise WireError(f"invalid matrix: {len(values)} elements for {rows} rows and {cols} columns")
        self._values = values.reshape(rows, cols)


def submatrix(source: Matrix, out: Matrix, r1: int, r2: int, c1: int, c2: int) -> bool:
    """Copy a range of rows and columns, ends included, to ``out``; return False if out of range."""
    if not (0 <= r1 <= r2 < source.rows() and 0 <= c1 <= c2 < source.cols()):
        return False
    out._become(Matrix(source.numpy()[r1 : r2 + 1, c1 : c2 + 1]))
    return True


def removeRows(source: Matrix, out: Matrix, first_row: int, how_many: int) -> bool:
    """Copy the matrix without some rows to ``out``."""
    out._become(Matrix(source).removeRows(first_row, how_many))
    return True


def removeCols(source: Matrix, out: Matrix, first_col: int, how_many: int) -> bool:
    """Copy the matrix without some columns to ``out``."""
    out._become(Matrix(source).removeCols(first_col, how_many))
    return True


def _part(index: int, doc: str) -> Callable[[Quaternion], float]:
    def part(self: Quaternion) -> float:
        return self._values[index]

    part.__doc__ = doc
    return part


class Quaternion(Portable):
    """A rotation as a quaternion."""

    TYPE = "yarp/quaternion"

    def __init__(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 1.0) -> None:
        self._values = (w, x, y, z)

    w = _part(0, "The real part.")
    x = _part(1, "The x part.")
    y = _part(2, "The y part.")
    z = _part(3, "The z part.")

    def toRotationMatrix3x3(self) -> Matrix:
        """Return the rotation as a matrix; the quaternion need not be normalized, as in YARP."""
        return self.toRotationMatrix4x4().submatrix(0, 2, 0, 2)

    def toRotationMatrix4x4(self) -> Matrix:
        """Return the rotation as a transform without translation; raises `ValueError` for a quaternion of zeros."""
        length = math.sqrt(sum(value * value for value in self._values))
        if not length:
            raise ValueError("a quaternion of zeros is not a rotation")
        w, x, y, z = (value / length for value in self._values)
        return Matrix([
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y), 0.0],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x), 0.0],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ])  # fmt: skip

    def fromRotationMatrix(self, R: Matrix | ArrayLike) -> None:
        """Set the rotation from a matrix (3, 3) or larger.

        As in YARP, w is positive if the trace is positive; otherwise the one of x, y and z with the largest absolute
        value is positive.
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

    @override
    def __eq__(self, other: object) -> bool:
        return self._values == other._values if isinstance(other, Quaternion) else NotImplemented

    @override
    def __hash__(self) -> int:
        return hash(self._values)

    @override
    def __repr__(self) -> str:
        w, x, y, z = self._values
        return f"Quaternion(x={x}, y={y}, z={z}, w={w})"

    @override
    def _write(self, out: ElementWriter) -> None:
        out.begin(4, out.profile.float64_tag)
        for value in self._values:
            out.float64(value, tagged=False)

    @override
    def _read(self, source: ElementReader) -> None:
        count = source.begin()
        if count != 4:
            raise WireError(f"invalid quaternion: expected four numbers, not {count}")
        w, x, y, z = (source.float64() for _ in range(4))
        source.end()
        self._values = (w, x, y, z)
