"""Shortest paths on a grid: A* with eight neighbors, without cutting corners.

Steps cost 70 straight and 99 diagonally, times the weight of the cell that is entered: integers whose ratio is the
square root of two within 0.006 %. Because costs are integers, the open list is not a heap but a ring of buckets, which
takes constant time (Dial 1969; A*: Hart, Nilsson, Raphael 1968). A diagonal step needs both adjacent cells to be free,
since a robot is not a point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cython
import numpy as np
from numpy.typing import NDArray

STRAIGHT, DIAGONAL = 70, 99
MAX_CELLS = 2**28
"""Larger grids are rejected; this size needs about 3 GB of memory."""

Cell = tuple[int, int]
Cells = NDArray[np.int32]
Weights = NDArray[np.uint8]

_STRAIGHT = cython.declare(cython.longlong, STRAIGHT)
_DIAGONAL = cython.declare(cython.longlong, DIAGONAL)
_ENTRIES = cython.declare(cython.longlong, 4096)
_MOST_ENTRIES = cython.declare(cython.longlong, 2**30)
_Cost: Any = cython.fused_type(cython.int, cython.longlong)


@dataclass(frozen=True, eq=False)
class GridWay:
    """A path on a grid."""

    cells: Cells  #: (n, 2) rows and columns, from the start to the goal, both included
    # sum of the steps, each times the weight of the cell that it enters; a straight step into weight 1 counts 1
    cost: float

    @property
    def length(self) -> float:
        """The path's length in cells; a diagonal step counts as the square root of two."""
        steps = np.abs(np.diff(self.cells, axis=0)).sum(axis=1)
        return float((steps == 1).sum() + np.sqrt(2.0) * (steps == 2).sum())


def astar(weights: Weights, start: Cell, goal: Cell) -> GridWay | None:
    """Return the cheapest path between two cells.

    Args:
        weights: (rows, columns) the cost of entering each cell, 1 for the cheapest; 0 is an obstacle.
        start: row and column. It may be on an obstacle, since the robot may be there.
        goal: row and column.

    Returns:
        the path, or None if there is none.

    Raises:
        ValueError: a cell is outside the grid, or the grid is empty or too large.
    """
    rows, columns = weights.shape
    if not 0 < rows * columns <= MAX_CELLS:
        raise ValueError(f"a grid must have 1 to {MAX_CELLS} cells, not {rows} x {columns}")
    for name, (row, column) in (("start", start), ("goal", goal)):
        if not (0 <= row < rows and 0 <= column < columns):
            raise ValueError(f"the {name} ({row}, {column}) is outside the grid of {rows} x {columns} cells")
    if not weights[goal]:
        return None
    padded = np.zeros((rows + 2, columns + 2), np.uint8)
    padded[1:-1, 1:-1] = weights
    heaviest = int(padded.max())
    wide = columns + 2
    first, last = ((row + 1) * wide + column + 1 for row, column in (start, goal))
    step_into = np.empty(padded.size, np.uint8).data
    # the largest possible cost decides the width of the stored costs
    small = rows * columns * heaviest * DIAGONAL < 2**31 - 1
    cost = _cost(padded.reshape(-1).data, wide, first, last, heaviest, small, step_into)
    if cost < 0:
        return None
    cells = np.empty((_count(step_into, wide, first, last), 2), np.int32)
    _track(step_into, wide, last, cells.data)
    return GridWay(cells, cost / STRAIGHT)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _offset(direction: cython.longlong, wide: cython.longlong) -> cython.longlong:
    """Return the offset of a neighbor: right, left, down, up, then the diagonals."""
    return _down(direction) * wide + _right(direction)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _down(direction: cython.longlong) -> cython.longlong:
    return (direction == 2) - (direction == 3) if direction < 4 else 1 - (direction & 2)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _right(direction: cython.longlong) -> cython.longlong:
    return (direction == 0) - (direction == 1) if direction < 4 else 1 - 2 * (direction & 1)


@cython.cfunc
def _count(
    step_into: cython.const[cython.uchar][::1], wide: cython.longlong, start: cython.longlong, goal: cython.longlong
) -> cython.longlong:
    """Count the cells of a path, by the steps with which each was entered."""
    cell: cython.longlong = goal
    count: cython.longlong = 1
    with cython.nogil:
        while cell != start:
            cell -= _offset(step_into[cell], wide)
            count += 1
    return count


@cython.cfunc
@cython.cdivision(True)
def _track(
    step_into: cython.const[cython.uchar][::1], wide: cython.longlong, goal: cython.longlong, cells: cython.int[:, ::1]
) -> cython.void:
    """Write the rows and columns of a path to ``cells``."""
    cell: cython.longlong = goal
    place: cython.Py_ssize_t
    with cython.nogil:
        for place in range(cells.shape[0] - 1, -1, -1):
            cells[place, 0] = cell // wide - 1
            cells[place, 1] = cell % wide - 1
            if place:
                cell -= _offset(step_into[cell], wide)


@cython.cfunc
def _cost(
    weights: cython.const[cython.uchar][::1],
    wide: cython.longlong,
    start: cython.longlong,
    goal: cython.longlong,
    heaviest: cython.longlong,
    small: cython.bint,
    step_into: cython.uchar[::1],
) -> cython.longlong:
    """Return the cost of the cheapest path, -1 without one; fill ``step_into`` with the step that entered each cell."""
    ints: cython.int[::1]
    longs: cython.longlong[::1]
    if small:
        ints = np.full(weights.shape[0], 2**31 - 1, np.int32).data
        return _search(weights, wide, start, goal, heaviest, ints, step_into)
    longs = np.full(weights.shape[0], 2**63 - 1, np.int64).data
    return _search(weights, wide, start, goal, heaviest, longs, step_into)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _estimate(down: cython.longlong, right: cython.longlong) -> cython.longlong:
    """Return the minimum cost of a path over a number of rows and columns."""
    down, right = abs(down), abs(right)
    if down < right:
        return _STRAIGHT * (right - down) + _DIAGONAL * down
    return _STRAIGHT * (down - right) + _DIAGONAL * right


@cython.cfunc
@cython.boundscheck(False)
@cython.wraparound(False)
@cython.initializedcheck(False)
@cython.cdivision(True)
def _search(
    weights: cython.const[cython.uchar][::1],
    wide: cython.longlong,
    start: cython.longlong,
    goal: cython.longlong,
    heaviest: cython.longlong,
    costs: _Cost[::1],
    step_into: cython.uchar[::1],
) -> cython.longlong:
    """Search as described in `_cost`. The grid is flat with a border of obstacles, and the start is not on the border.

    The open list is a ring of buckets by estimated total cost, each a list in a pool of entries. An entry whose cell
    has become cheaper meanwhile is skipped.

    No index needs a check: a cell is the start or has a weight, so that it is not on the border, and its neighbors are
    in the grid; a bucket is a remainder of a non-negative number; an entry is one that was allocated.
    """
    ring: cython.longlong = _DIAGONAL * (heaviest + 1) + 1
    heads: cython.int[::1] = np.full(ring, -1, np.int32).data
    room: cython.longlong = _ENTRIES
    pool = np.empty((room, 2), np.int32)
    entries: cython.int[:, ::1] = pool.data  # cell, next entry
    used: cython.longlong = 1
    spare: cython.longlong = -1
    waiting: cython.longlong = 1
    goal_row: cython.longlong = goal // wide
    goal_column: cython.longlong = goal % wide
    total: cython.longlong = _estimate(start // wide - goal_row, start % wide - goal_column)
    bucket: cython.longlong = total % ring
    cython.declare(entry=cython.longlong, cell=cython.longlong, other=cython.longlong, cost=cython.longlong)
    cython.declare(candidate=cython.longlong, weight=cython.longlong, row=cython.longlong, column=cython.longlong)
    cython.declare(down=cython.longlong, right=cython.longlong, place=cython.longlong, direction=cython.longlong)
    costs[start] = 0
    entries[0, 0] = start
    entries[0, 1] = -1
    heads[bucket] = 0
    with cython.nogil:
        while waiting:
            entry = heads[bucket]
            if entry < 0:
                total += 1
                bucket = bucket + 1 if bucket + 1 < ring else 0
                continue
            cell = entries[entry, 0]
            heads[bucket] = entries[entry, 1]
            entries[entry, 1] = spare
            spare = entry
            waiting -= 1
            cost = costs[cell]
            row, column = cell // wide, cell % wide
            if cost + _estimate(row - goal_row, column - goal_column) != total:
                continue
            if cell == goal:
                return cost
            for direction in range(8):
                down, right = _down(direction), _right(direction)
                other = cell + down * wide + right
                weight = weights[other]
                if weight == 0:
                    continue
                if direction < 4:
                    candidate = cost + _STRAIGHT * weight
                elif weights[cell + right] != 0 and weights[cell + down * wide] != 0:
                    candidate = cost + _DIAGONAL * weight
                else:
                    continue
                if candidate >= costs[other]:
                    continue
                costs[other] = candidate
                step_into[other] = direction
                place = (candidate + _estimate(row + down - goal_row, column + right - goal_column)) % ring
                if spare >= 0:
                    entry = spare
                    spare = entries[entry, 1]
                else:
                    if used == room:
                        with cython.gil:
                            if room > _MOST_ENTRIES:
                                raise MemoryError(
                                    f"a path on this grid needs more than {room} open cells; use a coarser map"
                                )
                            pool = np.concatenate((pool, np.empty_like(pool)))
                            entries = pool.data
                            room *= 2
                    entry = used
                    used += 1
                entries[entry, 0] = other
                entries[entry, 1] = heads[place]
                heads[place] = entry
                waiting += 1
    return -1
