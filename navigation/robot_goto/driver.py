"""RobotGoto without its ports: drives to a goal with only a laser and the robot's pose.

Time is an argument, so that tests and benchmarks run it in lock-step with a simulator.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.messages.scan import LaserScan
from bridge.state_machine import Machine
from navigation.constraints import Constraints
from navigation.pose import Pose, wrapped
from navigation.robot_goto.guard import FAST_ROOM
from navigation.robot_goto.keep_out import KeepOut
from navigation.robot_goto.local_grid import LocalGrid
from navigation.robot_goto.machine import DRIVER, DriverEvent, DriverState
from navigation.robot_goto.obstacles import Obstacles
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_goto.steering import STILL, Aim, DriveCommand, GoalLimits, drive, people_speed
from navigation.robot_goto.surroundings import Surroundings
from navigation.robot_goto.task import CLEAR, GotoTask, TimedMove
from navigation.scan import AT_BASE
from navigation.status import Fault, PlannerStatus

COAST = 0.3  # seconds for which the robot drives on past a waypoint while it has no next goal
RETREAT_SPEED = 0.2  # m/s
MAX_RETREAT = 2.0  # seconds
LONGEST_STEP = 1.0  # seconds; in a longer time between two steps, this process stalled
_FACING = 0.1  # rad/s; a robot that turns more slowly already faces its path
_DOES_NOT_FOLLOW = "the base does not follow its commands: check its emergency stop and its odometry"


class Step(NamedTuple):
    """One step of the driver."""

    now: float  #: seconds of the scans' clock
    passed: float  #: seconds since the previous step
    pose: Pose  #: the robot's pose on the map
    moved: Pose  #: its pose in the frame of the observations


class Driver:
    """Drives a robot to goals; `navigation.robot_goto.machine` has its states.

    Attributes:
        settings: may be replaced at any time.
        machine: the state.
        command: the last command.
        spoken: phrases for people nearby, oldest first; the speaker removes them.
        target: the active goal.
        bearing: the direction of the goal from the robot's front, radians.
        unplaced: why the laser's pose is unknown, so that scans cannot be used; set by the source of the scans.
    """

    def __init__(self, settings: RobotGotoSection | None = None) -> None:
        self._first = self.settings = settings or RobotGotoSection()
        self._surroundings = Surroundings(self.settings)
        self.machine: Machine[DriverState, DriverEvent] = Machine(DRIVER, DriverState.IDLE)
        self._cause: tuple[str, Fault] = "", Fault.NONE
        self._move = TimedMove()
        self._now: float | None = None
        self.command = STILL
        self.spoken: deque[str] = deque(maxlen=8)
        self.target: GotoTask | None = None
        self.bearing = 0.0
        self.unplaced = ""

    def reset(self) -> None:
        """Restore the initial settings."""
        self.settings = self._first

    def restart(self) -> None:
        """Drop the goal and all observations, after the clock jumped back."""
        self.cancel()
        self._surroundings.clear()
        self._now = None

    # goals

    def goal(self, pose: Pose, constraints: Constraints | None = None) -> None:
        """Drive to a goal, without a stop if another goal is active. Raises `ValueError` if x or y is not finite.

        The pose is on the map; its theta is NaN if the heading does not matter. With ``enable_retreat``, a standing
        robot without a goal backs off first.
        """
        if not (math.isfinite(pose.x) and math.isfinite(pose.y)):
            raise ValueError(f"a goal's x and y must be finite, not {pose.x} and {pose.y}")
        standing = self.target is None and self.command == STILL
        self._clear()
        if standing:
            self._surroundings.follow.clear()
        self.target = GotoTask(pose, constraints or Constraints())
        if standing and self.settings.enable_retreat:
            self._move = TimedMove(DriveCommand(-RETREAT_SPEED), min(self.settings.retreat_duration, MAX_RETREAT))
            self._on(DriverEvent.BACK_OFF)
        else:
            self._on(DriverEvent.GOAL)

    def approach(self, direction: float, speed: float, seconds: float) -> None:
        """Move with only the laser, in a direction of the robot's frame (radians), at m/s, for ``seconds``.

        Obstacles stop the robot; it moves backward for at most 2 s. A differential base moves only forward or backward.
        """
        self._clear()
        self._surroundings.follow.clear()
        speed = min(abs(speed), self.settings.max_lin_speed)
        back = math.cos(direction) < 0.0
        if not self.settings.robot_is_holonomic:
            direction = math.pi if back else 0.0
        command = DriveCommand(speed * math.cos(direction), speed * math.sin(direction))
        self._move = TimedMove(command, min(max(0.0, seconds), MAX_RETREAT) if back else max(0.0, seconds))
        self._on(DriverEvent.APPROACH)

    def cancel(self) -> None:
        """Drop the goal and stop."""
        self._end(DriverEvent.CANCEL)

    def pause(self, seconds: float = math.inf, reason: str = "") -> bool:
        """Stop for ``seconds``, or until resumed if that is not above 0; return whether there is a goal to pause."""
        if self.target is None:
            return False
        self.target.pause_left = seconds if seconds > 0.0 else math.inf
        self._on(DriverEvent.PAUSE, reason)
        return True

    def resume(self) -> bool:
        """Drive on; return whether the goal was paused."""
        if self.machine.state is not DriverState.PAUSED or self.target is None:
            return False
        self.target.progress.since = None
        self.target.waiting_since = None
        self._on(DriverEvent.RESUME)
        return True

    def _on(self, event: DriverEvent, reason: str = "", fault: Fault = Fault.NONE) -> None:
        self.machine.on(event)
        self._cause = reason, fault

    def _end(self, event: DriverEvent, reason: str = "", fault: Fault = Fault.NONE) -> None:
        self._clear()
        self._on(event, reason, fault)

    def _clear(self) -> None:
        self.target = None
        self._move = TimedMove()

    # state

    @property
    def status(self) -> PlannerStatus:
        """The state as clients receive it."""
        return PlannerStatus(self.machine.state.published, *self._cause)

    @property
    def grid(self) -> LocalGrid:
        """Recent scans around the robot."""
        return self._surroundings.grid

    @property
    def obstacles(self) -> Obstacles:
        """Obstacles seen by sensors other than the laser."""
        return self._surroundings.obstacles

    @property
    def keep_out(self) -> KeepOut:
        return self._surroundings.keep_out

    @property
    def ahead(self) -> NDArray[np.float64]:
        """The surroundings; see `navigation.algorithms.stopping.ahead`."""
        return self._surroundings.guard.ahead

    @property
    def detour(self) -> list[tuple[float, float]]:
        """The next point of a path around obstacles, in the odometry frame; empty if the path is straight."""
        aim = self.target.path.aim if self.target is not None else None
        return [] if aim is None or aim.direct else [(aim.x, aim.y)]

    @property
    def silent(self) -> bool:
        """Whether no command has to be published: no goal is active, and the last command was to stand still."""
        return self.status.state.ended and self.command == STILL

    # steps

    def scan(self, scan: LaserScan, moved: Pose, laser: Pose = AT_BASE) -> None:
        """Add a scan; ``laser`` is the laser's pose on the base.

        ``moved`` is the base's pose at the scan's time, in the odometry frame, or on the map without odometry.
        """
        self.unplaced = ""
        self._surroundings.scan(scan, moved, laser)

    def step(self, now: float, pose: Pose | None, moved: Pose | None = None, lost: str = "") -> DriveCommand:
        """Return the command for the time ``now``, in seconds of the scans' clock.

        ``pose`` is the robot's pose on the map; if it is None, ``lost`` is the reason. ``moved`` is the pose in the
        odometry frame, in which observations are stored, or on the map without odometry.
        """
        since = 0.0 if self._now is None else max(0.0, now - self._now)
        passed, self._now = min(since, LONGEST_STEP), now
        if self.target is not None:
            self.target.skip(since - passed)
        moved = self._surroundings.move(self.settings, now, passed, self.command, pose, moved)
        self.command = self._choose(now, passed, pose, moved, lost)
        return self.command

    def _choose(self, now: float, passed: float, pose: Pose | None, moved: Pose | None, lost: str) -> DriveCommand:
        if self.machine.state is DriverState.PAUSED and self.target is not None:
            self.target.pause_left -= passed
            if self.target.pause_left > 0.0 or not self.resume():
                return STILL
        passing = self.machine.state is DriverState.PASSING
        if self.status.state.ended and not passing:
            return STILL
        trouble = self._trouble(now, pose, lost)
        if trouble is not None or pose is None or moved is None:
            return STILL if passing else self._wait(now, passed, *(trouble or (lost, Fault.NOT_LOCALIZED)))
        follow = self._surroundings.follow
        if follow.waits(now) and not passing:
            if self.target is not None:
                self.target.waiting_since, self.target.obstruction.removed_at = follow.since, now
            return self._wait(now, passed, _DOES_NOT_FOLLOW, Fault.BASE_STANDS)
        step = Step(now, passed, pose, moved)
        if self._move.left > 0.0:
            return self._guarded(step, self._timed(passed))
        if self.target is None:  # the end of an approach
            self._on(DriverEvent.FINISH)
            return STILL
        self.target.driven = True
        return self._guarded(step, self._to_goal(step, self.target))

    def _trouble(self, now: float, pose: Pose | None, lost: str) -> tuple[str, Fault] | None:
        unseen = self._surroundings.unseen(now, self.settings.laser_timeout)
        if unseen and not self.unplaced:
            return unseen, Fault.NO_LASER  # first, as a missing laser also causes a lost pose
        if pose is None and self.target is not None:
            return f"the robot's pose is unknown{': ' if lost else ''}{lost}", Fault.NOT_LOCALIZED
        if unseen:
            return f"the laser's pose is unknown: {self.unplaced}", Fault.NO_LASER
        return None

    def _wait(self, now: float, passed: float, reason: str, fault: Fault) -> DriveCommand:
        """Stop until the reason is gone, and fail if that takes too long."""
        task = self.target
        if task is None:  # an approach without a working laser
            self._end(DriverEvent.ABORT, reason, fault)
            return STILL
        if task.waiting_since is None:
            task.waiting_since = now
        task.progress.excuse(passed)  # waiting is not a deadlock
        waited = now - task.waiting_since
        if waited > self.settings.max_waiting_time:
            again = "" if task.driven else ": send the goal again once it has changed"
            self._end(DriverEvent.GIVE_UP, f"{reason}; gave up after {waited:.0f} s{again}", fault)
        else:
            self._on(DriverEvent.WAIT if task.driven else DriverEvent.NOT_READY, reason, fault)
        return STILL

    def _timed(self, passed: float) -> DriveCommand:
        """Return the command of an approach, a retreat, or the motion past a waypoint."""
        wanted = self._move.advance(passed)
        if self._move.left <= 0.0:
            if self.target is not None:
                self._on(DriverEvent.GO)
            elif self.machine.state is DriverState.PASSING:
                self._on(DriverEvent.FINISH)
        return wanted

    # goal

    def _to_goal(self, step: Step, task: GotoTask) -> DriveCommand:
        limits = GoalLimits.combine(self.settings, task.constraints, self.keep_out.map_name)
        relative = step.pose.inverse @ task.pose
        distance, self.bearing = math.hypot(relative.x, relative.y), math.atan2(relative.y, relative.x)
        turn = wrapped(task.pose.theta - step.pose.theta) if task.heading else 0.0
        task.near = distance < limits.tolerance_lin * (1.5 if task.near else 1.0)
        if task.near:
            if abs(turn) <= limits.tolerance_ang and self._comes_to_rest(task, turn, limits.tolerance_ang):
                return self._reached(through=task.constraints.through)
            task.waiting_since = None
            self._on(DriverEvent.GO)
            if self._stuck(step.now, task, task.progress.best, task.progress.nearest, abs(turn)):
                return STILL
            return DriveCommand(omega=limits.turn(limits.ang_gain * turn))
        moved = step.moved
        toward = self._toward(step, task, limits, relative)
        beta = wrapped(math.atan2(toward.y - moved.y, toward.x - moved.x) - moved.theta)
        if self._blocked(step, task, limits, beta, distance, toward.blocked):
            return STILL
        if self._stuck(step.now, task, toward.left, distance, math.inf):
            return STILL
        ramp = task.obstruction.ramp(step.now)
        wanted = drive(
            self.settings, limits, distance, beta, float(self.ahead[3]), ramp, through=task.constraints.through
        )
        safe = people_speed(self.settings, float(self.ahead[2]) - self.settings.robot_radius - FAST_ROOM)
        share = min(1.0, safe / wanted.speed) if wanted.speed else 1.0
        return DriveCommand(wanted.vx * share, wanted.vy * share, wanted.omega)

    def _comes_to_rest(self, task: GotoTask, turn: float, tolerance: float) -> bool:
        """Whether a robot that brakes now stops within the tolerance of a heading, ``turn`` radians away."""
        omega = float(self._surroundings.guard.velocity[2])
        braking = omega * abs(omega) / (2.0 * math.radians(self.settings.max_ang_acc))
        return not task.heading or abs(turn - braking) <= tolerance

    def _reached(self, *, through: bool) -> DriveCommand:
        """End the goal; past a waypoint the robot continues."""
        if not through:
            self._end(DriverEvent.REACH)
            return STILL
        self._end(DriverEvent.WAYPOINT)
        self._move = TimedMove(self.command, COAST)
        return self.command

    def _toward(self, step: Step, task: GotoTask, limits: GoalLimits, relative: Pose) -> Aim:
        """Return the point to drive to, in the grid's frame."""
        goal = step.moved @ relative
        if not limits.avoid:
            return Aim(goal.x, goal.y, math.inf, math.hypot(relative.x, relative.y), True, (goal.x, goal.y))
        if not task.heading:
            goal = goal._replace(theta=math.nan)
        narrow, leave = task.hold.narrow(step.now), self._surroundings.guard.slows(step.now)
        return task.path.next(self.grid, step.now, step.moved, goal, self.settings.robot_radius, narrow, leave=leave)

    def _blocked(
        self, step: Step, task: GotoTask, limits: GoalLimits, beta: float, distance: float, blocked: float
    ) -> bool:
        """Whether to wait for an obstacle ahead; also add a phrase for people nearby."""
        now, obstruction, guard = step.now, task.obstruction, self._surroundings.guard
        waiting = self.machine.state is DriverState.WAITING
        path = step.moved, beta, distance, blocked
        reason = obstruction.reason(self.settings, limits, guard, *path, waiting=waiting)
        if reason:
            if obstruction.seen_at < now - CLEAR and not waiting:
                self.spoken.append("Obstacles detected")
            obstruction.seen_at = now
        elif now - obstruction.seen_at <= CLEAR:
            reason = "the path has just become free"
        if reason:
            self._wait(now, step.passed, reason, Fault.BLOCKED)
            return True
        if task.waiting_since is not None:
            if math.isfinite(obstruction.seen_at):
                self.spoken.append("Obstacles removed, thank you")
            task.waiting_since, obstruction.removed_at, obstruction.seen_at = None, now, -math.inf
        self._on(DriverEvent.GO)
        return False

    def _stuck(self, now: float, task: GotoTask, left: float, away: float, turn: float) -> bool:
        """Whether progress has been missing for too long; ends or pauses the goal then."""
        missing = task.progress.missing(now, left, away, turn)
        if missing <= self.settings.deadlock_time:
            return False
        reason = f"deadlock: no progress for {missing:.0f} s"
        if self.settings.on_deadlock == "pause":
            self.pause(math.inf, reason)
        else:
            self._end(DriverEvent.ABORT, reason, Fault.BLOCKED)
        return True

    # guard

    def _guarded(self, step: Step, wanted: DriveCommand) -> DriveCommand:
        """Return a safe command, or one that turns the robot so that the laser sees the path ahead."""
        guard, task = self._surroundings.guard, self.target
        slowed = guard.allowed(self.settings, step.now, step.moved, wanted)
        if task is None or self._move.left > 0.0:
            return slowed
        if not (task.search.active or (wanted.speed and guard.unseen)):
            refused = bool(wanted.speed) and not slowed.speed and abs(slowed.omega) < _FACING
            if not task.hold.add(step.now, step.moved, refused=refused):
                return slowed
            task.waiting_since = task.hold.since
            return self._wait(step.now, step.passed, "the path is too narrow here", Fault.BLOCKED)
        turning = task.search.advance(guard, step.moved, step.passed, math.radians(self.settings.max_ang_speed))
        if turning is not None:
            return turning
        if slowed.speed:  # creep
            return slowed
        return self._wait(step.now, step.passed, "the laser cannot see the path ahead", Fault.BLOCKED)
