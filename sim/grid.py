"""Floor plans from maps of cells and from images: occupied cells become rectangles, as few as a simple rule finds."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sim.errors import SimError
from sim.plan import Box, Floor, Plan, Pose
from yarp_compat.dev.mapfile import MapFileError
from yarp_compat.dev.mapgrid import MAX_CELLS, MapFlag, MapGrid2D

_MOST_PIECES = 20_000
_HEIGHT = 2.0
_DARK = 128


def of_map_file(file: Path) -> Plan:
    """A plan of a YARP map (.map) or a ROS map (.yaml): walls are solid, what is unknown or kept out of is not.

    Raises:
        SimError: it is no map, or too large.
    """
    try:
        grid = MapGrid2D.load(file)
    except (MapFileError, OSError, ValueError) as err:
        msg = f"{file}: {err}"
        raise SimError(msg) from None
    return of_grid(grid, file.stem)


def of_grid(grid: MapGrid2D, name: str) -> Plan:
    """A plan of a map. Keep-out cells are none of its solids: nothing stands there."""
    origin = grid.m_origin.to_ros()
    return _plan(name, grid.flags == MapFlag.WALL, grid.getResolution(), (origin[0], origin[1], origin[2]))


def of_image(file: Path, resolution: float) -> Plan:
    """A plan of an image, so many metres to a pixel: dark is wall. Its lower left corner is the origin.

    Raises:
        SimError: it is no image, or too large.
    """
    try:
        with Image.open(file) as image:
            if image.width * image.height > MAX_CELLS:
                msg = f"{file}: more than {MAX_CELLS} pixels"
                raise SimError(msg)
            grey = np.asarray(image.convert("L"))
    except (OSError, ValueError, Image.DecompressionBombError) as err:
        msg = f"{file}: no image that can be read: {err}"
        raise SimError(msg) from None
    return _plan(file.stem, grey < _DARK, resolution, (0.0, 0.0, 0.0))


def _plan(name: str, solid: NDArray[np.bool_], resolution: float, origin: Pose) -> Plan:
    """A plan of cells, rows from the top one down; the origin (metres, radians) is their lower left corner."""
    c, s = math.cos(origin[2]), math.sin(origin[2])
    boxes = []
    for left, bottom, right, top in rectangles(solid[::-1]):
        x, y = (left + right) / 2 * resolution, (bottom + top) / 2 * resolution
        at = (origin[0] + c * x - s * y, origin[1] + s * x + c * y, math.degrees(origin[2]))
        boxes.append(Box(at=at, size=((right - left) * resolution, (top - bottom) * resolution, _HEIGHT)))
        if len(boxes) > _MOST_PIECES:
            msg = f"{name}: more than {_MOST_PIECES} rectangles of solid cells; is it a map?"
            raise SimError(msg)
    height, width = solid.shape
    x, y = width / 2 * resolution, height / 2 * resolution
    start = (origin[0] + c * x - s * y, origin[1] + s * x + c * y, 0.0)
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)[:60]
    plain = plain if plain[:1].isalpha() else f"m_{plain}"
    return Plan(name=plain, floors={plain: Floor(boxes=tuple(boxes), start=start)})


def rectangles(solid: NDArray[np.bool_]) -> Iterator[tuple[int, int, int, int]]:
    """Rectangles that cover the solid cells, each cell once: left, bottom, right, top, the last two not within.

    Runs of a row that go on in the next with the same ends grow upwards.
    """
    growing: dict[tuple[int, int], int] = {}
    for row, cells in enumerate(solid):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], cells, [False])).astype(np.int8)))
        runs = set(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
        for left, right in [run for run in growing if run not in runs]:
            yield left, growing.pop((left, right)), right, row
        for run in sorted(runs):
            growing.setdefault(run, row)
    for (left, right), bottom in growing.items():
        yield left, bottom, right, len(solid)
