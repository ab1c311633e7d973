"""One drive to a goal: the loop that ticks everything, and what came of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from benchmarks.closedloop.judge import Judge
from benchmarks.closedloop.robot import Robot
from navigation.constraints import Constraints
from navigation.pose import Pose, wrapped
from navigation.status import State

NEAR_METERS, NEAR_DEGREES = 0.25, 10.0
"""In truth so near to its goal a robot is that says to have reached it: its tolerance and its localizer's error."""

_SPEED = 0.1
_EXTRA = 180.0


class Stack(Protocol):
    """Who drives a robot: planner, local navigator and localizer."""

    def goal(self, pose: Pose, constraints: Constraints | None = None) -> None:
        """Begin to drive there, on the map."""

    def stop(self) -> None:
        """Give the goal up."""

    def step(self) -> None:
        """Take up what the robot's last tick brought, and command it."""

    @property
    def status(self) -> tuple[State, str]:
        """How it is getting on, and why."""

    @property
    def pose(self) -> Pose | None:
        """Where it believes the robot to be, on the map; None while it does not know."""


@dataclass(frozen=True)
class Drive:
    """What came of one.

    Attributes:
        reached: whether it was said to be reached, and was.
        state: how it ended.
        reason: what was said of it.
        seconds: of simulated time.
        driven: meters.
        optimum: meters of the shortest way.
        off: meters from the goal at the end, in truth.
        lost: meters between where the robot believed to be and where it was, the most.
    """

    reached: bool
    state: State
    reason: str
    seconds: float
    driven: float
    optimum: float
    off: float
    lost: float


class Loop:
    """Ticks a robot, who drives it and who watches it.

    Args:
        robot: who is driven.
        stack: who drives it.
        judge: who watches.

    Attributes:
        lost: meters between belief and truth, the most since it was set.
    """

    def __init__(self, robot: Robot, stack: Stack, judge: Judge) -> None:
        self.robot, self.stack, self.judge = robot, stack, judge
        self.lost = 0.0

    def tick(self) -> None:
        """Let 10 ms pass."""
        self.stack.step()
        self.robot.tick()
        self.judge.check()
        pose = self.stack.pose
        if pose is not None:
            self.lost = max(self.lost, pose.distance(self.robot.truth))

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Let so much time pass, or less where something comes true; whether it did."""
        for _ in range(round(seconds * 100)):
            if until():
                return True
            self.tick()
        return until()

    def settle(self) -> None:
        """Let the robot come to rest and the localizer settle."""
        self.run(1.0)

    def drive(self, goal: Pose, optimum: float = math.inf, seconds: float | None = None) -> Drive:
        """Drive to a goal on the map, for so many seconds at most (by default what a slow drive takes)."""
        began, driven = self.robot.now, self.robot.driven
        self.lost = 0.0
        self.stack.goal(goal)
        self.stack.step()
        self.run(seconds or optimum / _SPEED + _EXTRA, lambda: self.stack.status[0].ended)
        state, reason = self.stack.status
        if not state.ended:
            self.stack.stop()
        self.settle()
        truth = self.robot.truth
        off, turned = truth.distance(goal), abs(math.degrees(wrapped(truth.theta - goal.theta)))
        reached = state is State.REACHED and off < NEAR_METERS and turned < NEAR_DEGREES
        seconds, driven = self.robot.now - began, self.robot.driven - driven
        return Drive(reached, state, reason, seconds, driven, optimum, off, self.lost)
