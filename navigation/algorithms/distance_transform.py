"""The exact Euclidean distance transform: the distance of each cell to the nearest obstacle.

Two passes of lower envelopes of parabolas, linear in the number of cells (Felzenszwalb and Huttenlocher, "Distance
Transforms of Sampled Functions", Theory of Computing 8, 2012).
"""

from __future__ import annotations

import math

import cython
import numpy as np
from numpy.typing import NDArray

_INFINITE = cython.declare(cython.double, math.inf)

Distances = NDArray[np.float32]


def distance_transform(obstacles: NDArray[np.bool_]) -> Distances:
    """Return the distance of each cell's center to the nearest obstacle's, in cells; infinite without obstacles.

    Args:
        obstacles: (rows, columns).
    """
    rows, columns = obstacles.shape
    squares = np.empty((rows, columns), np.float32)
    if squares.size:
        steps = np.empty((rows, columns), np.int32).data
        _count(np.ascontiguousarray(obstacles, np.bool_).view(np.uint8).data, steps)
        places, heights, begins = np.empty(columns, np.int64), np.empty(columns), np.empty(columns + 1)
        _envelop(steps, places.data, heights.data, begins.data, squares.data)
    return np.sqrt(squares, out=squares)


@cython.cfunc
@cython.boundscheck(False)
@cython.wraparound(False)
def _count(obstacles: cython.const[cython.uchar][:, ::1], steps: cython.int[:, ::1]) -> cython.void:
    """Count steps along the column to the nearest obstacle, ``rows + columns`` without one; needs at least one row."""
    rows: cython.Py_ssize_t = obstacles.shape[0]
    columns: cython.Py_ssize_t = obstacles.shape[1]
    none: cython.int = rows + columns
    cython.declare(row=cython.Py_ssize_t, column=cython.Py_ssize_t)
    cython.declare(more=cython.int)
    with cython.nogil:
        for column in range(columns):
            steps[0, column] = 0 if obstacles[0, column] else none
        for row in range(1, rows):
            for column in range(columns):
                more = min(steps[row - 1, column] + 1, none)
                steps[row, column] = 0 if obstacles[row, column] else more
        for row in range(rows - 2, -1, -1):
            for column in range(columns):
                steps[row, column] = min(steps[row, column], steps[row + 1, column] + 1)


@cython.cfunc
@cython.boundscheck(False)
@cython.wraparound(False)
@cython.cdivision(True)
def _envelop(
    steps: cython.const[cython.int][:, ::1],
    places: cython.longlong[::1],
    heights: cython.double[::1],
    begins: cython.double[::1],
    squares: cython.float[:, ::1],
) -> cython.void:
    """Compute squared distances: in each row, the lower envelope of parabolas, one for each column.

    ``places`` and ``heights`` have room for each column, ``begins`` for one more, because a column is added at most
    once.
    ``begins`` increases from -infinity to infinity, so that every column is in one of its intervals.
    """
    rows: cython.Py_ssize_t = steps.shape[0]
    columns: cython.Py_ssize_t = steps.shape[1]
    none: cython.int = rows + columns
    cython.declare(row=cython.Py_ssize_t, column=cython.Py_ssize_t, count=cython.Py_ssize_t, at=cython.Py_ssize_t)
    cython.declare(last=cython.longlong, away=cython.longlong)
    cython.declare(height=cython.double, lower=cython.double, begin=cython.double)
    with cython.nogil:
        for row in range(rows):
            count = 0
            for column in range(columns):
                if steps[row, column] >= none:
                    continue
                height = float(steps[row, column]) * steps[row, column]
                begin = -_INFINITE
                while count:
                    last = places[count - 1]
                    lower = heights[count - 1]
                    begin = (height + column * column - lower - last * last) / (2.0 * (column - last))
                    if begin > begins[count - 1]:
                        break
                    count -= 1
                if count == 0:
                    begin = -_INFINITE
                places[count] = column
                heights[count] = height
                begins[count] = begin
                count += 1
            if count == 0:
                for column in range(columns):
                    squares[row, column] = _INFINITE
                continue
            begins[count] = _INFINITE
            at = 0
            for column in range(columns):
                while begins[at + 1] < column:
                    at += 1
                away = column - places[at]
                squares[row, column] = away * away + heights[at]
