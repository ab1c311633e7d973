"""The surroundings of the robot, from its laser."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bridge.messages.scan import LaserScan
from navigation.algorithms.rolling_grid import NEVER, OCCUPIED, UNKNOWN, RollingGrid
from navigation.pose import Pose
from navigation.scan import AT_BASE

RESOLUTION = 0.05
SIDE = 100  # cells; the window is 5 m wide and high, with the robot in its center
NEAR = 1.5  # meters around the robot within which `unsure` returns cells


class LocalGrid:
    """A window of 5 m around the robot, in a frame in which it moves smoothly (the odometry's).

    Observations are valid for ``memory`` seconds. Unknown cells within 0.7 times the robot's ``radius`` (meters) become
    free; the robot's lasers are ``aside`` meters from its center.
    """

    def __init__(self, memory: float, radius: float, aside: float) -> None:
        self._memory, self._radius, self._aside = memory, radius, aside
        self._cells = np.empty((SIDE * SIDE, 3))
        self.clear()

    def clear(self) -> None:
        self._grid = RollingGrid(SIDE, RESOLUTION, self._memory)
        # the newest scan's echoes: x, y, and 1 for a new object, else 0; then the other sensors' obstacles; then places
        # that the robot must not enter, although nothing is there
        self.points = np.empty((0, 3))
        self.count = 0  # the number of rows of obstacles
        self.limits = 0  # the number of valid rows
        self.scanned: float | None = None  # the time of the scan, seconds; None before the first
        self._echoes = 0
        self._others = self._kept = np.empty((0, 2))

    def scan(self, scan: LaserScan, at: Pose, laser: Pose = AT_BASE) -> None:
        """Add a scan of a laser on the base; `at` is the base's pose in the grid's frame at the scan's time."""
        now = scan.time_ns / 1e9
        self._grid.move(math.floor(at.y / RESOLUTION) - SIDE // 2, math.floor(at.x / RESOLUTION) - SIDE // 2)
        others = len(self._others) + len(self._kept)
        if len(self.points) < len(scan.ranges) + others:
            self.points = np.empty((len(scan.ranges) + 2 * others, 3))
        self._grid.stand(now, at.x, at.y, 0.7 * self._radius)
        eye = at @ laser
        ranges = np.ascontiguousarray(scan.ranges, np.float64)
        self._echoes = self._grid.mark(
            now, eye.x, eye.y, eye.theta, scan.first, scan.step, scan.nearest, scan.farthest, self._aside, ranges,
            self.points,
        )  # fmt: skip
        self.scanned = now
        self.set_others(self._others, self._kept)

    def set_others(self, places: NDArray[np.float64], kept: NDArray[np.float64]) -> None:
        """Replace the obstacles from sensors other than the laser, and the places not to enter: (n, 2) x and y each."""
        self._others, self._kept = places, kept
        self.count = self._echoes + len(places)
        self.limits = self.count + len(kept)
        if len(self.points) < self.limits:
            self.points = np.concatenate((self.points[: self._echoes], np.empty((2 * (len(places) + len(kept)), 3))))
        self.points[self._echoes : self.count, :2] = places
        self.points[self.count : self.limits, :2] = kept
        self.points[self._echoes : self.limits, 2] = 0.0

    def unsure(self, at: Pose, now: float) -> tuple[NDArray[np.float64], int]:
        """Return nearby cells that are not free and have no echo of the newest scan, and their number n.

        Only the first n rows are valid: x, y, and `OCCUPIED` or `UNKNOWN`.
        """
        scanned = NEVER - 1.0 if self.scanned is None else self.scanned
        count = self._grid.near(now, at.x, at.y, NEAR, scanned, self._cells)
        return self._cells, count

    def states(self, now: float) -> NDArray[np.uint8]:
        """Return all cells from the window's corner, (rows, columns): free, `OCCUPIED` or `UNKNOWN`."""
        out = np.empty((SIDE, SIDE), np.uint8)
        self._grid.states(now, out)
        for places in (self._others, self._kept):
            if len(places):
                columns, rows = (np.floor(places / RESOLUTION).astype(np.int64) - self._grid.corner[::-1]).T
                within = (rows >= 0) & (rows < SIDE) & (columns >= 0) & (columns < SIDE)
                out[rows[within], columns[within]] = OCCUPIED
        return out

    def occupancy(self, now: float) -> NDArray[np.int8]:
        """Return all cells with ROS's values: 0 free, 100 occupied, -1 unknown; the first row has the lowest y."""
        states = self.states(now)
        return np.where(states == UNKNOWN, -1, np.where(states == OCCUPIED, 100, 0)).astype(np.int8)

    @property
    def origin(self) -> tuple[float, float]:
        """X and y of the window's corner, meters."""
        row, column = self._grid.corner
        return column * RESOLUTION, row * RESOLUTION

    def cell(self, x: float, y: float) -> tuple[float, float]:
        """Return the row and column of a point in the window; integers are cell centers."""
        row, column = self._grid.corner
        return y / RESOLUTION - row - 0.5, x / RESOLUTION - column - 0.5

    def place(self, row: float, column: float) -> tuple[float, float]:
        """Return x and y of a row and column."""
        row0, column0 = self._grid.corner
        return (column + column0 + 0.5) * RESOLUTION, (row + row0 + 0.5) * RESOLUTION
