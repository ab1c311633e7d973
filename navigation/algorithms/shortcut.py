"""Reduces a path of cells to few waypoints with free lines of sight between them."""

from __future__ import annotations

import math

import cython
import numpy as np
from cython.cimports.libc.math import sqrt

from navigation.algorithms.astar import Cell, Cells, Weights

_INFINITE = cython.declare(cython.double, math.inf)


def shortcut(weights: Weights, cells: Cells) -> Cells:
    """Return the waypoints of a path: each sees the next one, and the line between them costs no more than the path.

    Args:
        weights: (rows, columns) the cost of entering each cell; 0 is an obstacle.
        cells: (n, 2) rows and columns of a path from `navigation.algorithms.astar.astar`.

    Returns:
        (m, 2) some of the path's cells: the first, the last, and the corners.

    Raises:
        IndexError: a cell is outside the grid.
        ValueError: the cells are not (n, 2).
    """
    if len(cells) < 3:
        return cells
    rows, columns = weights.shape
    chosen, sums = np.empty(len(cells), np.int64), np.empty(len(cells))
    grid = np.ascontiguousarray(weights).reshape(-1)
    copied = np.array(cells, np.int32, order="C")  # so that values cannot change after the check
    if copied.shape != (len(cells), 2):
        raise ValueError(f"a path's cells must be (n, 2), rows and columns, not {copied.shape}")
    count = _choose(grid.data, rows, columns, copied.data, sums.data, chosen.data)
    return cells[chosen[:count]]


def sees(weights: Weights, one: Cell, other: Cell) -> bool:
    """Whether the line between two cells' centers touches no obstacle, apart from the first cell.

    Args:
        weights: (rows, columns) the cost of entering each cell; 0 is an obstacle.
        one: row and column.
        other: row and column.

    Raises:
        IndexError: a cell is outside the grid.
    """
    rows, columns = weights.shape
    for row, column in (one, other):
        _check(row, column, rows, columns)
    (row, column), (to_row, to_column) = one, other
    grid = np.ascontiguousarray(weights).reshape(-1)
    return _line_cost(grid.data, columns, row, column, to_row, to_column) < _INFINITE


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(-1)
def _check(
    row: cython.longlong, column: cython.longlong, rows: cython.longlong, columns: cython.longlong
) -> cython.int:
    """Raise `IndexError` for a cell outside the grid."""
    if 0 <= row < rows and 0 <= column < columns:
        return 0
    with cython.gil:
        raise IndexError(f"the cell ({row}, {column}) is outside the grid of {rows} x {columns} cells")


@cython.cfunc
@cython.boundscheck(False)
@cython.wraparound(False)
def _choose(
    weights: cython.const[cython.uchar][::1],
    rows: cython.longlong,
    columns: cython.longlong,
    cells: cython.const[cython.int][:, ::1],
    sums: cython.double[::1],
    chosen: cython.longlong[::1],
) -> cython.Py_ssize_t:
    """Write the waypoints' indices to ``chosen``; return their number. Steps are doubled, then halved.

    ``sums`` receives the path's cost up to each of its cells. All cells are checked before use. Both arrays are as long
    as the path, which is enough because each waypoint is a later cell than the one before.
    """
    last: cython.Py_ssize_t = cells.shape[0] - 1
    at: cython.Py_ssize_t = 0
    count: cython.Py_ssize_t = 1
    cython.declare(good=cython.Py_ssize_t, bad=cython.Py_ssize_t, step=cython.Py_ssize_t, tried=cython.Py_ssize_t)
    cython.declare(i=cython.Py_ssize_t)
    cython.declare(diagonal=cython.bint)
    cython.declare(length=cython.double)
    with cython.nogil:
        sums[0] = 0.0
        _check(cells[0, 0], cells[0, 1], rows, columns)
        for i in range(1, cells.shape[0]):
            _check(cells[i, 0], cells[i, 1], rows, columns)
            diagonal = cells[i, 0] != cells[i - 1, 0] and cells[i, 1] != cells[i - 1, 1]
            length = sqrt(2.0) if diagonal else 1.0
            sums[i] = sums[i - 1] + weights[cells[i, 0] * columns + cells[i, 1]] * length
        chosen[0] = 0
        while at < last:
            good, step = at + 1, 2
            bad = last + 1
            while good < last:
                tried = min(at + step, last)
                if _fits(weights, columns, cells, sums, at, tried):
                    good = tried
                    step *= 2
                else:
                    bad = tried
                    break
            while bad - good > 1:
                tried = (good + bad) // 2
                if _fits(weights, columns, cells, sums, at, tried):
                    good = tried
                else:
                    bad = tried
            at = good
            chosen[count] = at
            count += 1
    return count


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
@cython.boundscheck(False)
@cython.wraparound(False)
def _fits(
    weights: cython.const[cython.uchar][::1],
    columns: cython.longlong,
    cells: cython.const[cython.int][:, ::1],
    sums: cython.double[::1],
    one: cython.Py_ssize_t,
    other: cython.Py_ssize_t,
) -> cython.bint:
    """Whether a straight line between two cells of a path is free, at no higher cost than the path."""
    line: cython.double = _line_cost(weights, columns, cells[one, 0], cells[one, 1], cells[other, 0], cells[other, 1])
    return line <= (sums[other] - sums[one]) * (1.0 + 1e-9)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
@cython.boundscheck(False)
@cython.wraparound(False)
@cython.cdivision(True)
def _line_cost(
    weights: cython.const[cython.uchar][::1],
    columns: cython.longlong,
    row: cython.longlong,
    column: cython.longlong,
    to_row: cython.longlong,
    to_column: cython.longlong,
) -> cython.double:
    """Return length times mean weight of the cells that a line touches after its first; infinite at an obstacle.

    A line through a corner touches all four cells there. All of them are in the rectangle of the line's ends, and so in
    the grid: the error is less than 0 in the last column and more than 0 in the last row, up to the end.
    """
    high: cython.longlong = abs(to_row - row)
    wide: cython.longlong = abs(to_column - column)
    down: cython.longlong = columns if to_row > row else -columns
    right: cython.longlong = 1 if to_column > column else -1
    error: cython.longlong = wide - high
    at: cython.longlong = row * columns + column
    end: cython.longlong = to_row * columns + to_column
    touched: cython.longlong = 0
    total: cython.longlong = 0
    weight: cython.longlong
    while at != end:
        if error > 0:
            at += right
            error -= 2 * high
        elif error < 0:
            at += down
            error += 2 * wide
        else:
            if weights[at + down] == 0 or weights[at + right] == 0:
                return _INFINITE
            at += down + right
            error += 2 * (wide - high)
        weight = weights[at]
        if weight == 0:
            return _INFINITE
        total += weight
        touched += 1
    return 0.0 if touched == 0 else sqrt(high * high + wide * wide) * total / touched
