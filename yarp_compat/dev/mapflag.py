"""The cells of a map, with a flag and an occupancy each, and their colors in images.

Images have a color for each flag, and a gray for each occupancy (`yarp/dev/MapGrid2D.cpp`).
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

MAX_CELLS = 1 << 26  # larger maps (over 8,192 squared) are rejected, whatever their source
UNKNOWN = 255  # the occupancy of unknown cells


class MapFlag(IntEnum):
    """The meaning of a cell for planners."""

    FREE = 0
    KEEP_OUT = 1
    TEMPORARY_OBSTACLE = 2
    ENLARGED_OBSTACLE = 3
    WALL = 4
    UNKNOWN = 5


_BLOCK = 1 << 20  # cells per step, so that intermediate results stay in the cache
_FEW = 2  # up to this number of edges, comparing is faster than a lookup

_OCCUPANCY = np.array([0] * MapFlag.WALL + [100] + [UNKNOWN] * 251, np.uint8)
_FLAG = np.array([MapFlag.FREE] * 50 + [MapFlag.WALL] * 51 + [MapFlag.UNKNOWN] * 155, np.uint8)


def lookup(cells: NDArray[np.uint8], table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Look up each cell in a table of 256 numbers: ``table[cells]``, but ten times as fast."""
    edges = np.flatnonzero(table[1:] != table[:-1]) + 1
    if 1 <= len(edges) <= _FEW:
        return _compare(cells, table, edges)
    return np.frombuffer(bytearray(cells).translate(table.tobytes()), np.uint8).reshape(cells.shape)


def _compare(cells: NDArray[np.uint8], table: NDArray[np.uint8], edges: NDArray[np.intp]) -> NDArray[np.uint8]:
    """Look up cells by comparisons, in a table with few edges (numbers whose entry differs from the previous one)."""
    flat = np.ascontiguousarray(cells).reshape(-1)
    values = np.empty_like(flat)
    room = np.empty(min(_BLOCK, flat.size), np.uint8)
    falls = not table[-1]  # sum up the steps from the last entry if it is 0: no base has to be added then
    compared, base = (np.less, table[-1]) if falls else (np.greater_equal, table[0])
    rises = table[:-1] - table[1:] if falls else table[1:] - table[:-1]
    first, *others = [(np.uint8(edge), rises[edge - 1]) for edge in edges]
    for at in range(0, flat.size, _BLOCK):
        part, result = flat[at : at + _BLOCK], values[at : at + _BLOCK]
        reached = room[: len(part)]
        compared(part, first[0], out=reached.view(bool))
        np.multiply(reached, first[1], out=result)
        for edge, rise in others:
            compared(part, edge, out=reached.view(bool))
            result += np.multiply(reached, rise, out=reached)
        if base:
            result += base
    return values.reshape(cells.shape)


def occupancy_of(flags: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the occupancy that YARP assumes for flags: 100 for walls, 255 for unknown, else 0."""
    return lookup(flags, _OCCUPANCY)


def flags_of(occupancy: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the flags that YARP assumes for an occupancy: free below 50, wall up to 100, else unknown."""
    return lookup(occupancy, _FLAG)


def too_large(width: int, height: int) -> str:
    """Return the error text for a map with too many cells."""
    return f"a map of {width} x {height} cells is too large: the limit is {MAX_CELLS} cells"


COLORS = {
    MapFlag.FREE: (254, 254, 254),
    MapFlag.KEEP_OUT: (255, 0, 0),
    MapFlag.TEMPORARY_OBSTACLE: (100, 100, 200),
    MapFlag.ENLARGED_OBSTACLE: (255, 200, 0),
    MapFlag.WALL: (0, 0, 0),
    MapFlag.UNKNOWN: (205, 205, 205),
}
"""Red, green, blue."""

_INVALID = (200, 0, 200)
_UNKNOWN_GRAY = 205
_CHUNK = 1 << 16  # cells per step, so that intermediate results stay in the cache


FLAG_COLORS = np.array([*COLORS.values(), *[_INVALID] * (256 - len(COLORS))], np.uint8)
"""The color of each flag, and of invalid values."""

GRAYS = np.array([254 - occupancy * 254 // 100 for occupancy in range(101)] + [_UNKNOWN_GRAY] * 155, np.uint8)
"""The gray of each occupancy."""

OCCUPANCIES = np.round((254 - np.arange(256)) / 2.54).astype(np.int16).astype(np.uint8)
OCCUPANCIES[GRAYS[:101]] = np.arange(101)
OCCUPANCIES[[_UNKNOWN_GRAY, 255]] = UNKNOWN
"""The occupancy of each gray: the occupancy of the nearest gray in `GRAYS`; unknown for 205 and 255."""

_NUMBERS = {red | green << 8 | blue << 16: flag for flag, (red, green, blue) in COLORS.items()}


def picture_of_flags(flags: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the colors of cells, (height, width, 3)."""
    picture = np.empty((*flags.shape, 3), np.uint8)
    for channel in range(3):
        picture[..., channel] = lookup(flags, FLAG_COLORS[:, channel])
    return picture


def flags_of_picture(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the flags of colors, (height, width); any other color is unknown."""
    flat = np.ascontiguousarray(picture).reshape(-1)
    flags = np.empty(flat.size // 3, np.uint8)
    for at in range(0, len(flags), _CHUNK):
        colors = np.zeros(3 * _CHUNK + 1, np.uint8)
        part = flat[3 * at : 3 * (at + _CHUNK)]
        colors[: len(part)] = part
        # each color's three bytes and the first byte of the next, as a number
        numbers = np.ndarray(len(part) // 3, "<u4", colors, strides=(3,)) & 0xFFFFFF
        decoded = np.full(len(numbers), MapFlag.UNKNOWN, np.uint8)
        for number, flag in _NUMBERS.items():
            decoded -= (numbers == number) * np.uint8(MapFlag.UNKNOWN - flag)
        flags[at : at + len(decoded)] = decoded
    return flags.reshape(picture.shape[:2])
