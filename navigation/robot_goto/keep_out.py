"""Keep-out cells of the map, which no sensor detects."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.distance_transform import distance_transform
from navigation.layers import Places, on, spread
from navigation.maps.masks import keep_out_cells
from navigation.pose import Pose
from navigation.robot_goto.local_grid import RESOLUTION, SIDE
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapgrid import MapGrid2D

_DEEP = 0.03  # meters by which a robot outside may overlap a keep-out cell: localization is inexact
_REACH = math.sqrt(2.0) * SIDE / 2 * RESOLUTION
_NOWHERE = np.empty((0, 2))


class KeepOut:
    """The borders of keep-out areas near the robot, as obstacles that do not move. On one thread.

    They have no effect while the robot is inside, as it has to leave.

    Attributes:
        map_name: the map's name; empty without a map, and while the robot is inside or its pose is unknown.
    """

    def __init__(self) -> None:
        self._grid: MapGrid2D | None = None
        self._kept = np.zeros((0, 0), np.bool_)
        self._border = _NOWHERE
        self.map_name = ""

    @property
    def known(self) -> bool:
        """Whether there is a map."""
        return self._grid is not None

    def use(self, grid: MapGrid2D | None, areas: Iterable[Map2DArea] = ()) -> None:
        """Replace the map, None without one; all given areas on it are keep-out areas, too."""
        self._grid = grid
        if grid is None:
            return
        self._kept = keep_out_cells(grid, areas)
        self._border = _border_of(grid, self._kept)

    def near(self, radius: float, pose: Pose | None, moved: Pose) -> Places:
        """Return points on the borders around a robot of a radius (meters), in the grid's frame, (n, 2).

        ``moved`` is the robot's pose in that frame, ``pose`` is its pose on the map, or None if that is unknown.
        """
        self.map_name = ""
        if self._grid is None or pose is None:
            return _NOWHERE
        away = self._border - (pose.x, pose.y)
        near = (np.abs(away) < _REACH).all(axis=1)
        if (np.hypot(*away[near].T) < radius - _DEEP).any() or self._includes(self._grid, pose):
            return _NOWHERE
        self.map_name = self._grid.name
        return on(self._border[near], moved @ pose.inverse)

    def _includes(self, grid: MapGrid2D, pose: Pose) -> bool:
        column, row = (int(index) for index in grid.cells_at((pose.x, pose.y)))
        rows, columns = self._kept.shape
        return 0 <= row < rows and 0 <= column < columns and bool(self._kept[row, column])


def _border_of(grid: MapGrid2D, kept: NDArray[np.bool_]) -> Places:
    """Return the corners of the outermost keep-out cells, (n, 2) meters, at most 5 cm apart."""
    border = kept & (distance_transform(~kept) < 1.5)
    corners = spread(grid, np.argwhere(border)[:, ::-1], edges=True)
    return np.unique(corners.round(6), axis=0)
