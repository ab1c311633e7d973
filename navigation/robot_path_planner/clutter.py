"""What the laser sees that the map does not have: it stands in the way until it is seen gone, or for some time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.astar import Weights
from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.occupancy import MOST, OccupancyMap
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground

SURE = 1.2
"""Log odds from which on a cell counts: seen in two scans more than seen through."""

_KNOWN = 0.15
"""Metres to a wall of the map within which an echo is that wall's: maps and localisation are not better."""

_FORGET_EVERY = 1.0


class Clutter:
    """Temporary obstacles on the cells of a map.

    Args:
        ground: the map.
        memory: seconds after which what is not seen any more is forgotten.
    """

    def __init__(self, ground: Ground, memory: float) -> None:
        grid = ground.grid
        self._ground = ground
        rows, columns = ground.weights.shape
        self._seen = OccupancyMap(rows, columns, grid.resolution, (grid.origin.x, grid.origin.y))
        self._fade = MOST / memory * _FORGET_EVERY
        self._forgotten = -math.inf
        self._news = distance_transform(ground.solid) > _KNOWN / grid.resolution
        self._disc = _disc(ground.radius / grid.resolution + 0.5)
        self._half = _disc(ground.radius / 2 / grid.resolution + 0.5)
        self._cells: NDArray[np.int64] | None = None

    def see(self, laser: Pose, ranges: NDArray[np.float64], first: float, step: float, farthest: float) -> None:
        """Take a scan.

        Args:
            laser: its pose on the map.
            ranges: metres; infinite: nothing there, NaN: nothing is known.
            first: radians from the laser's direction to the first beam.
            step: radians from a beam to the next.
            farthest: metres; what is beyond is not looked at.
        """
        self._seen.insert((laser.x, laser.y, laser.theta), ranges, first, step, farthest)
        self._cells = None

    def forget(self, now: float) -> None:
        """Let what is not seen any more fade."""
        if now - self._forgotten >= _FORGET_EVERY or now < self._forgotten:
            self._forgotten = now
            odds = self._seen.odds
            odds[odds > 0.0] -= min(self._fade, MOST)
            self._cells = None

    def clear(self) -> None:
        """Forget all."""
        self._seen.odds[:] = 0.0
        self._cells = None

    @property
    def cells(self) -> NDArray[np.int64]:
        """(n, 2) rows and columns of the obstacles that the map does not have."""
        if self._cells is None:
            rows, columns = np.nonzero(self._seen.odds >= SURE)
            rows = self._seen.odds.shape[0] - 1 - rows
            news = self._news[rows, columns]
            self._cells = np.stack((rows[news], columns[news]), axis=1)
        return self._cells

    def closed(self) -> NDArray[np.bool_]:
        """(rows, columns) where the robot does not fit for them."""
        return self._around(self._disc)

    def struck(self) -> NDArray[np.bool_]:
        """(rows, columns) where the robot would strike them: half its radius about them.

        A robot that has stopped in front of something stands in what is closed, but not in this.
        """
        return self._around(self._half)

    def _around(self, disc: NDArray[np.int64]) -> NDArray[np.bool_]:
        found = np.zeros(self._ground.weights.shape, np.bool_)
        cells = self.cells
        if len(cells):
            rows, columns = (np.add.outer(cells[:, axis], disc[:, axis]).ravel() for axis in (0, 1))
            high, wide = self._ground.weights.shape
            fits = (rows >= 0) & (rows < high) & (columns >= 0) & (columns < wide)
            found[rows[fits], columns[fits]] = True
        return found

    def weights(self) -> Weights:
        """The map's weights with them as obstacles."""
        found: Weights = np.where(self.closed(), np.uint8(0), self._ground.weights)
        return found


def _disc(cells: float) -> NDArray[np.int64]:
    """(n, 2) the steps to all cells whose middle is nearer than so many cells."""
    reach = math.ceil(cells)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    near = rows**2 + columns**2 < cells**2
    return np.stack((rows[near], columns[near]), axis=1)
