"""The pictures of a map: a colour for each flag, a grey for each occupancy (`yarp/dev/MapGrid2D.cpp`).

YARP itself reads only the colours of walls, unknown, free and keep-out cells, and of the greys only black; here all
that it writes comes back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev.mapflag import UNKNOWN, MapFlag, looked_up

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


def _by_flag() -> NDArray[np.uint8]:
    table = np.full((256, 3), _INVALID, np.uint8)
    for flag, colour in COLOURS.items():
        table[flag] = colour
    return table


def _greys() -> NDArray[np.uint8]:
    table = np.full(256, _UNKNOWN_GREY, np.uint8)
    table[:101] = 254 - np.arange(101) * 254 // 100
    return table


def _occupancies() -> NDArray[np.uint8]:
    table = np.round((254 - np.arange(256)) / 2.54).astype(np.int16)
    table[GREYS[:101]] = np.arange(101)
    table[[_UNKNOWN_GREY, 255]] = UNKNOWN
    return table.astype(np.uint8)


FLAG_COLOURS = _by_flag()
"""The colour of each flag, and of what is none."""

GREYS = _greys()
"""The grey of each occupancy."""

OCCUPANCIES = _occupancies()
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
