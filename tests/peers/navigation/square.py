"""A program on one side drives squares; its commands and odometry pass only through that side."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Protocol

SPEED, TURN = 0.3, 0.8
SIDES = 4


class Pose(NamedTuple):
    """A pose in meters, meters and radians."""

    x: float
    y: float
    theta: float


class Program(Protocol):
    """The program that drives."""

    def command(self, x: float, turn: float) -> None:
        """Command a velocity, in m/s and rad/s."""

    def pose(self, after_ns: int) -> Pose:
        """Return odometry with this stamp or a later one."""


def driven(program: Program, side: float, step: Callable[[], int], sides: int = SIDES) -> Iterator[Pose]:
    """Drive a square or its first sides by odometry, and yield the odometry's pose at each corner.

    Args:
        program: drives the robot.
        side: length of a side, meters.
        step: advances the simulation, and returns its time in nanoseconds.
        sides: how many sides to drive.
    """
    now = step()
    start = program.pose(now)
    for corner in range(sides):
        heading = start.theta + corner * math.pi / 2
        target = _ahead(start, corner, side)
        for goal in (target, None):
            while True:
                pose = program.pose(now)
                wanted = heading if goal is not None else heading + math.pi / 2
                command = _toward(pose, wanted, goal)
                program.command(*command)
                now = step()
                if command == (0.0, 0.0):
                    break
        yield program.pose(now)


def _ahead(start: Pose, corner: int, side: float) -> tuple[float, float]:
    x, y = start.x, start.y
    for leg in range(corner + 1):
        angle = start.theta + leg * math.pi / 2
        x, y = x + side * math.cos(angle), y + side * math.sin(angle)
    return x, y


def _toward(pose: Pose, heading: float, goal: tuple[float, float] | None) -> tuple[float, float]:
    """Return a command toward a point, or, without a point, to turn to a heading; zero once that is reached."""
    if goal is None:
        left = math.remainder(heading - pose.theta, 2 * math.pi)
        return (0.0, 0.0) if abs(left) < 0.005 else (0.0, _clipped(2.5 * left, TURN))
    dx, dy = goal[0] - pose.x, goal[1] - pose.y
    ahead = dx * math.cos(heading) + dy * math.sin(heading)
    aside = -dx * math.sin(heading) + dy * math.cos(heading)
    if ahead < 0.005:
        return 0.0, 0.0
    turn = math.remainder(heading - pose.theta, 2 * math.pi) + 2.0 * aside
    return _clipped(1.8 * ahead, SPEED), _clipped(turn, TURN)


def _clipped(value: float, most: float) -> float:
    return math.copysign(min(max(abs(value), 0.01), most), value)


def pose_of(odometry: dict[str, Any]) -> tuple[int, Pose]:
    """Return the stamp (nanoseconds) and the pose of a `nav_msgs/Odometry` in any side's spelling."""
    stamp, pose = odometry["header"]["stamp"], odometry["pose"]["pose"]
    seconds, nanoseconds = stamp.get("sec", stamp.get("secs")), stamp.get("nanosec", stamp.get("nsecs"))
    theta = 2.0 * math.atan2(pose["orientation"]["z"], pose["orientation"]["w"])
    return seconds * 1_000_000_000 + nanoseconds, Pose(pose["position"]["x"], pose["position"]["y"], theta)
