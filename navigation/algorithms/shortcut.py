"""A way of cells turned into few waypoints with free lines of sight between them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np

from bridge.messages.cache import compiled
from navigation.algorithms.astar import Cells, Weights

F = TypeVar("F", bound=Callable[..., Any])
_njit: Any = numba.njit


def _inner(function: F) -> F:
    """For what other compiled functions call."""
    made: F = _njit(function)
    return made


def shortcut(weights: Weights, cells: Cells) -> Cells:
    """The waypoints of a way: each sees the next one, and the straight line costs no more than the way between them.

    Args:
        weights: (rows, columns) what entering a cell costs; 0 is an obstacle.
        cells: (n, 2) rows and columns of a way, as `navigation.algorithms.astar.astar` gives it.

    Returns:
        (m, 2) some of its cells: the first, the last, and where it turns.
    """
    if len(cells) < 3:
        return cells
    chosen = np.empty(len(cells), np.int64)
    count = _compiled()[0](np.ascontiguousarray(weights), np.ascontiguousarray(cells), chosen)
    return cells[chosen[:count]]


def sees(weights: Weights, one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether the line between two cells' centres touches no obstacle but the first cell's own."""
    return bool(_compiled()[1](np.ascontiguousarray(weights), *one, *other) < math.inf)


def _choose(weights: Weights, cells: Cells, chosen: Any) -> int:
    """Put the places of the waypoints into ``chosen``; how many they are. Doubles its steps, then halves them."""
    last = len(cells) - 1
    sums = np.zeros(len(cells))
    for i in range(1, len(cells)):
        straight = cells[i, 0] == cells[i - 1, 0] or cells[i, 1] == cells[i - 1, 1]
        sums[i] = sums[i - 1] + weights[cells[i, 0], cells[i, 1]] * (1.0 if straight else math.sqrt(2.0))
    at, count = 0, 1
    chosen[0] = 0
    while at < last:
        good, step = at + 1, 2
        bad = last + 1
        while good < last:
            tried = min(at + step, last)
            if _fits(weights, cells, sums, at, tried):
                good = tried
                step *= 2
            else:
                bad = tried
                break
        while bad - good > 1:
            tried = (good + bad) // 2
            if _fits(weights, cells, sums, at, tried):
                good = tried
            else:
                bad = tried
            if bad > last:
                break
        at = good
        chosen[count] = at
        count += 1
    return count


@_inner
def _fits(weights: Weights, cells: Cells, sums: Any, one: int, other: int) -> bool:
    line = _line_cost(weights, cells[one, 0], cells[one, 1], cells[other, 0], cells[other, 1])
    return bool(line <= (sums[other] - sums[one]) * (1.0 + 1e-9))


@_inner
def _line_cost(weights: Weights, row: int, column: int, to_row: int, to_column: int) -> float:
    """Length times mean weight of the cells that a line touches after its first; infinite where one is an obstacle.

    A line through a corner touches all four cells there.
    """
    high, wide = abs(to_row - row), abs(to_column - column)
    down, right = (1 if to_row > row else -1), (1 if to_column > column else -1)
    error = wide - high
    total, touched = 0.0, 0
    while row != to_row or column != to_column:
        if error > 0:
            column += right
            error -= 2 * high
        elif error < 0:
            row += down
            error += 2 * wide
        else:
            if weights[row + down, column] == 0 or weights[row, column + right] == 0:
                return math.inf
            row += down
            column += right
            error += 2 * (wide - high)
        weight = weights[row, column]
        if weight == 0:
            return math.inf
        total += weight
        touched += 1
    return 0.0 if touched == 0 else math.sqrt(high * high + wide * wide) * total / touched


@cache
def _compiled() -> tuple[Any, Any]:
    grid = numba.types.Array(numba.uint8, 2, "C")
    cells, places = numba.types.Array(numba.int32, 2, "C"), numba.types.Array(numba.int64, 1, "C")
    here = [Path(__file__)]
    line_cost: Any = _line_cost
    return (
        compiled(_choose, numba.int64(grid, cells, places), here, nogil=True),
        compiled(line_cost.py_func, numba.float64(grid, *[numba.int64] * 4), here, nogil=True),
    )
