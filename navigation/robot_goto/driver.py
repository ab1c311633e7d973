"""RobotGoto without its ports: drives to a goal with only a laser and the robot's pose.

Time is an argument, so that tests and benchmarks run it in lock-step with a simulator.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from bridge.config.sections.planners import RobotGotoSection
from bridge.messages.scan import Turn
from navigation.constraints import Constraints
from navigation.pose import Pose, wrapped
from navigation.robot_goto.guard import FAST_ROOM, FollowCheck, Guard
from navigation.robot_goto.local_grid import LocalGrid
from navigation.robot_goto.obstacles import Obstacles
from navigation.robot_goto.steering import STILL, Aim, DriveCommand, GoalLimits, GotoTask, aim, drive, people_speed
from navigation.scan import AT_BASE, is_blind
from navigation.status import Fault, PlannerStatus, State

COAST = 0.3  # seconds for which the robot continues past a waypoint while it has no next goal
CLEAR = 1.0  # seconds for which the path has to be free before the robot drives on
RAMP = 2.0  # seconds in which it then accelerates to full speed
RETREAT_SPEED = 0.2
MAX_RETREAT = 2.0
_PROGRESS, _TURN_PROGRESS = 0.05, math.radians(2.0)
_JUMP, _JUMP_TURN = 0.3, math.radians(30.0)
_DOES_NOT_FOLLOW = "the base does not follow its commands: check its emergency stop and its odometry"
_SCAN_TURN, _SCAN_TURNS, _SCAN_AGAIN = 0.5 * math.pi, 2, 0.3  # radians, number of turns, meters


class Driver:
    """Drives a robot to goals; its settings may be replaced at any time."""

    def __init__(self, settings: RobotGotoSection | None = None) -> None:
        self._first = self.settings = settings or RobotGotoSection()
        # recent scans around the robot
        self.grid = LocalGrid(self.settings.memory, self.settings.robot_radius, self.settings.laser_offset)
        self.obstacles = Obstacles(self.settings)  # seen by other sensors than the laser
        self.status = PlannerStatus()
        self.command = STILL  # the last one
        # phrases for people nearby, oldest first; the speaker removes them
        self.spoken: deque[str] = deque(maxlen=8)
        self._guard = Guard(self.grid)
        self._stall = FollowCheck()
        self.target: GotoTask | None = None
        self._aim: Aim | None = None
        self._aimed: float | None = None
        self._waiting_since: float | None = None
        self._turned_at: Pose | None = None
        self._now: float | None = None
        self._moved: Pose | None = None
        self._passed = 0.0
        self._last = STILL
        self.bearing = 0.0  # of the goal, from the robot's front, radians
        # why scans cannot be used: a transform is missing; set by the source of the scans
        self.unplaced, self._blind = "", False
        self._clear()

    def reset(self) -> None:
        """Restore the initial settings."""
        self.settings = self._first

    def restart(self) -> None:
        """Drop the goal and all observations, after the clock jumped back."""
        self.cancel()
        self.grid.clear()
        self.obstacles.clear()
        self._stall.clear()
        self._now = self._moved = None

    # goals

    def goal(self, pose: Pose, constraints: Constraints | None = None) -> None:
        """Drive to a goal, without a stop if another one is active. Raises `ValueError` if x or y is not finite.

        The pose is on the map; its theta is NaN if the heading does not matter.
        """
        if not (math.isfinite(pose.x) and math.isfinite(pose.y)):
            raise ValueError(f"a goal's x and y must be finite, not {pose.x} and {pose.y}")
        standing = self.target is None and self.command == STILL
        self._clear()
        if standing:
            self._stall.clear()
        self.target = GotoTask(pose, constraints or Constraints())
        back_off = standing and self.settings.enable_retreat
        self.status = PlannerStatus(State.PREPARING if back_off else State.MOVING)
        self._retreat = min(self.settings.retreat_duration, MAX_RETREAT) if back_off else 0.0

    def approach(self, direction: float, speed: float, seconds: float) -> None:
        """Move with only the laser, in a direction of the robot's frame (radians), at m/s, for some seconds.

        Obstacles stop it; backwards it moves for at most 2 s. A differential base moves forward or backward only.
        """
        self._clear()
        self._stall.clear()
        speed = min(abs(speed), self.settings.max_lin_speed)
        back = math.cos(direction) < 0.0
        if not self.settings.robot_is_holonomic:
            direction = math.pi if back else 0.0
        self._push = DriveCommand(speed * math.cos(direction), speed * math.sin(direction))
        self._push_left = min(max(0.0, seconds), MAX_RETREAT) if back else max(0.0, seconds)
        self.status = PlannerStatus(State.PREPARING)

    def cancel(self) -> None:
        """Drop the goal and stop."""
        self._clear()
        self.status = PlannerStatus()

    def pause(self, seconds: float = math.inf, reason: str = "") -> bool:
        """Stop for some seconds, or until resumed if they are 0 or NaN; return whether there is a goal to pause."""
        if self.target is None:
            return False
        self._pause_left = seconds if seconds > 0.0 else math.inf
        self.status = PlannerStatus(State.PAUSED, reason)
        return True

    def resume(self) -> bool:
        """Drive on; return whether the goal was paused."""
        if self.status.state is not State.PAUSED or self.target is None:
            return False
        self.target.progress_at = None
        self._waiting_since = None
        self.status = PlannerStatus(State.MOVING)
        return True

    def _clear(self) -> None:
        self.target = None
        self._push = STILL
        self._push_left = self._retreat = self._coast = self._pause_left = 0.0
        self._aim = None
        self._aimed = None
        self._waiting_since = None
        self._seen_at = self._removed_at = -math.inf
        self._length = 0.0
        self._turn_left = self._turn_sign = 0.0
        self._turns = 0
        self._turned_at = None

    @property
    def ahead(self) -> NDArray[np.float64]:
        """The surroundings; see `navigation.algorithms.stopping.ahead`."""
        return self._guard.ahead

    @property
    def detour(self) -> list[tuple[float, float]]:
        """The next point of a path around obstacles, in the odometry frame; empty if it drives straight to the goal."""
        return [] if self._aim is None or self._aim.direct else [(self._aim.x, self._aim.y)]

    @property
    def silent(self) -> bool:
        """Whether to publish no command, since there is no goal."""
        return self.status.state.ended and self.command == STILL

    # sensors

    def scan(self, scan: Turn, moved: Pose, laser: Pose = AT_BASE) -> None:
        """Add a scan; ``laser`` is the laser's pose on the base.

        ``moved`` is the base's pose at the scan's time, in the odometry frame, or on the map without odometry.
        """
        self.unplaced, self._blind = "", is_blind(scan)
        if not self._blind:
            self.grid.scan(scan, moved, laser)

    def step(self, now: float, pose: Pose | None, moved: Pose | None = None, lost: str = "") -> DriveCommand:
        """Return the command for now, in seconds of the scans' clock.

        ``pose`` is the robot's on the map, or None for the reason ``lost``. ``moved`` is its pose in the odometry
        frame, in which observations are stored, or on the map without odometry.
        """
        passed = 0.0 if self._now is None else min(max(0.0, now - self._now), 1.0)
        self._now = now
        self._passed = passed
        self._guard.follow(self.settings, self.command, passed)
        if moved is not None:
            self._guard.measure(self.settings, now, moved)
        moved = moved or pose
        if moved is not None:
            if self._moved is not None and _jumped(self._moved, moved, passed):
                self.grid.clear()
                self.obstacles.clear_clouds()
                self._guard.clear()
                self._stall.clear()
            self._moved = moved
            self._stall.add(now, passed, self._guard.has, moved)
            if self.settings.obstacles:
                self.grid.set_others(self.obstacles.places(now, pose, moved))
        self.command = self._choose(now, passed, pose, moved, lost)
        return self.command

    def _choose(self, now: float, passed: float, pose: Pose | None, moved: Pose | None, lost: str) -> DriveCommand:
        if self.status.state is State.PAUSED:
            self._pause_left -= passed
            if self._pause_left > 0.0 or not self.resume():
                return STILL
        coasting = self._coast > 0.0
        if self.status.state.ended and not coasting:
            return STILL
        trouble = self._trouble(now, pose, lost)
        if trouble is not None or pose is None or moved is None:
            reason, fault = trouble or (lost, Fault.NOT_LOCALIZED)
            return STILL if coasting else self._wait(now, reason, fault)
        if self._stall.waits(now) and not coasting:
            self._waiting_since, self._removed_at = self._stall.since, now
            return self._wait(now, _DOES_NOT_FOLLOW, Fault.BASE_STANDS)
        if coasting:
            self._coast -= passed
            return self._guarded(now, moved, self._last) if self._coast > 0.0 else STILL
        if self._push_left > 0.0 or self._retreat > 0.0:
            return self._push_step(now, passed, moved)
        if self.target is None:  # the end of an approach
            self.status = PlannerStatus()
            return STILL
        self.target.driven = True
        self._last = self._goal_step(now, self.target, pose, moved)
        return self._guarded(now, moved, self._last)

    def _trouble(self, now: float, pose: Pose | None, lost: str) -> tuple[str, Fault] | None:
        unseen = self._unseen(now)
        if unseen and not self.unplaced:
            return unseen, Fault.NO_LASER  # first, as a missing laser also causes a lost pose
        if pose is None and self.target is not None:
            return f"the robot's pose is unknown{': ' if lost else ''}{lost}", Fault.NOT_LOCALIZED
        if unseen:
            return f"the laser's pose is unknown: {self.unplaced}", Fault.NO_LASER
        return None

    def _unseen(self, now: float) -> str:
        """Return why obstacles are not seen; "" if all sensors work."""
        scanned = self.grid.scanned
        if scanned is not None and now - scanned <= self.settings.laser_timeout:
            return self.obstacles.silence(now)
        if self._blind:
            return "the laser is blind: no beam has a valid range"
        if scanned is None:
            return "waiting for the first scan of the laser"
        return f"the laser is silent: its last scan is {now - scanned:.1f} s old"

    def _wait(self, now: float, reason: str, fault: Fault) -> DriveCommand:
        """Stop until the reason is gone, and fail if that takes too long."""
        if self.target is None:  # an approach without a working laser
            self._clear()
            self.status = PlannerStatus(State.ABORTED, reason, fault)
            return STILL
        if self._waiting_since is None:
            self._waiting_since = now
        if self.target.progress_at is not None:
            self.target.progress_at += self._passed  # waiting is not a deadlock
        waited = now - self._waiting_since
        early = not self.target.driven  # the robot could not drive yet
        if waited > self.settings.max_waiting_time:
            again = ": send the goal again once it has changed" if early else ""
            self._end(State.FAILING, f"{reason}; gave up after {waited:.0f} s{again}", fault)
        else:
            self.status = PlannerStatus(State.PREPARING if early else State.WAITING, reason, fault)
        return STILL

    def _end(self, state: State, reason: str, fault: Fault = Fault.NONE) -> None:
        self._clear()
        self.status = PlannerStatus(state, reason, fault)

    def _push_step(self, now: float, passed: float, moved: Pose) -> DriveCommand:
        """Retreat or approach."""
        if self._push_left > 0.0:
            self._push_left -= passed
            wanted = self._push if self._push_left > 0.0 else STILL
        else:
            self._retreat -= passed
            wanted = DriveCommand(-RETREAT_SPEED) if self._retreat > 0.0 else STILL
            if self._retreat <= 0.0:
                self.status = PlannerStatus(State.MOVING)
        return self._guarded(now, moved, wanted)

    # goal

    def _goal_step(self, now: float, task: GotoTask, pose: Pose, moved: Pose) -> DriveCommand:
        limits = GoalLimits.combine(self.settings, task.constraints)
        relative = pose.inverse @ task.pose
        distance, self.bearing = math.hypot(relative.x, relative.y), math.atan2(relative.y, relative.x)
        turn = wrapped(task.pose.theta - pose.theta) if task.heading else 0.0
        task.near = distance < limits.tolerance_lin * (1.5 if task.near else 1.0)
        if task.near:
            if abs(turn) <= limits.tolerance_ang:
                self._reached(task)
                return DriveCommand(*self.command) if task.constraints.through else STILL
            self._waiting_since = None
            self.status = PlannerStatus(State.MOVING)
            if self._stuck(now, task, task.best, abs(turn)):
                return STILL
            return DriveCommand(omega=limits.turn(limits.ang_gain * turn))
        towards = self._towards(now, limits, moved, relative)
        beta = wrapped(math.atan2(towards.y - moved.y, towards.x - moved.x) - moved.theta)
        if self._blocked(now, limits, moved, beta, distance, towards) or self._stuck(now, task, towards.left, math.inf):
            return STILL
        ramp = min(1.0, max(0.05, (now - self._removed_at) / RAMP))
        wanted = drive(
            self.settings, limits, distance, beta, float(self.ahead[3]), ramp, through=task.constraints.through
        )
        safe = people_speed(self.settings, float(self.ahead[2]) - self.settings.robot_radius - FAST_ROOM)
        share = min(1.0, safe / wanted.speed) if wanted.speed else 1.0
        return DriveCommand(wanted.vx * share, wanted.vy * share, wanted.omega)

    def _reached(self, task: GotoTask) -> None:
        self._end(State.REACHED, "")
        self._coast = COAST if task.constraints.through else 0.0

    def _towards(self, now: float, limits: GoalLimits, moved: Pose, relative: Pose) -> Aim:
        """Return the point to drive to, in the grid's frame."""
        goal = moved @ relative
        if not limits.avoid:
            return Aim(goal.x, goal.y, math.inf, math.hypot(relative.x, relative.y), True, (goal.x, goal.y))
        if self._aim is None or self._aimed != self.grid.scanned:
            self._aim = aim(self.grid, now, moved, (goal.x, goal.y), self.settings.robot_radius, self._aim)
            self._aimed = self.grid.scanned
        return self._aim._replace(x=goal.x, y=goal.y) if self._aim.direct else self._aim

    def _blocked(self, now: float, limits: GoalLimits, moved: Pose, beta: float, distance: float, towards: Aim) -> bool:
        """Whether to wait for an obstacle ahead; also add a phrase for people nearby."""
        settings = self.settings
        length = settings.max_detection_distance
        if settings.enable_dynamic_max_distance:
            length *= min(
                1.0, float(np.hypot(self._guard.has[0], self._guard.has[1])) / max(settings.max_lin_speed, 1e-3)
            )
        length = max(length, settings.min_detection_distance)
        if self.status.state is State.WAITING:
            length = max(length, self._length)  # an obstacle that stopped the robot early still counts when it stands
        self._length = length
        radius = settings.robot_radius
        self._guard.check_ahead(settings, moved, beta, min(length, distance + radius))
        reason = ""
        if limits.avoid:
            if towards.blocked < max(length, radius + 0.2):
                reason = "the path is blocked"
            elif limits.stop and self.ahead[1] >= 2:
                reason = "a person crosses the path"
            elif people_speed(settings, self.ahead[2] - radius - FAST_ROOM) < 0.02:
                reason = "a person is too close"
        elif limits.stop and self.ahead[0] >= 2:
            reason = "an obstacle is on the path"
        if reason:
            if self._seen_at < now - CLEAR and self.status.state is not State.WAITING:
                self.spoken.append("Obstacles detected")
            self._seen_at = now
            self._wait(now, reason, Fault.BLOCKED)
            return True
        if now - self._seen_at <= CLEAR:
            self._wait(now, "the path has just become free", Fault.BLOCKED)
            return True
        if self._waiting_since is not None:
            if math.isfinite(self._seen_at):
                self.spoken.append("Obstacles removed, thank you")
            self._waiting_since, self._removed_at, self._seen_at = None, now, -math.inf
        self.status = PlannerStatus(State.MOVING)
        return False

    def _stuck(self, now: float, task: GotoTask, left: float, turn: float) -> bool:
        """Whether there was no progress for too long; ends or pauses the goal then."""
        if task.progress_at is None or left < task.best - _PROGRESS or turn < task.best_turn - _TURN_PROGRESS:
            task.best, task.best_turn, task.progress_at = left, turn, now
        if now - task.progress_at <= self.settings.deadlock_time:
            return False
        reason = f"deadlock: no progress for {now - task.progress_at:.0f} s"
        if self.settings.on_deadlock == "pause":
            self.pause(math.inf, reason)
        else:
            self._end(State.ABORTED, reason, Fault.BLOCKED)
        return True

    # guard

    def _guarded(self, now: float, moved: Pose, wanted: DriveCommand) -> DriveCommand:
        slowed = self._guard.allowed(self.settings, now, moved, wanted)
        unseen = wanted.speed and self._guard.unseen
        if (unseen or self._turn_left > 0.0) and self.target is not None and self._retreat <= 0.0:
            return self._turn_to_see(now, moved, slowed)
        return slowed

    def _turn_to_see(self, now: float, moved: Pose, slowed: DriveCommand) -> DriveCommand:
        """Turn in place until the laser sees the path, to both sides; then creep if possible."""
        if self._turned_at is None or self._turned_at.distance(moved) > _SCAN_AGAIN:
            self._turns, self._turned_at = 0, moved
        if self._turn_left <= 0.0:
            if self._turns >= _SCAN_TURNS:
                unseen = "the laser cannot see the path ahead"
                return slowed if slowed.speed else self._wait(now, unseen, Fault.BLOCKED)
            bearing = math.atan2(self._guard.blocker[1] - moved.y, self._guard.blocker[0] - moved.x) - moved.theta
            self._turn_sign = math.copysign(1.0, wrapped(bearing))
            self._turn_left = _SCAN_TURN
            self._turns += 1
        self._turn_left -= abs(self._guard.has[2]) * self._passed
        return DriveCommand(omega=self._turn_sign * math.radians(self.settings.max_ang_speed))


def _jumped(before: Pose, moved: Pose, passed: float) -> bool:
    """Whether the odometry was reset: no base is as fast."""
    turned = abs(wrapped(moved.theta - before.theta))
    return before.distance(moved) > _JUMP + 2.0 * passed or turned > _JUMP_TURN + math.tau * passed
