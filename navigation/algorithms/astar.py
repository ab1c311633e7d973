"""Shortest ways on a grid: A*, to eight neighbours, without cutting corners.

Steps cost 70 straight and 99 diagonally, times the weight of the cell that is entered: whole numbers whose ratio is the
square root of two within 5e-5. With them the open list is a ring of buckets instead of a heap, which takes constant
time (Dial 1969; A*: Hart, Nilsson, Raphael 1968). A diagonal step needs both cells beside it to be free, since a robot
is no point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cython
import numpy as np
from numpy.typing import NDArray

STRAIGHT, DIAGONAL = 70, 99
MAX_CELLS = 2**28
"""No grid larger than this is planned on: about 3 GB of memory."""

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
    """A way that was found."""

    cells: Cells  #: (n, 2) rows and columns, from the start to the goal, both included
    # sum of its steps, each times the weight of the cell that it enters; a straight step into weight 1 is 1
    cost: float

    @property
    def length(self) -> float:
        """Its length in cells, a diagonal step being the square root of two."""
        steps = np.abs(np.diff(self.cells, axis=0)).sum(axis=1)
        return float((steps == 1).sum() + np.sqrt(2.0) * (steps == 2).sum())


def astar(weights: Weights, start: Cell, goal: Cell) -> GridWay | None:
    """The cheapest way from a cell to another.

    Args:
        weights: (rows, columns) what entering a cell costs, 1 for the cheapest; 0 is an obstacle.
        start: row and column. It may lie on an obstacle: a robot stands where it stands.
        goal: row and column.

    Returns:
        the way; None where there is none.

    Raises:
        ValueError: a cell lies outside, or the grid is empty or too large.
    """
    rows, columns = weights.shape
    if not 0 < rows * columns <= MAX_CELLS:
        raise ValueError(f"a grid has 1 to {MAX_CELLS} cells, not {rows} x {columns}")
    for name, (row, column) in (("start", start), ("goal", goal)):
        if not (0 <= row < rows and 0 <= column < columns):
            raise ValueError(f"the {name} ({row}, {column}) lies outside the grid of {rows} x {columns} cells")
    if not weights[goal]:
        return None
    padded = np.zeros((rows + 2, columns + 2), np.uint8)
    padded[1:-1, 1:-1] = weights
    heaviest = int(padded.max())
    wide = columns + 2
    here, there = ((row + 1) * wide + column + 1 for row, column in (start, goal))
    came = np.empty(padded.size, np.uint8).data
    # what a way can cost at most decides how wide costs are kept
    small = rows * columns * heaviest * DIAGONAL < 2**31 - 1
    cost = _cost(padded.reshape(-1).data, wide, here, there, heaviest, small, came)
    if cost < 0:
        return None
    cells = np.empty((_count(came, wide, here, there), 2), np.int32)
    _track(came, wide, there, cells.data)
    return GridWay(cells, cost / STRAIGHT)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _offset(way: cython.longlong, wide: cython.longlong) -> cython.longlong:
    """From a cell to a neighbour of it: right, left, down, up, then the diagonals."""
    return _down(way) * wide + _right(way)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _down(way: cython.longlong) -> cython.longlong:
    return (way == 2) - (way == 3) if way < 4 else 1 - (way & 2)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _right(way: cython.longlong) -> cython.longlong:
    return (way == 0) - (way == 1) if way < 4 else 1 - 2 * (way & 1)


@cython.cfunc
def _count(
    came: cython.const[cython.uchar][::1], wide: cython.longlong, start: cython.longlong, goal: cython.longlong
) -> cython.longlong:
    """How many cells a way has, by the steps with which each was entered."""
    cell: cython.longlong = goal
    count: cython.longlong = 1
    with cython.nogil:
        while cell != start:
            cell -= _offset(came[cell], wide)
            count += 1
    return count


@cython.cfunc
@cython.cdivision(True)
def _track(
    came: cython.const[cython.uchar][::1], wide: cython.longlong, goal: cython.longlong, cells: cython.int[:, ::1]
) -> cython.void:
    """Its rows and columns, put into ``cells``."""
    cell: cython.longlong = goal
    place: cython.Py_ssize_t
    with cython.nogil:
        for place in range(cells.shape[0] - 1, -1, -1):
            cells[place, 0] = cell // wide - 1
            cells[place, 1] = cell % wide - 1
            if place:
                cell -= _offset(came[cell], wide)


@cython.cfunc
def _cost(
    weights: cython.const[cython.uchar][::1],
    wide: cython.longlong,
    start: cython.longlong,
    goal: cython.longlong,
    heaviest: cython.longlong,
    small: cython.bint,
    came: cython.uchar[::1],
) -> cython.longlong:
    """The cost of the cheapest way, -1 where there is none; ``came`` gets the step that entered each cell."""
    ints: cython.int[::1]
    longs: cython.longlong[::1]
    if small:
        ints = np.full(weights.shape[0], 2**31 - 1, np.int32).data
        return _search(weights, wide, start, goal, heaviest, ints, came)
    longs = np.full(weights.shape[0], 2**63 - 1, np.int64).data
    return _search(weights, wide, start, goal, heaviest, longs, came)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _estimate(down: cython.longlong, right: cython.longlong) -> cython.longlong:
    """What a way costs at least, over so many rows and columns."""
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
    came: cython.uchar[::1],
) -> cython.longlong:
    """As `_cost` says. The grid is flat, with obstacles all round, and the start is not among these.

    The open list is a ring of buckets by estimated total cost, each a list in a pool of entries; an entry whose cell
    has since become cheaper is passed over when its turn comes.

    No index needs a check: a cell is the start or has a weight, so that it does not lie on the rim, and its neighbours
    lie in the grid; a bucket is a remainder of what is not negative; an entry is one that was made.
    """
    ring: cython.longlong = _DIAGONAL * (heaviest + 1) + 1
    heads: cython.int[::1] = np.full(ring, -1, np.int32).data
    room: cython.longlong = _ENTRIES
    pool = np.empty((room, 2), np.int32)
    entries: cython.int[:, ::1] = pool.data  # cell, next entry
    made: cython.longlong = 1
    spare: cython.longlong = -1
    waiting: cython.longlong = 1
    goal_row: cython.longlong = goal // wide
    goal_column: cython.longlong = goal % wide
    total: cython.longlong = _estimate(start // wide - goal_row, start % wide - goal_column)
    bucket: cython.longlong = total % ring
    cython.declare(entry=cython.longlong, cell=cython.longlong, other=cython.longlong, cost=cython.longlong)
    cython.declare(found=cython.longlong, weight=cython.longlong, row=cython.longlong, column=cython.longlong)
    cython.declare(down=cython.longlong, right=cython.longlong, place=cython.longlong, way=cython.longlong)
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
            for way in range(8):
                down, right = _down(way), _right(way)
                other = cell + down * wide + right
                weight = weights[other]
                if weight == 0:
                    continue
                if way < 4:
                    found = cost + _STRAIGHT * weight
                elif weights[cell + right] != 0 and weights[cell + down * wide] != 0:
                    found = cost + _DIAGONAL * weight
                else:
                    continue
                if found >= costs[other]:
                    continue
                costs[other] = found
                came[other] = way
                place = (found + _estimate(row + down - goal_row, column + right - goal_column)) % ring
                if spare >= 0:
                    entry = spare
                    spare = entries[entry, 1]
                else:
                    if made == room:
                        with cython.gil:
                            if room > _MOST_ENTRIES:
                                raise MemoryError(
                                    f"a way over this grid needs more than {room} open cells; use a coarser map"
                                )
                            pool = np.concatenate((pool, np.empty_like(pool)))
                            entries = pool.data
                            room *= 2
                    entry = made
                    made += 1
                entries[entry, 0] = other
                entries[entry, 1] = heads[place]
                heads[place] = entry
                waiting += 1
    return -1
