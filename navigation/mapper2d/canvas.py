"""The map as a picture, and clicks on it: what a ``yarpview`` shows and sends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from navigation.mapper2d.mapper import MOST_BRUSH, PAINTS, Mapper
from navigation.pose import Pose
from yarp_compat.dev.mapcolours import picture_of_flags
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapinfo import MapGrid2DInfo
from yarp_compat.sig.image import ImageRgb

_ROBOT = (0, 90, 200)
_LENGTH = 0.4
"""Metres of the line that shows where the robot looks."""


class Canvas:
    """Shows the map, a pixel for each cell, and paints where it is clicked.

    Args:
        mapper: makes the map.
    """

    def __init__(self, mapper: Mapper) -> None:
        self._mapper = mapper
        self._flag, self._brush = MapFlag.KEEP_OUT, 1
        self._shown: MapGrid2DInfo | None = None

    def use(self, paint: str) -> None:
        """Paint so; raises `ValueError` where there is no such paint."""
        if paint not in PAINTS:
            raise ValueError(f"{paint[:20]!r} cannot be painted; {', '.join(PAINTS)} can")
        self._flag = PAINTS[paint]

    def size(self, cells: float) -> None:
        """Have a brush of so many cells along a side; raises `ValueError`."""
        if cells != int(cells) or not 1 <= cells <= MOST_BRUSH:
            raise ValueError(f"a brush has 1 to {MOST_BRUSH} cells, not {cells:g}")
        self._brush = int(cells)

    def paint(self, at: tuple[float, float], to: tuple[float, float]) -> int:
        """Paint from a place to another (metres); how many cells. Raises `ValueError` where one is off the map."""
        return self._mapper.paint(at, self._flag, self._brush, to)

    def picture(self, robot: Pose | None) -> ImageRgb:
        """The map now, with the robot on it where that is known."""
        grid = self._mapper.grid()
        pixels = picture_of_flags(grid.flags)
        if robot is not None:
            along = np.linspace(0.0, _LENGTH, 2 * math.ceil(_LENGTH / grid.resolution) + 1)
            line = np.stack((robot.x + along * math.cos(robot.theta), robot.y + along * math.sin(robot.theta)), -1)
            columns, rows = grid.cells_at(line).T
            there = (columns >= 0) & (columns < grid.width()) & (rows >= 0) & (rows < grid.height())
            pixels[rows[there], columns[there]] = _ROBOT
        self._shown = MapGrid2DInfo(grid.name, grid.width(), grid.height(), grid.resolution, grid.origin)
        return ImageRgb.of(pixels)

    def clicked(self, values: Sequence[Any]) -> int:
        """Paint where the picture that was shown last was clicked; how many cells.

        Args:
            values: ``x y``, or ``x0 y0 x1 y1`` of a drag: pixels from the upper left one.

        Raises:
            ValueError: it is no click, or not on the picture.
        """
        numbers = all(isinstance(value, (int, float)) and math.isfinite(value) for value in values)
        if len(values) not in (2, 4) or not numbers:
            raise ValueError(f"a click is (x y), a drag (x0 y0 x1 y1); not {list(values)[:5]}")
        shown = self._shown
        if shown is None:
            raise ValueError("nothing was clicked: no picture of the map was shown yet")
        pixels = np.floor(np.reshape([float(value) for value in values], (-1, 2)))
        if not ((pixels >= 0).all() and (pixels < (shown.m_width, shown.m_height)).all()):
            raise ValueError(f"{list(values)} is not on the map's picture of {shown.m_width} x {shown.m_height}")
        places = [(float(x), float(y)) for x, y in shown.centers_of(pixels)]
        return self.paint(places[0], places[-1])
