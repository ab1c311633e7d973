"""Slows the robot in front of obstacles, and detects a base that does not follow its commands."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.rolling_grid import UNKNOWN
from navigation.algorithms.stopping import ahead, slowed
from navigation.pose import Pose, wrapped
from navigation.robot_goto.local_grid import LocalGrid
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_goto.steering import STILL, DriveCommand

CREEP_ROOM, FAST_ROOM = 0.01, 0.05  # meters beyond the radius, when creeping and at full speed
_BARELY, _LEAST = 0.1, 0.002  # a smaller share of a command is almost nothing; a slower robot (m/s) stands
_SLOWED, _SLOWS = 0.5, 1.0  # a command slowed to less than this share; seconds for which this counts
_BASELINE, _KEPT = 0.15, 0.3  # seconds: the shortest time over which a velocity is measured, and the longest
_FASTER, _ABSURD = 0.1, 5.0  # m/s: how much faster than commanded the odometry must be to count, and its largest speed


class Guard:
    """Passes commands on, slowed if the robot could not stop in time."""

    def __init__(self, grid: LocalGrid) -> None:
        self._grid = grid
        self._points = np.empty((0, 3))
        self._wanted = np.zeros(3)
        self._places: deque[tuple[float, Pose]] = deque()
        self._scale = 1.0
        self._slowed_at = -math.inf
        self.velocity: NDArray[np.float64] = np.zeros(3)  # the current velocity: m/s, m/s, rad/s
        # the point that limited the last command; its third value is -1 for none
        self.blocker: NDArray[np.float64] = np.zeros(3)
        # see `navigation.algorithms.stopping.ahead`
        self.ahead = np.array([0.0, 0.0, math.inf, math.inf, 0.0, math.inf])

    def follow(self, settings: RobotGotoSection, command: DriveCommand, seconds: float) -> None:
        """Estimate the base's velocity from its commands."""
        dx, dy = command.vx - self.velocity[0], command.vy - self.velocity[1]
        change, most = math.hypot(dx, dy), settings.max_lin_acc * seconds
        share = min(1.0, most / change) if change else 1.0
        self.velocity[0] += dx * share
        self.velocity[1] += dy * share
        most = math.radians(settings.max_ang_acc) * seconds
        self.velocity[2] += min(most, max(-most, command.omega - self.velocity[2]))

    def measure(self, settings: RobotGotoSection, now: float, moved: Pose) -> None:
        """Use the odometry's velocity if it exceeds the commands: another program or a person moves the base."""
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
        late = settings.max_lin_acc * passed
        if math.hypot(self.velocity[0], self.velocity[1]) + _FASTER + late < speed < _ABSURD:
            c, s = math.cos(moved.theta), math.sin(moved.theta)
            self.velocity[0], self.velocity[1] = c * dx + s * dy, c * dy - s * dx

    def clear(self) -> None:
        """Drop past poses, after the odometry has jumped."""
        self._places.clear()

    def check_ahead(
        self, settings: RobotGotoSection, moved: Pose, direction: float, length: float, distance: float
    ) -> None:
        """Update `ahead` for a direction (radians, in the robot's frame), and the rectangle's length in meters.

        ``distance`` is that to the goal, meters.
        """
        ahead(
            self._grid.points, self._grid.count, moved.x, moved.y, moved.theta, direction, length, distance,
            settings.robot_radius, settings.robot_radius, math.radians(settings.frontal_blind_angle), self.ahead,
        )  # fmt: skip

    def allowed(self, settings: RobotGotoSection, now: float, moved: Pose, wanted: DriveCommand) -> DriveCommand:
        """Return the allowed command: slower if the robot could not stop in time. Turning is always allowed."""
        self._scale, self.blocker[2] = 1.0, -1.0
        if wanted == STILL:
            return STILL
        cells, unsure = self._grid.unsure(moved, now)
        known = self._grid.limits
        count = known + unsure
        if len(self._points) < count:
            self._points = np.empty((2 * count, 3))
        self._points[:known] = self._grid.points[:known]
        self._points[known:count] = cells[:unsure]
        self._wanted[:] = wanted
        scale = slowed(
            self._points, count, moved.x, moved.y, moved.theta, self.velocity, self._wanted, settings.reaction,
            settings.max_lin_acc, math.radians(settings.max_ang_acc), settings.robot_radius,
            CREEP_ROOM, FAST_ROOM, settings.max_lin_speed, self.blocker,
        )  # fmt: skip
        self._scale = scale if wanted.speed * scale >= _LEAST else 0.0
        if wanted.speed and self._scale < _SLOWED and self.blocker[2] != UNKNOWN:
            self._slowed_at = now
        return DriveCommand(wanted.vx * self._scale, wanted.vy * self._scale, wanted.omega)

    def slows(self, now: float) -> bool:
        """Whether a seen obstacle has slowed a recent command to less than half."""
        return 0.0 <= now - self._slowed_at < _SLOWS

    @property
    def unseen(self) -> bool:
        """Whether an unseen cell slowed the last command to almost nothing."""
        return self._scale <= _BARELY and bool(self.blocker[2] == UNKNOWN)


ENOUGH = 0.2  # commanded meters after which the base's motion is checked
TRY = 0.05  # the same for a base that did not follow, at the next try
PAUSE = 2.0  # seconds between two tries
_SHARE = 0.2  # of the commanded motion; a base that moves less does not follow
_ARM = 0.2  # meters that one radian counts as


class FollowCheck:
    """Compares commands with the motion by odometry."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        self.since: float | None = None  # since when the base does not follow, seconds; None while it does
        self._again = -math.inf
        self._wanted = np.zeros(3)  # signed, because motions to both sides lead back to the same pose
        self._from: Pose | None = None

    def add(self, now: float, passed: float, velocity: NDArray[np.float64], moved: Pose) -> None:
        """Add a step of `passed` seconds: the velocity that the base should have had, and its pose by odometry.

        The velocity is (3,): m/s forward and to the left, and rad/s.
        """
        if self._from is None:
            self._from = moved
            return
        self._wanted += passed * velocity
        wanted = math.hypot(self._wanted[0], self._wanted[1]) + _ARM * abs(self._wanted[2])
        if wanted < (ENOUGH if self.since is None else TRY):
            return
        went = self._from.distance(moved) + _ARM * abs(wrapped(moved.theta - self._from.theta))
        if went >= _SHARE * wanted:
            self.since = None
        else:
            self.since = now if self.since is None else self.since
            self._again = now + PAUSE
        self._wanted[:], self._from = 0.0, moved

    def waits(self, now: float) -> bool:
        """Whether the base does not follow, and the next try is not due yet."""
        return self.since is not None and now < self._again
