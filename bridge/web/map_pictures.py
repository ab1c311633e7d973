"""Pictures of a map for pages: occupancy and flags, one byte a cell, with colours for light pages and dark ones."""

from __future__ import annotations

import hashlib
import io
import struct
import threading
import zlib
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

_MOST_PICTURES = 4
_LEVELS, _CLEAR = 101, 101
"""Greys for 0 to 100 percent occupied, and the colour of cells of which nothing is known."""
_DARK_FREE, _DARK_WALL = (0x14, 0x19, 0x1E), (0xA0, 0xB0, 0xBE)
_TINTS = {
    MapFlag.KEEP_OUT: (214, 40, 40, 110),
    MapFlag.TEMPORARY_OBSTACLE: (240, 140, 20, 120),
    MapFlag.ENLARGED_OBSTACLE: (150, 110, 200, 100),
}
"""Colour and opacity of flags over the occupancy."""

Cells = NDArray[np.uint8]


@dataclass(frozen=True)
class Palette:
    """Colours of a picture's cells: red, green, blue of each number, for light and dark pages, and its opacity."""

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

_GREYS = np.full(256, _CLEAR, np.uint8)
_GREYS[:_LEVELS] = np.arange(_LEVELS)
_TINT_OF = np.zeros(256, np.uint8)
_TINT_OF[list(_TINTS)] = np.arange(1, len(_TINTS) + 1)


def occupancy_picture(grid: MapGrid2D) -> Cells:
    """The colour of each cell (height, width): 0 free to 100 occupied, 101 where nothing is known."""
    cells = _GREYS[np.asarray(grid.occupancy, np.uint8)]
    cells[grid.flags == MapFlag.WALL] = _LEVELS - 1
    cells[grid.flags == MapFlag.UNKNOWN] = _CLEAR
    return cells


def flags_picture(grid: MapGrid2D) -> Cells | None:
    """The tint of each cell (height, width) by the flags that planners heed, 0 for none; None where no cell has one."""
    cells = _TINT_OF[grid.flags]
    return cells if cells.any() else None


class Pictures:
    """The newest pictures by their addresses. Safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[str, str], bytes] = OrderedDict()

    def put(self, name: str, cells: Cells) -> str:
        """Keep a picture; its address, which tells its content. One that is kept already is not packed again."""
        version = hashlib.sha256(np.ascontiguousarray(cells).data).hexdigest()[:12]
        with self._lock:
            known = self._kept.get((name, version))
        picture = _png(cells, PALETTES[name]) if known is None else known
        with self._lock:
            self._kept[name, version] = picture
            self._kept.move_to_end((name, version))
            while len(self._kept) > _MOST_PICTURES:
                self._kept.popitem(last=False)
        return f"/map/{name}.png?v={version}"

    def get(self, name: str, version: str, *, dark: bool = False) -> bytes | None:
        """The PNG of an address, in the colours for dark pages or light ones; None where it is gone."""
        with self._lock:
            found = self._kept.get((name, version))
        return _recoloured(found, PALETTES[name].dark) if found is not None and dark else found


def _png(cells: Cells, palette: Palette) -> bytes:
    out = io.BytesIO()
    image = Image.frombytes("P", (cells.shape[1], cells.shape[0]), np.ascontiguousarray(cells).tobytes())
    image.putpalette(palette.light)
    image.save(out, "PNG", compress_level=3, bits=8, transparency=palette.opacity)
    return out.getvalue()


def _recoloured(png: bytes, colours: bytes) -> bytes:
    """Another palette for the same cells (PNG, ISO/IEC 15948: chunk PLTE), so that nothing is packed again."""
    at = png.index(b"PLTE")
    (length,) = struct.unpack(">I", png[at - 4 : at])
    chunk = b"PLTE" + colours[:length].ljust(length, b"\0")
    return png[:at] + chunk + struct.pack(">I", zlib.crc32(chunk)) + png[at + 8 + length :]
