"""How far each cell is from the nearest obstacle: the exact Euclidean distance transform.

Two passes of lower envelopes of parabolas, linear in the number of cells (Felzenszwalb and Huttenlocher, "Distance
Transforms of Sampled Functions", Theory of Computing 8, 2012).
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from bridge.messages.cache import compiled

Distances = NDArray[np.float32]


def distance_transform(obstacles: NDArray[np.bool_]) -> Distances:
    """The distance of each cell's centre to the nearest obstacle's, in cells; infinite where there is none.

    Args:
        obstacles: (rows, columns).
    """
    squares = np.empty(obstacles.shape, np.float32)
    _compiled()(np.ascontiguousarray(obstacles), squares)
    return np.sqrt(squares, out=squares)


def _transform(obstacles: NDArray[np.bool_], out: Distances) -> None:
    """Squared distances: first along columns, by counting, then along rows, by envelopes."""
    rows, columns = obstacles.shape
    none = rows + columns
    steps = np.empty((rows, columns), np.int32)
    for column in range(columns):
        steps[0, column] = 0 if obstacles[0, column] else none
    for row in range(1, rows):
        for column in range(columns):
            steps[row, column] = 0 if obstacles[row, column] else min(steps[row - 1, column] + 1, none)
    for row in range(rows - 2, -1, -1):
        for column in range(columns):
            steps[row, column] = min(steps[row, column], steps[row + 1, column] + 1)
    places = np.empty(columns, np.int64)
    begins = np.empty(columns + 1, np.float64)
    for row in range(rows):
        count = 0
        for column in range(columns):
            if steps[row, column] >= none:
                continue
            height = float(steps[row, column]) ** 2
            begin = -np.inf
            while count:
                last = places[count - 1]
                lower = float(steps[row, last]) ** 2
                begin = (height + column * column - lower - last * last) / (2.0 * (column - last))
                if begin > begins[count - 1]:
                    break
                count -= 1
            if count == 0:
                begin = -np.inf
            places[count], begins[count] = column, begin
            count += 1
        if count == 0:
            for column in range(columns):
                out[row, column] = np.inf
            continue
        begins[count] = np.inf
        at = 0
        for column in range(columns):
            while begins[at + 1] < column:
                at += 1
            away = column - places[at]
            out[row, column] = away * away + float(steps[row, places[at]]) ** 2


@cache
def _compiled() -> Any:
    grid = numba.types.Array(numba.boolean, 2, "C")
    return compiled(
        _transform, numba.void(grid, numba.types.Array(numba.float32, 2, "C")), [Path(__file__)], nogil=True
    )
