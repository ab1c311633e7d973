"""The shortest way out of where a robot should not be: beside a wall, or where robots are kept out."""

from __future__ import annotations

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.astar import Cells, Weights
from navigation.robot_path_planner.ground import Cell

_STUCK = 2
"""Cells around the start in which walls do not matter: localisation is not better than that."""

_STEPS = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]


def escape(weights: Weights, solid: NDArray[np.bool_], start: Cell) -> Cells | None:
    """The shortest way from a cell to one where the robot may be.

    Args:
        weights: (rows, columns) 0 where the robot is not to be.
        solid: (rows, columns) what cannot be driven through at all.
        start: row and column.

    Returns:
        (n, 2) the cells of the way, from the start on; None where there is none.
    """
    rows, columns = weights.shape
    lengths, came = {start: 0.0}, {start: start}
    waiting = [(0.0, start)]
    while waiting:
        length, cell = heapq.heappop(waiting)
        if length > lengths[cell]:
            continue
        if weights[cell]:
            return _tracked(came, cell)
        for row, column in _STEPS:
            other = cell[0] + row, cell[1] + column
            if not (0 <= other[0] < rows and 0 <= other[1] < columns):
                continue
            near = max(abs(other[0] - start[0]), abs(other[1] - start[1])) <= _STUCK
            found = length + math.hypot(row, column)
            if (near or not solid[other]) and found < lengths.get(other, math.inf):
                lengths[other], came[other] = found, cell
                heapq.heappush(waiting, (found, other))
    return None


def _tracked(came: dict[Cell, Cell], cell: Cell) -> Cells:
    found = [cell]
    while came[cell] != cell:
        cell = came[cell]
        found.append(cell)
    return np.array(found[::-1], np.int32)
