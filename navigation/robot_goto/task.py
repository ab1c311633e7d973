"""The state of one goal of RobotGoto: progress, path, the obstacle that the robot waits for, and turns to see more."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from navigation.constraints import Constraints
from navigation.pose import Pose, wrapped
from navigation.robot_goto.guard import FAST_ROOM, Guard
from navigation.robot_goto.local_grid import LocalGrid
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_goto.steering import STILL, Aim, DriveCommand, GoalLimits, aim, behind, people_speed

CLEAR = 0.3  # seconds for which the path has to be free before the robot drives on
RAMP = 1.0  # seconds in which it then accelerates to full speed
_PROGRESS, _TURN_PROGRESS = 0.05, math.radians(2.0)
_HELD, _HELD_AGAIN = 1.0, 0.5  # seconds until a stopped robot counts as held; meters until it has left that place
_NARROW_FOR = 20.0  # seconds for which paths keep more room where the robot was held
# radians of a turn; the number of turns at one place; meters from there to another place
_SCAN_TURN, _SCAN_TURNS, _SCAN_AGAIN = 0.5 * math.pi, 2, 0.3


@dataclass
class TimedMove:
    """A command for a limited time: an approach, a retreat, or the motion past a waypoint."""

    command: DriveCommand = STILL
    left: float = 0.0  #: seconds

    def advance(self, seconds: float) -> DriveCommand:
        """Return the command for a step of ``seconds``; it is `STILL` when the time is over."""
        self.left -= seconds
        return self.command if self.left > 0.0 else STILL


@dataclass
class GoalProgress:
    """The progress toward a goal."""

    best: float = math.inf  #: the smallest remaining cost of the path so far, meters of open floor
    nearest: float = math.inf  #: the smallest straight distance so far, meters: the cost rises when obstacles appear
    best_turn: float = math.inf  #: the turn to the goal's heading at the last progress, radians
    since: float | None = None  #: the time of the last progress, seconds; None before the first step

    def missing(self, now: float, left: float, away: float, turn: float) -> float:
        """Return the seconds since the last progress in path, distance or heading.

        The remaining path costs ``left`` meters of open floor, the goal is ``away`` meters away in a straight line, and
        its heading needs a ``turn``, radians.
        """
        if self.since is None:
            self.best, self.nearest, self.best_turn, self.since = left, away, turn, now
        closer = left < self.best - _PROGRESS or away < self.nearest - _PROGRESS
        if closer or turn < self.best_turn - _TURN_PROGRESS:
            self.best, self.nearest, self.since = min(left, self.best), min(away, self.nearest), now
            self.best_turn = turn
        return now - self.since

    def excuse(self, seconds: float) -> None:
        """Do not count a time in which the robot had to wait."""
        if self.since is not None:
            self.since += seconds


class PathFollower:
    """The point to drive to, computed again for each scan."""

    def __init__(self) -> None:
        self.aim: Aim | None = None
        self._scanned: float | None = None

    def next(
        self,
        grid: LocalGrid,
        now: float,
        moved: Pose,
        goal: Pose,
        radius: float,
        narrow: Pose | None = None,
        *,
        leave: bool = False,
    ) -> Aim:
        """Return the point to drive to, towards a goal in the grid's frame; theta is NaN without a heading.

        Around ``narrow``, a place in the grid's frame, paths keep more room. With ``leave``, a robot next to an
        obstacle first leaves it.
        """
        if self.aim is None or self._scanned != grid.scanned:
            self.aim = aim(grid, now, moved, goal, radius, self.aim, narrow, leave=leave)
            self._scanned = grid.scanned
        if not self.aim.direct:
            return self.aim
        x, y = (behind(goal, moved) if self.aim.bend else None) or (goal.x, goal.y)
        return self.aim._replace(x=x, y=y)


class Obstruction:
    """The obstacle on a goal's path.

    Attributes:
        seen_at: when the path was last obstructed, seconds; -inf if it is free.
        removed_at: when the path became free, or the base did not follow, seconds; the robot then accelerates slowly.
    """

    def __init__(self) -> None:
        self.seen_at = self.removed_at = -math.inf
        self._length = 0.0

    def reason(
        self,
        settings: RobotGotoSection,
        limits: GoalLimits,
        guard: Guard,
        moved: Pose,
        beta: float,  # the direction to drive in, from the robot's front, radians
        distance: float,  # to the goal, meters
        blocked: float,  # meters of path up to the obstacle that blocks it
        *,
        waiting: bool,  # whether the robot waits already
    ) -> str:
        """Return why the robot must not drive now; "" if the path is free."""
        length = settings.max_detection_distance
        if settings.enable_dynamic_max_distance:
            speed = float(np.hypot(guard.velocity[0], guard.velocity[1]))
            length *= min(1.0, speed / max(settings.max_lin_speed, 1e-3))
        length = max(length, settings.min_detection_distance)
        if waiting:
            length = max(length, self._length)  # an obstacle that stopped the robot early still counts when it stands
        self._length = length
        radius = settings.robot_radius
        guard.check_ahead(settings, moved, beta, length, distance)
        if limits.avoid:
            if blocked < max(length, radius + 0.2):
                return "the path is blocked"
            if limits.stop and guard.ahead[1] >= 2:
                return "a person crosses the path"
            if people_speed(settings, guard.ahead[2] - radius - FAST_ROOM) < 0.02:
                return "a person is too close"
        elif limits.stop and guard.ahead[0] >= 2:
            return "an obstacle is on the path"
        return ""

    def ramp(self, now: float) -> float:
        """Return the share of the speed: it rises after an obstacle has moved away."""
        return min(1.0, max(0.05, (now - self.removed_at) / RAMP))


class Hold:
    """The place at which the collision check stops the robot on a path that is free on the grid.

    The grid's cells are 5 cm wide, so a path may lead through a gap that the check of the exact echoes refuses. Paths
    then keep more room around that place for a while, so that the robot takes another way, or waits as for an obstacle.

    Attributes:
        since: when the robot was stopped at this place for the first time, seconds; infinite once it has left.
    """

    def __init__(self) -> None:
        self.since = self._ended = math.inf
        self._place: Pose | None = None
        self._began: float | None = None

    def add(self, now: float, moved: Pose, *, refused: bool) -> bool:
        """Add a step: whether the check refused to drive on; return whether it has done so for too long."""
        if self._place is not None and self._place.distance(moved) > _HELD_AGAIN:
            self.since = math.inf
        if not refused:
            self._began = None
            return False
        if self._began is None:
            self._began = now
        if now - self._began < _HELD:
            return False
        if math.isinf(self.since):
            self._place, self.since = moved, self._began
        self._began, self._ended = None, now + _NARROW_FOR
        return True

    def narrow(self, now: float) -> Pose | None:
        """Return the place around which paths keep more room now, in the grid's frame; None for none."""
        return self._place if now < self._ended else None


class SearchTurn:
    """Turns in place, toward the unseen cells, until the laser sees the path."""

    def __init__(self) -> None:
        self._left = self._sign = 0.0
        self._turns = 0
        self._at: Pose | None = None

    @property
    def active(self) -> bool:
        """Whether a turn is not complete."""
        return self._left > 0.0

    def advance(self, guard: Guard, moved: Pose, seconds: float, speed: float) -> DriveCommand | None:
        """Return the command at a speed (rad/s) for a step of ``seconds``; None after two turns at one place."""
        if self._at is None or self._at.distance(moved) > _SCAN_AGAIN:
            self._turns, self._at = 0, moved
        if self._left <= 0.0:
            if self._turns >= _SCAN_TURNS:
                return None
            bearing = math.atan2(guard.blocker[1] - moved.y, guard.blocker[0] - moved.x) - moved.theta
            self._sign = math.copysign(1.0, wrapped(bearing))
            self._left = _SCAN_TURN
            self._turns += 1
        self._left -= abs(guard.velocity[2]) * seconds
        return DriveCommand(omega=self._sign * speed)


@dataclass
class GotoTask:
    """An active goal."""

    pose: Pose  #: on the map; theta is NaN if the heading does not matter
    constraints: Constraints
    driven: bool = False  #: whether the robot could drive in any step
    near: bool = False  #: whether only the heading is left
    waiting_since: float | None = None  #: seconds; None while it does not wait
    pause_left: float = 0.0  #: seconds
    progress: GoalProgress = field(default_factory=GoalProgress)
    path: PathFollower = field(default_factory=PathFollower)
    obstruction: Obstruction = field(default_factory=Obstruction)
    search: SearchTurn = field(default_factory=SearchTurn)
    hold: Hold = field(default_factory=Hold)

    def skip(self, seconds: float) -> None:
        """Do not count a time in which this process did not run."""
        self.progress.excuse(seconds)
        if self.waiting_since is not None:
            self.waiting_since += seconds

    @property
    def heading(self) -> bool:
        """Whether its heading matters."""
        return self.constraints.heading and not self.constraints.through and math.isfinite(self.pose.theta)
