"""Shortest ways on a grid: A*, to eight neighbours, without cutting corners.

Steps cost 70 straight and 99 diagonally, times the weight of the cell that is entered: whole numbers whose ratio is the
square root of two within 5e-5. With them the open list is a ring of buckets instead of a heap, which takes constant
time (Dial 1969; A*: Hart, Nilsson, Raphael 1968). A diagonal step needs both cells beside it to be free, since a robot
is no point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from bridge.messages.cache import compiled

STRAIGHT, DIAGONAL = 70, 99
MAX_CELLS = 2**28
"""No grid larger than this is planned on: about 3 GB of memory."""

Cells = NDArray[np.int32]
Weights = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Way:
    """A way that was found.

    Attributes:
        cells: (n, 2) rows and columns, from the start to the goal, both included.
        cost: sum of its steps, each times the weight of the cell that it enters; a straight step into weight 1 is 1.
    """

    cells: Cells
    cost: float

    @property
    def length(self) -> float:
        """Its length in cells, a diagonal step being the square root of two."""
        steps = np.abs(np.diff(self.cells, axis=0)).sum(axis=1)
        return float((steps == 1).sum() + np.sqrt(2.0) * (steps == 2).sum())


def astar(weights: Weights, start: tuple[int, int], goal: tuple[int, int]) -> Way | None:
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
    heaviest = int(weights.max())
    wide = columns + 2
    here, there = ((row + 1) * wide + column + 1 for row, column in (start, goal))
    # what a way can cost at most decides how wide costs are kept
    kind = np.int32 if rows * columns * heaviest * DIAGONAL < 2**31 - 1 else np.int64
    costs = np.full(padded.size, np.iinfo(kind).max, kind)
    came = np.empty(padded.size, np.uint8)
    search, track = _compiled(kind)
    cost = search(padded.reshape(-1), wide, here, there, heaviest, costs, came)
    if cost < 0:
        return None
    return Way(track(came, wide, here, there), cost / STRAIGHT)


def _track(came: NDArray[np.uint8], wide: int, start: int, goal: int) -> Cells:
    """The cells from the start to the goal, by the steps with which each was entered."""
    offsets = np.array((1, -1, wide, -wide, wide + 1, wide - 1, 1 - wide, -wide - 1))
    cell, count = goal, 1
    while cell != start:
        cell -= offsets[came[cell]]
        count += 1
    cells = np.empty((count, 2), np.int32)
    cell = goal
    for place in range(count - 1, -1, -1):
        cells[place, 0], cells[place, 1] = cell // wide - 1, cell % wide - 1
        if place:
            cell -= offsets[came[cell]]
    return cells


def _search(
    weights: Weights, wide: int, start: int, goal: int, heaviest: int, costs: Any, came: NDArray[np.uint8]
) -> int:
    """The cost of the cheapest way, -1 where there is none; ``came`` gets the step that entered each cell.

    The grid is flat, with obstacles all round. The open list is a ring of buckets by estimated total cost, each a list
    in a pool of entries; an entry whose cell has since become cheaper is passed over when its turn comes.
    """
    ring = DIAGONAL * (heaviest + 1) + 1
    heads = np.full(ring, -1, np.int32)
    cells, nexts = np.empty(4096, np.int64), np.empty(4096, np.int32)
    made, spare, waiting = 0, -1, 0
    goal_row, goal_column = goal // wide, goal % wide
    d_row = np.array((0, 0, 1, -1, 1, 1, -1, -1))
    d_column = np.array((1, -1, 0, 0, 1, -1, 1, -1))
    costs[start] = 0
    far, near = max(abs(start // wide - goal_row), abs(start % wide - goal_column)), 0
    near = min(abs(start // wide - goal_row), abs(start % wide - goal_column))
    total = STRAIGHT * (far - near) + DIAGONAL * near
    cells[0], nexts[0], made, waiting = start, -1, 1, 1
    heads[total % ring] = 0
    while waiting:
        entry = heads[total % ring]
        if entry < 0:
            total += 1
            continue
        cell = cells[entry]
        heads[total % ring] = nexts[entry]
        nexts[entry] = spare
        spare = entry
        waiting -= 1
        cost = costs[cell]
        row, column = cell // wide, cell % wide
        far, near = abs(row - goal_row), abs(column - goal_column)
        if far < near:
            far, near = near, far
        if cost + STRAIGHT * (far - near) + DIAGONAL * near != total:
            continue
        if cell == goal:
            return int(cost)
        for way in range(8):
            step = d_row[way] * wide + d_column[way]
            other = cell + step
            weight = weights[other]
            if weight == 0:
                continue
            if way < 4:
                found = cost + STRAIGHT * weight
            elif weights[cell + d_column[way]] and weights[cell + d_row[way] * wide]:
                found = cost + DIAGONAL * weight
            else:
                continue
            if found >= costs[other]:
                continue
            costs[other], came[other] = found, way
            far, near = abs(row + d_row[way] - goal_row), abs(column + d_column[way] - goal_column)
            if far < near:
                far, near = near, far
            place = (found + STRAIGHT * (far - near) + DIAGONAL * near) % ring
            if spare >= 0:
                entry = spare
                spare = nexts[entry]
            else:
                if made == len(cells):
                    cells, nexts = np.append(cells, np.empty_like(cells)), np.append(nexts, np.empty_like(nexts))
                entry = made
                made += 1
            cells[entry], nexts[entry] = other, heads[place]
            heads[place] = entry
            waiting += 1
    return -1


@cache
def _compiled(kind: Any) -> tuple[Any, Any]:
    def array(of: Any) -> Any:
        return numba.types.Array(numba.from_dtype(np.dtype(of)), 1, "C")

    here, size = [Path(__file__)], numba.int64
    search = size(array(np.uint8), *[size] * 4, array(kind), array(np.uint8))
    track = numba.types.Array(numba.int32, 2, "C")(array(np.uint8), *[size] * 3)
    return compiled(_search, search, here, nogil=True), compiled(_track, track, here, nogil=True)
