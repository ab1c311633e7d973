"""One drive to a goal: the loop that ticks all parts, and the result."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from benchmarks.closedloop.judge import STANDING, Judge
from benchmarks.closedloop.robot import Robot
from navigation.constraints import Constraints
from navigation.pose import Pose, wrapped
from navigation.status import State
from sim.base import TICK_NS

NEAR_METERS, NEAR_DEGREES = 0.25, 10.0
"""True distance within which a goal counts as reached: the goal's tolerance plus the localizer's error."""

_TURNING = 0.02  # rad/s; a robot that turns more slowly stands
_SPEED = 0.1  # m/s of a slow drive
_EXTRA = 180.0  # seconds that a drive may take in addition to the time at _SPEED


class Stack(Protocol):
    """The software that drives a robot: planner, local navigator and localizer."""

    def goal(self, pose: Pose, constraints: Constraints | None = None) -> None:
        """Start driving to a pose on the map."""

    def stop(self) -> None:
        """Cancel the goal."""

    def step(self) -> None:
        """Process the sensor data of the last tick, and command the robot."""

    @property
    def status(self) -> tuple[State, str]:
        """Return the state, and its reason."""

    @property
    def pose(self) -> Pose | None:
        """Return the estimated pose on the map, None if it is unknown."""


@dataclass(frozen=True)
class Drive:
    """The result of a drive.

    Attributes:
        reached: whether the goal was reported as reached, and actually reached.
        state: the final state.
        reason: the reported reason.
        seconds: simulated time until the goal ended.
        driven: driven distance, meters.
        optimum: length of the shortest path, meters.
        off: true distance from the goal at the end, meters.
        lost: maximum distance between estimated and true position, meters.
        stood: seconds for which the robot neither moved nor turned.
    """

    reached: bool
    state: State
    reason: str
    seconds: float
    driven: float
    optimum: float
    off: float
    lost: float
    stood: float


class Loop:
    """Ticks a robot, the software that drives it, and the judge.

    Args:
        robot: the robot.
        stack: the software that drives it.
        judge: detects contacts and entries.

    Attributes:
        lost: maximum distance between estimated and true position since it was reset, meters.
        stood: seconds since it was reset for which the robot neither moved nor turned.
    """

    def __init__(self, robot: Robot, stack: Stack, judge: Judge) -> None:
        self.robot, self.stack, self.judge = robot, stack, judge
        self.lost = self.stood = 0.0

    def tick(self) -> None:
        """Advance by 10 ms."""
        self.stack.step()
        self.robot.tick()
        self.judge.check()
        if self.robot.moving < STANDING and abs(self.robot.turning) < _TURNING:
            self.stood += TICK_NS / 1e9
        pose = self.stack.pose
        if pose is not None:
            self.lost = max(self.lost, pose.distance(self.robot.truth))

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Advance by a time, or until a condition holds; return whether it held."""
        for _ in range(round(seconds * 100)):
            if until():
                return True
            self.tick()
        return until()

    def settle(self) -> None:
        """Wait until the robot rests and the localizer has settled."""
        self.run(1.0)

    def drive(self, goal: Pose, optimum: float = math.inf, seconds: float | None = None) -> Drive:
        """Drive to a goal on the map, within a number of seconds (by default, the duration of a slow drive)."""
        began, driven = self.robot.now, self.robot.driven
        self.lost = self.stood = 0.0
        self.stack.goal(goal)
        self.stack.step()
        self.run(seconds or optimum / _SPEED + _EXTRA, lambda: self.stack.status[0].ended)
        state, reason = self.stack.status
        if not state.ended:
            self.stack.stop()
        seconds, stood = self.robot.now - began, self.stood
        self.settle()
        truth = self.robot.truth
        off, turned = truth.distance(goal), abs(math.degrees(wrapped(truth.theta - goal.theta)))
        reached = state is State.REACHED and off < NEAR_METERS and turned < NEAR_DEGREES
        driven = self.robot.driven - driven
        return Drive(reached, state, reason, seconds, driven, optimum, off, self.lost, stood)
