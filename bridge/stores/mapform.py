"""Maps as bodies of the store: a line of JSON, then the occupancy and the flags, each a zlib stream.

The line says ``{"midspan": "map", "version": 1, "name", "width", "height", "resolution", "origin": [x, y, theta_deg],
"occupancy": <bytes>, "flags": <bytes>}`` and ends with a newline. Cells are a byte each, row by row from the top one:
occupancy 0 to 100 or 255 for unknown, flags 0 to 5 as YARP numbers them.
"""

from __future__ import annotations

import json
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.stores.errors import StoreError
from bridge.stores.places import finite, read_json, several, write_json
from yarp_compat.dev.mapgrid import MAX_CELLS, MapFlag, MapGrid2D, too_large

_VERSION = 1
_MOST_HEAD = 4096
_LEVEL = 1
_OCCUPANCY = bytes([*range(101), 255])
_FLAGS = bytes(MapFlag)


def write_map(name: str, grid: MapGrid2D) -> bytes:
    """A map's body under a name, whatever its own."""
    streams = [zlib.compress(np.ascontiguousarray(cells).data, _LEVEL) for cells in (grid.occupancy, grid.flags)]
    _check(grid.occupancy.tobytes(), _OCCUPANCY, "occupancy")
    _check(grid.flags.tobytes(), _FLAGS, "flags")
    head = {
        "midspan": "map",
        "version": _VERSION,
        "name": name,
        "width": grid.width(),
        "height": grid.height(),
        "resolution": grid.resolution,
        "origin": list(grid.origin),
        "occupancy": len(streams[0]),
        "flags": len(streams[1]),
    }
    return b"".join((write_json(head), b"\n", *streams))


def read_map(name: str, body: bytes) -> MapGrid2D:
    """The map of a body, under the name that it has in the store; raises `StoreError` where it is none."""
    head, start = _head(body)
    width, height = _size(head)
    parts, cells = [], []
    for key in ("occupancy", "flags"):
        size = _whole(head, key)
        parts.append(body[start : start + size])
        start += size
    if start != len(body):
        msg = f"the map has {len(body)} bytes, and tells of {start}"
        raise StoreError(msg)
    for part, good, what in zip(parts, (_OCCUPANCY, _FLAGS), ("occupancy", "flags"), strict=True):
        cells.append(_cells(part, width, height, good, what))
    x, y, theta = _origin(head)
    resolution = finite(head.get("resolution"), "resolution")
    try:
        return MapGrid2D.of(cells[1], cells[0], name=name, resolution=resolution, origin=(x, y, theta))
    except ValueError as err:
        raise StoreError(str(err)) from None


def _head(body: bytes) -> tuple[Any, int]:
    end = body.find(b"\n", 0, _MOST_HEAD)
    head = read_json(body[: max(end, 0)])
    if head.get("midspan") != "map" or head.get("version") != _VERSION:
        msg = f"it is no map of version {_VERSION}: {json.dumps(head)[:80]}"
        raise StoreError(msg)
    return head, end + 1


def _size(head: Any) -> tuple[int, int]:
    width, height = _whole(head, "width"), _whole(head, "height")
    if not width or not height:
        msg = f"a map of {width} x {height} cells has none"
        raise StoreError(msg)
    if width * height > MAX_CELLS:
        raise StoreError(too_large(width, height))
    return width, height


def _origin(head: Any) -> list[float]:
    found = [finite(number, "origin") for number in several(head, "origin")]
    if len(found) != 3:
        msg = "a map's origin has three numbers"
        raise StoreError(msg)
    return found


def _whole(head: Any, key: str) -> int:
    value = head.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        msg = f"{key} is no whole number: {value!r:.60}"
        raise StoreError(msg)
    return value


def _cells(part: bytes, width: int, height: int, good: bytes, what: str) -> NDArray[np.uint8]:
    try:
        # one byte more than there should be tells a longer stream, and no more of it is unpacked
        data = zlib.decompressobj().decompress(part, width * height + 1)
    except zlib.error as err:
        msg = f"the map's {what} cannot be unpacked: {err}"
        raise StoreError(msg) from None
    if len(data) != width * height:
        msg = f"the map's {what} has not the {width * height} cells that it tells of"
        raise StoreError(msg)
    _check(data, good, what)
    return np.frombuffer(data, np.uint8).reshape(height, width).copy()


def _check(data: bytes, good: bytes, what: str) -> None:
    if wrong := data.translate(None, good):
        msg = f"the map's {what} has a cell of {wrong[0]}"
        raise StoreError(msg)
