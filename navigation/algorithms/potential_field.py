"""A potential field on a small grid: what it costs to the goal from each cell, and the way down it.

The goal attracts by distance, obstacles repel by what it costs to pass near to them. Summed along ways instead of at
each place by itself, the field has no minimum but the goal (navigation function NF1: Barraquand, Langlois, Latombe
1992), where the classical one (Khatib 1986) holds a robot before every hollow. Cells that cannot be entered cost much
instead of everything, so that a way is found even where one must wait for something to go.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from bridge.messages.cache import compiled

F = TypeVar("F", bound=Callable[..., Any])
_njit: Any = numba.njit

_STRAIGHT, _DIAGONAL = 7, 10
_OPEN, _UNSEEN, _NEAR, _TIGHT, _BLOCKED = 4, 8, 20, 60, 1500
_RING = 32768
_KEPT, _KEPT_NEAR = 20.0, 20.0
_SHORTEST = 4
_ROUNDED = 0.5
"""What distances between cells are wrong by, cells."""

_NOWHERE = (math.nan, math.nan)


@dataclass(frozen=True)
class Descent:
    """The way down from where the robot is.

    Attributes:
        cells: (n, 2) rows and columns, from the robot's cell to the goal's, or to the one where the window is left.
        aim: the place in ``cells`` of the farthest one to which a straight line is free.
        blocked: cells along the way to the first one that cannot be entered; infinite where there is none.
        cost: of the whole way, in cells of open floor.
        direct: whether a straight line to the goal itself is free; then no way is looked for, and ``cells`` is empty.
    """

    cells: NDArray[np.int32]
    aim: int
    blocked: float
    cost: float
    direct: bool


def _part(function: F) -> F:
    """Compile a function that is called by compiled ones alone."""
    made: F = _njit(function)
    return made


def descend(
    distances: NDArray[np.float32],
    unseen: NDArray[np.bool_],
    start: tuple[int, int],
    goal: tuple[float, float],
    before: tuple[float, float] | None,
    radius: float,
    influence: float,
    spare: float,
) -> Descent:
    """The way down the potential.

    Args:
        distances: (rows, columns) from each cell to the nearest obstacle, cells.
        unseen: (rows, columns) where nothing is known.
        start: the robot's row and column.
        goal: row and column, in cells; it may lie outside.
        before: where the way left the window last time: another exit must be better by 20 cells.
        radius: the robot's, cells.
        influence: from here on obstacles do not repel, cells.
        spare: what a straight line keeps beyond the radius, cells.
    """
    cells = np.empty((distances.size, 2), np.int32)
    found = np.empty(4)
    count = _compiled()(distances, unseen, *start, *goal, *(before or _NOWHERE), radius, influence, spare, cells, found)
    return Descent(cells[:count].copy(), int(found[0]), float(found[1]), float(found[2]), bool(found[3]))


@_part
def _line_free(
    distances: NDArray[np.float32], row: float, column: float, to_row: float, to_column: float, least: float
) -> bool:
    """Whether a straight line stays so far from obstacles; what lies outside does."""
    steps = math.ceil(2.0 * max(abs(to_row - row), abs(to_column - column))) + 1
    for step in range(steps + 1):
        share = step / steps
        r, c = round(row + (to_row - row) * share), round(column + (to_column - column) * share)
        if not (0 <= r < distances.shape[0] and 0 <= c < distances.shape[1]):
            return True
        if distances[r, c] < least:
            return False
    return True


@_part
def _weight(distance: float, unseen: bool, radius: float, influence: float) -> int:
    if distance < radius - _ROUNDED:
        return _BLOCKED
    if distance < radius + _ROUNDED:
        return _TIGHT
    weight = _UNSEEN if unseen else _OPEN
    if distance < influence:
        near = 1.0 - (distance - radius) / (influence - radius)
        weight += int(_NEAR * near * near)
    return weight


def _descend(
    distances: NDArray[np.float32],
    unseen: NDArray[np.bool_],
    start_row: int,
    start_column: int,
    goal_row: float,
    goal_column: float,
    before_row: float,
    before_column: float,
    radius: float,
    influence: float,
    spare: float,
    path: NDArray[np.int32],
    found: NDArray[np.float64],
) -> int:
    """Dial's algorithm from the goal, or from the window's rim, until the robot's cell is reached; then the way."""
    rows, columns = distances.shape
    found[3] = 1.0 if _line_free(distances, start_row, start_column, goal_row, goal_column, radius + spare) else 0.0
    if found[3]:
        found[0], found[1] = 0.0, math.inf
        found[2] = math.hypot(goal_row - start_row, goal_column - start_column)
        return 0
    size = rows * columns
    heads = np.full(_RING, -1, np.int32)
    cells, nexts = np.empty(9 * size, np.int32), np.empty(9 * size, np.int32)
    costs = np.full(size, 2**31 - 1, np.int32)
    came = np.full(size, -1, np.int32)
    made = 0
    row, column = round(goal_row), round(goal_column)
    least = 0.0
    if 0 <= row < rows and 0 <= column < columns:
        cell = row * columns + column
        costs[cell] = 0
        cells[0], nexts[0], heads[0], made = cell, -1, 0, 1
    else:
        least = math.hypot(max(0.0, -goal_row, goal_row - rows + 1), max(0.0, -goal_column, goal_column - columns + 1))
        for r in range(rows):
            for c in range(columns):
                if 0 < r < rows - 1 and 0 < c < columns - 1:
                    continue
                away = math.hypot(goal_row - r, goal_column - c) - least
                if math.hypot(before_row - r, before_column - c) > _KEPT_NEAR:
                    away += _KEPT
                cost = int(away * _STRAIGHT * _OPEN)
                cell = r * columns + c
                costs[cell] = cost
                cells[made], nexts[made] = cell, heads[cost % _RING]
                heads[cost % _RING] = made
                made += 1
    begin = start_row * columns + start_column
    d_row = (0, 0, 1, -1, 1, 1, -1, -1)
    d_column = (1, -1, 0, 0, 1, -1, 1, -1)
    waiting, total = made, 0
    while waiting:
        entry = heads[total % _RING]
        if entry < 0:
            total += 1
            continue
        heads[total % _RING] = nexts[entry]
        waiting -= 1
        cell = cells[entry]
        cost = costs[cell]
        if cost != total:
            continue
        if cell == begin:
            break
        row, column = cell // columns, cell % columns
        weight = _weight(distances[row, column], unseen[row, column], radius, influence)
        for way in range(8):
            r, c = row + d_row[way], column + d_column[way]
            if not (0 <= r < rows and 0 <= c < columns):
                continue
            other = r * columns + c
            cheaper = cost + weight * (_STRAIGHT if way < 4 else _DIAGONAL)
            if cheaper >= costs[other]:
                continue
            costs[other], came[other] = cheaper, cell
            cells[made], nexts[made] = other, heads[cheaper % _RING]
            heads[cheaper % _RING] = made
            made += 1
            waiting += 1
    found[2] = costs[begin] / (_STRAIGHT * _OPEN) + least
    return _walk(distances, came, columns, begin, radius, spare, path, found)


@_part
def _walk(
    distances: NDArray[np.float32],
    came: NDArray[np.int32],
    columns: int,
    begin: int,
    radius: float,
    spare: float,
    path: NDArray[np.int32],
    found: NDArray[np.float64],
) -> int:
    """Lay the way down into ``path``; ``found`` gets where to aim, and how far it is to what blocks the way."""
    count, cell = 0, begin
    length, blocked, left = 0.0, math.inf, False
    while cell >= 0:
        row, column = cell // columns, cell % columns
        path[count, 0], path[count, 1] = row, column
        if count:
            length += math.hypot(row - path[count - 1, 0], column - path[count - 1, 1])
        inside = distances[row, column] < radius - _ROUNDED
        left = left or not inside  # a robot that stands too near to something is free to leave
        if inside and left and blocked == math.inf:
            blocked = length
        count += 1
        cell = came[cell]
    aim = min(_SHORTEST, count - 1)
    for room in (radius + spare, radius):
        place = count - 1
        while place > aim and not _line_free(distances, path[0, 0], path[0, 1], path[place, 0], path[place, 1], room):
            place -= 1
        if place > aim:
            aim = place
            break
    found[0], found[1] = aim, blocked
    return count


@cache
def _compiled() -> Any:
    real, size = numba.float64, numba.int64
    signature = size(
        numba.types.Array(numba.float32, 2, "C"),
        numba.types.Array(numba.boolean, 2, "C"),
        size,
        size,
        *[real] * 7,
        numba.types.Array(numba.int32, 2, "C"),
        numba.types.Array(real, 1, "C"),
    )
    return compiled(_descend, signature, [Path(__file__)], nogil=True)
