"""The cells of a map: a flag and an occupancy each, and their colours in pictures.

A picture has a colour for each flag, a grey for each occupancy (`yarp/dev/MapGrid2D.cpp`).
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

MAX_CELLS = 1 << 26  # a map of more cells (8,192 squared) is refused, wherever it comes from
UNKNOWN = 255  # the occupancy of cells of which nothing is known


class MapFlag(IntEnum):
    """The meaning of a cell to planners."""

    FREE = 0
    KEEP_OUT = 1
    TEMPORARY_OBSTACLE = 2
    ENLARGED_OBSTACLE = 3
    WALL = 4
    UNKNOWN = 5


_BLOCK = 1 << 20  # cells at once, so that what lies between stays in the cache
_FEW = 2  # a table of so many edges is quicker to compare with than to look up in

_OCCUPANCY = np.array([0] * MapFlag.WALL + [100] + [UNKNOWN] * 251, np.uint8)
_FLAG = np.array([MapFlag.FREE] * 50 + [MapFlag.WALL] * 51 + [MapFlag.UNKNOWN] * 155, np.uint8)


def looked_up(cells: NDArray[np.uint8], table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Looks up each cell in a table of 256 numbers: ``table[cells]``, ten times as fast."""
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
    """The occupancy that YARP assumes where it has flags only: 100 for walls, 255 for unknown, else 0."""
    return looked_up(flags, _OCCUPANCY)


def flags_of(occupancy: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The flags that YARP assumes where it has an occupancy only: free below 50, wall up to 100, else unknown."""
    return looked_up(occupancy, _FLAG)


def too_large(width: int, height: int) -> str:
    """The error for a map of too many cells."""
    return f"a map of {width} x {height} cells: up to {MAX_CELLS} are taken"


COLOURS = {
    MapFlag.FREE: (254, 254, 254),
    MapFlag.KEEP_OUT: (255, 0, 0),
    MapFlag.TEMPORARY_OBSTACLE: (100, 100, 200),
    MapFlag.ENLARGED_OBSTACLE: (255, 200, 0),
    MapFlag.WALL: (0, 0, 0),
    MapFlag.UNKNOWN: (205, 205, 205),
}
"""Red, green, blue."""

_INVALID = (200, 0, 200)
_UNKNOWN_GREY = 205
_CHUNK = 1 << 16  # cells at once, so that what lies between stays in the cache


FLAG_COLOURS = np.array([*COLOURS.values(), *[_INVALID] * (256 - len(COLOURS))], np.uint8)
"""The colour of each flag, and of what is none."""

GREYS = np.array([254 - occupancy * 254 // 100 for occupancy in range(101)] + [_UNKNOWN_GREY] * 155, np.uint8)
"""The grey of each occupancy."""

OCCUPANCIES = np.round((254 - np.arange(256)) / 2.54).astype(np.int16).astype(np.uint8)
OCCUPANCIES[GREYS[:101]] = np.arange(101)
OCCUPANCIES[[_UNKNOWN_GREY, 255]] = UNKNOWN
"""The occupancy of each grey: that of the nearest which is written, and unknown for 205 and 255."""

_NUMBERS = {red | green << 8 | blue << 16: flag for flag, (red, green, blue) in COLOURS.items()}


def picture_of_flags(flags: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The colours of cells, of shape (height, width, 3)."""
    picture = np.empty((*flags.shape, 3), np.uint8)
    for channel in range(3):
        picture[..., channel] = looked_up(flags, FLAG_COLOURS[:, channel])
    return picture


def flags_of_picture(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The flags of colours, of shape (height, width); any other colour is unknown."""
    flat = np.ascontiguousarray(picture).reshape(-1)
    flags = np.empty(flat.size // 3, np.uint8)
    for at in range(0, len(flags), _CHUNK):
        colours = np.zeros(3 * _CHUNK + 1, np.uint8)
        part = flat[3 * at : 3 * (at + _CHUNK)]
        colours[: len(part)] = part
        # each colour's three bytes and the next one's first, as a number
        numbers = np.ndarray(len(part) // 3, "<u4", colours, strides=(3,)) & 0xFFFFFF
        found = np.full(len(numbers), MapFlag.UNKNOWN, np.uint8)
        for number, flag in _NUMBERS.items():
            found -= (numbers == number) * np.uint8(MapFlag.UNKNOWN - flag)
        flags[at : at + len(found)] = found
    return flags.reshape(picture.shape[:2])
