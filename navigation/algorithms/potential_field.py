"""A potential field on a small grid: the cost from each cell to the goal, and the path down the field.

The goal attracts by distance, obstacles repel by the cost of passing near them. Because costs are summed along paths,
the field has no minimum but the goal (navigation function NF1: Barraquand, Langlois, Latombe 1992), whereas the
classical field (Khatib 1986) traps a robot in front of every concave obstacle. Blocked cells have a high but finite
cost, so that there is a path even if the robot has to wait for an obstacle to move.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cython
import numpy as np
from cython.cimports.libc.math import ceil, sqrt
from numpy.typing import NDArray

if cython.compiled:
    from cython.cimports.libc.math import rint
else:
    rint = round

# a step costs _STRAIGHT or _DIAGONAL, times a factor for the cell that it enters: _OPEN or _UNSEEN, plus up to _NEAR
# close to an obstacle; _TIGHT if the robot barely fits; or _BLOCKED
_STRAIGHT = cython.declare(cython.longlong, 7)
_DIAGONAL = cython.declare(cython.longlong, 10)
_OPEN = cython.declare(cython.longlong, 4)
_UNSEEN = cython.declare(cython.longlong, 8)
_NEAR = cython.declare(cython.longlong, 20)
_TIGHT = cython.declare(cython.longlong, 60)
_BLOCKED = cython.declare(cython.longlong, 1500)
_RING = 32768
_IN_RING = cython.declare(cython.longlong, _RING - 1)
_KEPT = cython.declare(cython.double, 20.0)  # extra cost, in cells, of an exit that is not near the previous one
_KEPT_NEAR = cython.declare(cython.double, 20.0)  # cells from the previous exit within which another one is near it
_UNREACHED = cython.declare(cython.longlong, 2**31 - 1)
_SHORTEST = cython.declare(cython.Py_ssize_t, 4)  # the aim is at least this many cells ahead
_ROUNDED = cython.declare(cython.double, 0.5)  # the rounding error of distances between cells, cells
_INFINITE = cython.declare(cython.double, math.inf)
_NOWHERE = (math.nan, math.nan)
_WIDEST = 1100.0  # diagonal of a window, cells: (1100 + 20) * 28, the most expensive exit, is less than the ring
_FARTHEST = 2.0**40
"""Goals farther away, in cells, are moved to this distance, so that numbers stay exact."""

Cell = tuple[int, int]
Place = tuple[float, float]
"""Row and column, in cells."""


@dataclass(frozen=True)
class Descent:
    """The path down from the robot's cell."""

    # (n, 2) rows and columns, from the robot's cell to the goal's, or to the exit from the window
    cells: NDArray[np.int32]
    aim: int  #: the index in ``cells`` of the farthest cell to which a straight line is free, at least 4 if possible
    blocked: float  #: length of the path up to its first blocked cell, cells; infinite if there is none
    cost: float  #: the cost of the whole path, in cells of open floor
    # whether a straight line to the goal itself is free; in that case no path is searched, and ``cells`` is empty
    direct: bool


def descend(
    distances: NDArray[np.float32],  # (rows, columns) from each cell to the nearest obstacle, cells
    unseen: NDArray[np.bool_],  # (rows, columns) unknown cells
    start: Cell,  # the robot's row and column
    goal: Place,  # row and column, in cells; it may be outside
    before: Place | None,  # the previous exit from the window: one that is not near it must be better by 20 cells
    radius: float,  # the robot's radius, cells
    influence: float,  # distance beyond which obstacles do not repel, cells
    spare: float,  # distance that a straight line keeps beyond the radius, cells
    *,
    leave: bool = False,  # whether a robot that is nearer to an obstacle than a straight line first leaves it
) -> Descent:
    """Return the path down the potential.

    Raises:
        ValueError: a number is not finite, the shapes differ or are too large, or the start is outside.
    """
    rows, columns = distances.shape
    _check(distances.shape, unseen.shape, start, (*goal, radius, influence, spare))
    row, column = (min(max(float(at), -_FARTHEST), _FARTHEST) for at in goal)
    grid = np.ascontiguousarray(distances).data
    if _line_free(grid, start[0], start[1], row, column, radius + spare):
        cost = _length(row - start[0], column - start[1])
        return Descent(np.empty((0, 2), np.int32), 0, math.inf, cost, direct=True)
    costs = np.full((rows + 2, columns + 2), -1, np.int32)
    costs[1:-1, 1:-1] = _UNREACHED
    least = 0.0
    if 0 <= round(row) < rows and 0 <= round(column) < columns:
        costs[round(row) + 1, round(column) + 1] = 0
    else:
        least = _length(max(0.0, -row, row - rows + 1), max(0.0, -column, column - columns + 1))
        before_row, before_column = before or _NOWHERE
        _set_exit_costs(costs.data, row, column, before_row, before_column, least)
    wide = columns + 2
    begin = (start[0] + 1) * wide + start[1] + 1
    offsets = np.array((1, -1, wide, -wide, wide + 1, wide - 1, 1 - wide, -wide - 1), np.int32)
    next_cell = np.full(costs.size, -1, np.int32).data
    _spread(
        _padded(distances, np.float32),
        _padded(unseen, np.uint8),
        offsets.data,
        begin,
        radius,
        influence,
        costs.reshape(-1).data,
        next_cell,
    )
    cells = np.empty((_count(next_cell, begin), 2), np.int32)
    blocked = _lay(grid, next_cell, begin, radius, cells.data)
    aim = _aim(grid, cells.data, radius, spare, leave)
    cost = float(costs[start[0] + 1, start[1] + 1]) / (_STRAIGHT * _OPEN) + least
    return Descent(cells, aim, blocked, cost, direct=False)


def _check(shape: tuple[int, ...], unseen: tuple[int, ...], start: Cell, numbers: tuple[float, ...]) -> None:
    """Raise `ValueError` for input that the kernels cannot handle."""
    if shape != unseen or math.hypot(*shape) > _WIDEST:
        raise ValueError(
            f"a window must have a diagonal of at most {_WIDEST:.0f} cells, not the shape {shape}, unseen {unseen}"
        )
    if not (0 <= start[0] < shape[0] and 0 <= start[1] < shape[1]):
        raise ValueError(f"the start {start} is outside the window of {shape[0]} x {shape[1]} cells")
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"goal, radius, influence and spare must be finite numbers, not {numbers}")


def _padded(cells: NDArray[Any], kind: Any) -> memoryview:
    """Return the cells with a border of one cell, flat."""
    rows, columns = cells.shape
    padded = np.zeros((rows + 2, columns + 2), kind)
    padded[1:-1, 1:-1] = cells
    return padded.reshape(-1).data


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _length(rows: cython.double, columns: cython.double) -> cython.double:
    """Return a length in cells; ``hypot`` differs by platform, and a last bit can change a path."""
    return sqrt(rows * rows + columns * columns)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
@cython.boundscheck(False)
@cython.wraparound(False)
@cython.cdivision(True)
def _line_free(
    distances: cython.const[cython.float][:, ::1],
    row: cython.double,
    column: cython.double,
    to_row: cython.double,
    to_column: cython.double,
    least: cython.double,
) -> cython.bint:
    """Whether a straight line keeps the distance ``least`` from obstacles; outside the grid there are none."""
    rows: cython.longlong = distances.shape[0]
    columns: cython.longlong = distances.shape[1]
    down: cython.double = to_row - row
    right: cython.double = to_column - column
    steps: cython.double = ceil(2.0 * max(abs(down), abs(right))) + 1.0
    step: cython.double = 0.0
    while step <= steps:
        share: cython.double = step / steps
        r: cython.longlong = cython.cast(cython.longlong, rint(row + down * share))
        c: cython.longlong = cython.cast(cython.longlong, rint(column + right * share))
        if not (0 <= r < rows and 0 <= c < columns):
            return True
        if distances[r, c] < least:
            return False
        step += 1.0
    return True


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
@cython.cdivision(True)
def _weight(
    distance: cython.double, unseen: cython.bint, radius: cython.double, influence: cython.double
) -> cython.longlong:
    """Return the factor for the cost of a step into a cell; all numbers but the distance are finite."""
    if distance < radius - _ROUNDED:
        return _BLOCKED
    if distance < radius + _ROUNDED:
        return _TIGHT
    weight: cython.longlong = _UNSEEN if unseen else _OPEN
    if distance < influence:
        near: cython.double = 1.0 - (distance - radius) / (influence - radius)
        weight += cython.cast(cython.longlong, _NEAR * near * near)
    return weight


@cython.cfunc
def _set_exit_costs(
    costs: cython.int[:, ::1],
    goal_row: cython.double,
    goal_column: cython.double,
    before_row: cython.double,
    before_column: cython.double,
    least: cython.double,
) -> cython.void:
    """Set each border cell's cost to that of the path to a goal outside, minus the goal's distance ``least``."""
    rows: cython.Py_ssize_t = costs.shape[0] - 2
    columns: cython.Py_ssize_t = costs.shape[1] - 2
    cython.declare(row=cython.Py_ssize_t, column=cython.Py_ssize_t)
    cython.declare(away=cython.double)
    with cython.nogil:
        for row in range(rows):
            for column in range(columns):
                if 0 < row < rows - 1 and 0 < column < columns - 1:
                    continue
                away = _length(goal_row - row, goal_column - column) - least
                if _length(before_row - row, before_column - column) > _KEPT_NEAR:
                    away += _KEPT
                costs[row + 1, column + 1] = cython.cast(cython.int, away * _STRAIGHT * _OPEN)


@cython.cfunc
@cython.boundscheck(False)
@cython.wraparound(False)
def _spread(
    distances: cython.const[cython.float][::1],
    unseen: cython.const[cython.uchar][::1],
    offsets: cython.const[cython.int][::1],
    begin: cython.int,
    radius: cython.double,
    influence: cython.double,
    costs: cython.int[::1],
    next_cell: cython.int[::1],
) -> cython.void:
    """Run Dial's algorithm from the cells with a cost to the robot's cell; ``next_cell`` gets each cell's successor.

    The grid is flat. The border's cells cost less than 0, so that no path leads there, and neighbors need no check.

    The open list is a ring of buckets, each a list of entries. Waiting costs differ by less than the ring, because no
    exit and no step (1500 * 10) costs as much. So each cell is handled once, and nine entries per cell are enough: its
    own, and one from each neighbor.
    """
    size: cython.int = costs.shape[0]
    heads: cython.int[::1] = np.full(_RING, -1, np.int32).data
    entries: cython.int[:, ::1] = np.empty((9 * size, 2), np.int32).data  # cell, next entry
    used: cython.int = 0
    total: cython.int = 0
    cython.declare(waiting=cython.int, entry=cython.int, cell=cython.int, other=cython.int, direction=cython.int)
    cython.declare(cost=cython.int, weight=cython.int)
    with cython.nogil:
        for cell in range(size):
            if 0 <= costs[cell] < _UNREACHED:
                entries[used, 0] = cell
                entries[used, 1] = heads[costs[cell] & _IN_RING]
                heads[costs[cell] & _IN_RING] = used
                used += 1
        waiting = used
        while waiting:
            entry = heads[total & _IN_RING]
            if entry < 0:
                total += 1
                continue
            heads[total & _IN_RING] = entries[entry, 1]
            waiting -= 1
            cell = entries[entry, 0]
            if costs[cell] != total:
                continue
            if cell == begin:
                break
            weight = _weight(distances[cell], unseen[cell], radius, influence)
            for direction in range(8):
                other = cell + offsets[direction]
                cost = total + weight * (_STRAIGHT if direction < 4 else _DIAGONAL)
                if cost >= costs[other]:
                    continue
                costs[other] = cost
                next_cell[other] = cell
                entries[used, 0] = other
                entries[used, 1] = heads[cost & _IN_RING]
                heads[cost & _IN_RING] = used
                used += 1
                waiting += 1


@cython.cfunc
def _count(next_cell: cython.const[cython.int][::1], begin: cython.Py_ssize_t) -> cython.Py_ssize_t:
    """Count the cells of the path from the robot's cell."""
    count: cython.Py_ssize_t = 0
    cell: cython.Py_ssize_t = begin
    with cython.nogil:
        while cell >= 0:
            count += 1
            cell = next_cell[cell]
    return count


@cython.cfunc
@cython.cdivision(True)
def _lay(
    distances: cython.const[cython.float][:, ::1],
    next_cell: cython.const[cython.int][::1],
    begin: cython.Py_ssize_t,
    radius: cython.double,
    path: cython.int[:, ::1],
) -> cython.double:
    """Write the path down to ``path``; return the distance along it to the first blocked cell, or infinity."""
    wide: cython.Py_ssize_t = distances.shape[1] + 2
    cell: cython.Py_ssize_t = begin
    length: cython.double = 0.0
    blocked: cython.double = _INFINITE
    left: cython.bint = False
    cython.declare(inside=cython.bint)
    cython.declare(place=cython.Py_ssize_t, row=cython.Py_ssize_t, column=cython.Py_ssize_t)
    with cython.nogil:
        for place in range(path.shape[0]):
            row, column = cell // wide - 1, cell % wide - 1
            path[place, 0] = row
            path[place, 1] = column
            if place:
                length += _length(row - path[place - 1, 0], column - path[place - 1, 1])
            inside = distances[row, column] < radius - _ROUNDED
            left = left or not inside  # a robot that is too close to an obstacle may leave it
            if inside and left and blocked == _INFINITE:
                blocked = length
            cell = next_cell[cell]
    return blocked


@cython.cfunc
def _aim(
    distances: cython.const[cython.float][:, ::1],
    path: cython.const[cython.int][:, ::1],
    radius: cython.double,
    spare: cython.double,
    leave: cython.bint,
) -> cython.Py_ssize_t:
    """Return the index in ``path`` of the farthest cell with a free straight line, if necessary without ``spare``.

    With ``leave``, a path that begins without ``spare`` is followed to its first cell that has it.
    """
    least: cython.Py_ssize_t = min(_SHORTEST, path.shape[0] - 1)
    place: cython.Py_ssize_t
    attempt: cython.int
    room: cython.double = radius + spare
    with cython.nogil:
        if leave and distances[path[0, 0], path[0, 1]] < room:
            for place in range(least, path.shape[0]):
                if distances[path[place, 0], path[place, 1]] >= room:
                    if _line_free(distances, path[0, 0], path[0, 1], path[place, 0], path[place, 1], radius):
                        return place
                    break
        for attempt in range(2):
            room = radius + spare if attempt == 0 else radius
            for place in range(path.shape[0] - 1, least, -1):
                if _line_free(distances, path[0, 0], path[0, 1], path[place, 0], path[place, 1], room):
                    return place
    return least
