"""What the cells of a map say: a flag each, and how surely they are occupied."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

MAX_CELLS = 1 << 26
"""A map of more cells (8,192 squared) is refused, wherever it comes from."""

UNKNOWN = 255
"""The occupancy of cells of which nothing is known."""


class MapFlag(IntEnum):
    """What a cell is, to those who plan ways."""

    FREE = 0
    KEEP_OUT = 1
    TEMPORARY_OBSTACLE = 2
    ENLARGED_OBSTACLE = 3
    WALL = 4
    UNKNOWN = 5


def _occupancy_by_flag() -> NDArray[np.uint8]:
    table = np.full(256, UNKNOWN, np.uint8)
    table[: MapFlag.WALL] = 0
    table[MapFlag.WALL] = 100
    return table


def _flag_by_occupancy() -> NDArray[np.uint8]:
    table = np.full(256, MapFlag.UNKNOWN, np.uint8)
    table[:50] = MapFlag.FREE
    table[50:101] = MapFlag.WALL
    return table


_BLOCK = 1 << 20  # cells at once, so that what lies between stays in the cache
_FEW = 2
"""A table of so many edges is quicker to compare with than to look up in."""

_OCCUPANCY, _FLAG = _occupancy_by_flag(), _flag_by_occupancy()


def looked_up(cells: NDArray[np.uint8], table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """What a table of 256 numbers has for each cell; as ``table[cells]``, ten times as fast."""
    edges = np.flatnonzero(table[1:] != table[:-1]) + 1
    if 1 <= len(edges) <= _FEW:
        return _risen(cells, table, edges)
    return np.frombuffer(bytearray(cells).translate(table.tobytes()), np.uint8).reshape(cells.shape)


def _risen(cells: NDArray[np.uint8], table: NDArray[np.uint8], edges: NDArray[np.intp]) -> NDArray[np.uint8]:
    """The same where the table has few edges, each of them the first number of a step: compared, not looked up."""
    flat = np.ascontiguousarray(cells).reshape(-1)
    found = np.empty_like(flat)
    room = np.empty(min(_BLOCK, flat.size), np.uint8)
    falls = not table[-1]  # counted from the end that is 0 if there is one, so that nothing is to be added to all
    compared, base = (np.less, table[-1]) if falls else (np.greater_equal, table[0])
    rises = table[:-1] - table[1:] if falls else table[1:] - table[:-1]
    first, *others = [(np.uint8(edge), rises[edge - 1]) for edge in edges]
    for at in range(0, flat.size, _BLOCK):
        part, result = flat[at : at + _BLOCK], found[at : at + _BLOCK]
        reached = room[: len(part)]
        compared(part, first[0], out=reached.view(bool))
        np.multiply(reached, first[1], out=result)
        for edge, rise in others:
            compared(part, edge, out=reached.view(bool))
            result += np.multiply(reached, rise, out=reached)
        if base:
            result += base
    return found.reshape(cells.shape)


def occupancy_of(flags: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """What YARP takes for the occupancy where it has flags only: 100 for walls, 255 for unknown, else 0."""
    return looked_up(flags, _OCCUPANCY)


def flags_of(occupancy: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """What YARP takes for the flags where it has an occupancy only: free below 50, wall up to 100, else unknown."""
    return looked_up(occupancy, _FLAG)


def too_large(width: int, height: int) -> str:
    """What is said of a map of more cells than are taken."""
    return f"a map of {width} x {height} cells: up to {MAX_CELLS} are taken"
