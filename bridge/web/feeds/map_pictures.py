"""Images of a map for pages: occupancy and flags, one byte per cell, with colors for light and dark pages."""

from __future__ import annotations

import hashlib
import io
import struct
import threading
import zlib
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

TILE = 1024
"""Width and height of a tile in cells; pages fetch only changed tiles."""
_CACHED_IMAGES = 2
"""Number of cached images of each kind; more than one, because a page may still fetch the previous image."""
_LEVELS, _UNKNOWN_CELL = 101, 101
"""Number of grays, which stand for 0 to 100 percent occupied; also the cell value for unknown cells."""
_DARK_FREE, _DARK_WALL = (0x14, 0x19, 0x1E), (0xA0, 0xB0, 0xBE)
_TINTS = {
    MapFlag.KEEP_OUT: (214, 40, 40, 110),
    MapFlag.TEMPORARY_OBSTACLE: (240, 140, 20, 120),
    MapFlag.ENLARGED_OBSTACLE: (150, 110, 200, 100),
}
"""Color and opacity of flags over the occupancy."""

Cells = NDArray[np.uint8]


@dataclass(frozen=True)
class Palette:
    """Colors of an image's cells: red, green, blue of each number, for light and dark pages, and the opacity."""

    light: bytes
    dark: bytes
    opacity: bytes


def _between(free: tuple[int, int, int], wall: tuple[int, int, int]) -> bytes:
    steps = np.linspace(free, wall, _LEVELS)
    return np.vstack([steps, [(0, 0, 0)]]).round().astype(np.uint8).tobytes()


_TINTED = bytes([0, 0, 0, *(part for tint in _TINTS.values() for part in tint[:3])])
PALETTES = {
    "occupancy": Palette(
        _between((255, 255, 255), (0, 0, 0)), _between(_DARK_FREE, _DARK_WALL), bytes([255] * _LEVELS + [0])
    ),
    "flags": Palette(_TINTED, _TINTED, bytes([0, *(tint[3] for tint in _TINTS.values())])),
}
CLEAR = {"occupancy": _UNKNOWN_CELL, "flags": 0}
"""The transparent cell value of each kind of image."""

_GRAYS = np.full(256, _UNKNOWN_CELL, np.uint8)
_GRAYS[:_LEVELS] = np.arange(_LEVELS)
_TINT_OF = np.zeros(256, np.uint8)
_TINT_OF[list(_TINTS)] = np.arange(1, len(_TINTS) + 1)


def occupancy_picture(grid: MapGrid2D) -> Cells:
    """Return the color of each cell (height, width): 0 free to 100 occupied, 101 unknown."""
    cells = _GRAYS[np.asarray(grid.occupancy, np.uint8)]
    cells[grid.flags == MapFlag.WALL] = _LEVELS - 1
    cells[grid.flags == MapFlag.UNKNOWN] = _UNKNOWN_CELL
    return cells


def flags_picture(grid: MapGrid2D) -> Cells | None:
    """Return the tint of each cell (height, width) by the flags that planners use, 0 for no tint; None if all are 0."""
    cells = _TINT_OF[grid.flags]
    return cells if cells.any() else None


class Pictures:
    """The newest map images, as PNG tiles that pages fetch by address. Safe to use from any thread."""

    def __init__(self, prefix: str = "") -> None:
        self._prefix = prefix
        self._lock = threading.Lock()
        self._cached: dict[str, deque[dict[str, bytes]]] = {name: deque(maxlen=_CACHED_IMAGES) for name in PALETTES}

    def put(self, name: str, cells: Cells) -> dict[str, Any]:
        """Cache an image and return its description for the page.

        ``{"size": width of a tile, "tiles": rows of addresses, null for a transparent tile}``

        An address depends on the tile's content, so an unchanged tile keeps its address and is not compressed again.
        """
        clear, packed, rows = CLEAR[name], dict[str, bytes](), []
        for top in range(0, cells.shape[0], TILE):
            rows.append(row := list[str | None]())
            for left in range(0, cells.shape[1], TILE):
                tile = np.ascontiguousarray(cells[top : top + TILE, left : left + TILE])
                if np.all(tile == clear):
                    row.append(None)
                    continue
                version = hashlib.sha256(b"%d " % tile.shape[1] + tile.tobytes()).hexdigest()[:12]
                packed[version] = self.get(name, version) or _png(tile, PALETTES[name])
                row.append(f"{self._prefix}/map/{name}.png?v={version}")
        with self._lock:
            self._cached[name].append(packed)
        return {"size": TILE, "tiles": rows}

    def get(self, name: str, version: str, *, dark: bool = False) -> bytes | None:
        """Return the PNG at an address, in the colors for dark or light pages; None if it has expired."""
        with self._lock:
            png = next((picture[version] for picture in self._cached.get(name, ()) if version in picture), None)
        return _recolor(png, PALETTES[name].dark) if png is not None and dark else png


def _png(cells: Cells, palette: Palette) -> bytes:
    out = io.BytesIO()
    image = Image.frombytes("P", (cells.shape[1], cells.shape[0]), np.ascontiguousarray(cells).tobytes())
    image.putpalette(palette.light)
    image.save(out, "PNG", compress_level=3, bits=8, transparency=palette.opacity)
    return out.getvalue()


def _recolor(png: bytes, colors: bytes) -> bytes:
    """Replace the palette of a PNG (ISO/IEC 15948: chunk PLTE), so that nothing is compressed again."""
    at = png.index(b"PLTE")
    (length,) = struct.unpack(">I", png[at - 4 : at])
    chunk = b"PLTE" + colors[:length].ljust(length, b"\0")
    return png[:at] + chunk + struct.pack(">I", zlib.crc32(chunk)) + png[at + 8 + length :]
