"""Keeps the robot from all that the laser sees or saw, whatever it is about to do."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.rolling_grid import UNKNOWN
from navigation.algorithms.stopping import kernels
from navigation.pose import Pose
from navigation.robot_goto.command import STILL, Command
from navigation.robot_goto.local_grid import LocalGrid
from navigation.robot_goto.settings import Settings

CREEP_ROOM, FAST_ROOM = 0.01, 0.05
"""Metres kept beyond the radius, when it creeps and at full speed."""

_BARELY, _LEAST = 0.1, 0.002
_BASELINE, _KEPT = 0.15, 0.3
_FASTER, _ABSURD = 0.1, 5.0


class Guard:
    """Lets commands through, slowed where the robot could not stop in time.

    Args:
        grid: what the laser saw.

    Attributes:
        has: the velocity that the robot has now: m/s, m/s, rad/s.
        ahead: what is around it: see `navigation.algorithms.stopping.kernels`.
        blocker: (3) the point that let the last command go no faster; its third is -1 where nothing did.
    """

    def __init__(self, grid: LocalGrid) -> None:
        self._grid = grid
        self._slowed, self._ahead = kernels()
        self._points = np.empty((0, 3))
        self._wanted = np.zeros(3)
        self._places: deque[tuple[float, Pose]] = deque()
        self._scale = 1.0
        self.has: NDArray[np.float64] = np.zeros(3)
        self.blocker: NDArray[np.float64] = np.zeros(3)
        self.ahead = np.array([0.0, 0.0, math.inf, math.inf, 0.0, math.inf])

    def follow(self, settings: Settings, command: Command, seconds: float) -> None:
        """Work out how fast the base goes by now, by what it was commanded."""
        dx, dy = command.vx - self.has[0], command.vy - self.has[1]
        change, most = math.hypot(dx, dy), settings.linear_acceleration * seconds
        share = min(1.0, most / change) if change else 1.0
        self.has[0] += dx * share
        self.has[1] += dy * share
        most = settings.angular_acceleration * seconds
        self.has[2] += min(most, max(-most, command.omega - self.has[2]))

    def measure(self, settings: Settings, now: float, moved: Pose) -> None:
        """Believe odometry where the base goes faster than it was commanded: somebody else drives it, or pushes."""
        if self._places and not 0.0 <= now - self._places[-1][0] < _KEPT:
            self._places.clear()
        self._places.append((now, moved))
        while now - self._places[0][0] > _KEPT:
            self._places.popleft()
        since, place = self._places[0]
        passed = now - since
        if passed < _BASELINE:
            return
        dx, dy = (moved.x - place.x) / passed, (moved.y - place.y) / passed
        speed = math.hypot(dx, dy)
        late = settings.linear_acceleration * passed
        if math.hypot(self.has[0], self.has[1]) + _FASTER + late < speed < _ABSURD:
            c, s = math.cos(moved.theta), math.sin(moved.theta)
            self.has[0], self.has[1] = c * dx + s * dy, c * dy - s * dx

    def forget(self) -> None:
        """The odometry has jumped."""
        self._places.clear()

    def look(self, settings: Settings, moved: Pose, direction: float, length: float) -> None:
        """Take up what is ahead in a direction (radians, of the robot's frame), for so many metres."""
        self._ahead(
            self._grid.points, self._grid.count, moved.x, moved.y, moved.theta, direction, length,
            settings.robot_radius, settings.robot_radius, settings.frontal_blind_angle, self.ahead,
        )  # fmt: skip

    def allowed(self, settings: Settings, now: float, moved: Pose, wanted: Command) -> Command:
        """What of a command is allowed: slower, as long as the robot could not stop in time. Turning always is."""
        self._scale, self.blocker[2] = 1.0, -1.0
        if wanted == STILL:
            return STILL
        cells, unsure = self._grid.unsure(moved, now)
        count = self._grid.count + unsure
        if len(self._points) < count:
            self._points = np.empty((2 * count, 3))
        self._points[: self._grid.count] = self._grid.points[: self._grid.count]
        self._points[self._grid.count : count] = cells[:unsure]
        self._wanted[:] = wanted
        scale = self._slowed(
            self._points, count, moved.x, moved.y, moved.theta, self.has, self._wanted, settings.reaction,
            settings.linear_acceleration, settings.angular_acceleration, settings.robot_radius,
            CREEP_ROOM, FAST_ROOM, settings.max_lin_speed, self.blocker,
        )  # fmt: skip
        self._scale = scale if wanted.speed * scale >= _LEAST else 0.0
        return Command(wanted.vx * self._scale, wanted.vy * self._scale, wanted.omega)

    @property
    def unseen(self) -> bool:
        """Whether the last command was slowed to almost nothing by a place that nobody saw."""
        return self._scale <= _BARELY and bool(self.blocker[2] == UNKNOWN)
