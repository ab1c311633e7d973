"""An OccupancyGrid's numbers of a map's, and back: compiled, so that it runs as fast as memory.

Conditions are joined by ``&`` and ``|``, and the loops over a row stand alone: only so does the compiler take many
cells at once, which is ten times as fast.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numba
from numpy.typing import NDArray

from bridge.messages.cache import compiled

Cells = NDArray[Any]

_jit: Any = numba.njit
_source = numba.types.Array(numba.uint8, 2, "C", readonly=True)
_target = numba.uint8[:, ::1]


def _join_row(occupancy: Cells, flags: Cells, values: Cells) -> None:
    for column in range(occupancy.size):
        cell, flag = occupancy[column], flags[column]
        # 4 is a wall, 5 is unknown
        stays = (cell <= 100) & (flag != 5) & ((cell >= 50) | (flag != 4))
        other = 100 if flag == 4 else 255
        values[column] = cell if stays else other


def _part_row(values: Cells, occupancy: Cells, flags: Cells) -> None:
    for column in range(values.size):
        cell = values[column]
        beyond = cell > 100
        occupancy[column] = 255 if beyond else cell
        flags[column] = (4 if cell >= 50 else 0) | (1 if beyond else 0)  # 4 is a wall, 5 is unknown


_UNCOUNTED = {"_nrt": False}
"""Of numba: no counts of who holds the rows, which took half of the time where they are short; nothing is kept here."""

_joined_row, _parted_row = _jit(**_UNCOUNTED)(_join_row), _jit(**_UNCOUNTED)(_part_row)


def _join(occupancy: Cells, flags: Cells, values: Cells) -> None:
    height = len(occupancy)
    for row in range(height):
        _joined_row(occupancy[row], flags[row], values[height - 1 - row])


def _part(values: Cells, occupancy: Cells, flags: Cells) -> None:
    height = len(values)
    for row in range(height):
        _parted_row(values[height - 1 - row], occupancy[row], flags[row])


@cache
def joining() -> Any:
    """``(occupancy, flags, values)``: fills the values of a grid, rows from the bottom up, of a map's cells."""
    return compiled(_join, numba.void(_source, _source, _target), [Path(__file__)], **_UNCOUNTED)


@cache
def parting() -> Any:
    """``(values, occupancy, flags)``: fills a map's cells of the values of a grid, 255 for -1."""
    return compiled(_part, numba.void(_source, _target, _target), [Path(__file__)], **_UNCOUNTED)
