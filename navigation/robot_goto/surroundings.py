"""What RobotGoto's sensors report: the obstacles around the robot, and how its base moves."""

from __future__ import annotations

import math

import numpy as np

from bridge.messages.scan import LaserScan
from navigation.pose import Pose, wrapped
from navigation.robot_goto.guard import FollowCheck, Guard
from navigation.robot_goto.keep_out import KeepOut
from navigation.robot_goto.local_grid import LocalGrid
from navigation.robot_goto.obstacles import Obstacles
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_goto.steering import DriveCommand
from navigation.scan import is_blind

_NOWHERE = np.empty((0, 2))
_JUMP, _JUMP_TURN = 0.3, math.radians(30.0)


class Surroundings:
    """The observations, in the odometry frame, or on the map without odometry.

    Attributes:
        grid: recent scans around the robot.
        obstacles: from sensors other than the laser.
        keep_out: the map's keep-out cells.
        guard: the base's velocity, and the obstacles that limit it.
        follow: whether the base follows its commands.
    """

    def __init__(self, settings: RobotGotoSection) -> None:
        self.grid = LocalGrid(settings.memory, settings.robot_radius, settings.laser_offset)
        self.obstacles = Obstacles(settings)
        self.keep_out = KeepOut()
        self.guard = Guard(self.grid)
        self.follow = FollowCheck()
        self._blind = False
        self._moved: Pose | None = None

    def clear(self) -> None:
        """Drop all observations, after the clock jumped back."""
        self.grid.clear()
        self.obstacles.clear()
        self.follow.clear()
        self._moved = None

    def scan(self, scan: LaserScan, moved: Pose, laser: Pose) -> None:
        """Add a scan of a laser on the base, taken at the base's pose ``moved``."""
        self._blind = is_blind(scan)
        if not self._blind:
            self.grid.scan(scan, moved, laser)

    def move(
        self,
        settings: RobotGotoSection,
        now: float,  # seconds
        passed: float,  # since the last step, seconds
        command: DriveCommand,  # of the last step
        pose: Pose | None,  # the robot's pose on the map, if known
        moved: Pose | None,  # its pose in the odometry frame; None without odometry
    ) -> Pose | None:
        """Update the base's motion; return its pose in the frame of the observations, None if unknown."""
        self.guard.follow(settings, command, passed)
        if moved is not None:
            self.guard.measure(settings, now, moved)
        moved = moved or pose
        if moved is None:
            return None
        if self._moved is not None and _is_jump(self._moved, moved, passed):
            self.grid.clear()
            self.obstacles.clear_clouds()
            self.guard.clear()
            self.follow.clear()
        self._moved = moved
        self.follow.add(now, passed, self.guard.velocity, moved)
        others = self.obstacles.places(now, pose, moved) if settings.obstacles else _NOWHERE
        self.grid.set_others(others, self.keep_out.near(settings.robot_radius, pose, moved))
        return moved

    def unseen(self, now: float, timeout: float) -> str:
        """Return why obstacles are not seen; "" if all sensors work. A scan is valid for ``timeout`` seconds."""
        scanned = self.grid.scanned
        if scanned is not None and now - scanned <= timeout:
            return self.obstacles.silence(now)
        if self._blind:
            return "the laser is blind: no beam has a valid range"
        if scanned is None:
            return "waiting for the first scan of the laser"
        return f"the laser is silent: its last scan is {now - scanned:.1f} s old"


def _is_jump(before: Pose, moved: Pose, passed: float) -> bool:
    """Whether the odometry was reset: no base is as fast."""
    turned = abs(wrapped(moved.theta - before.theta))
    return before.distance(moved) > _JUMP + 2.0 * passed or turned > _JUMP_TURN + math.tau * passed
