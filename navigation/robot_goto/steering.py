"""Commands, the limits of a goal, the path down the potential field, and the control law that follows it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.potential_field import Descent, descend
from navigation.algorithms.rolling_grid import OCCUPIED, UNKNOWN
from navigation.constraints import Constraints
from navigation.pose import Pose, wrapped
from navigation.robot_goto.local_grid import RESOLUTION, SIDE, LocalGrid
from navigation.robot_goto.section import RobotGotoSection


class DriveCommand(NamedTuple):
    """A velocity in the robot's frame: m/s, m/s, rad/s."""

    vx: float = 0.0
    vy: float = 0.0
    omega: float = 0.0

    @property
    def speed(self) -> float:
        """The speed in any direction, m/s."""
        return math.hypot(self.vx, self.vy)

    @property
    def polar(self) -> tuple[float, float, float]:
        """Direction (degrees), speed (m/s) and angular velocity (deg/s), as on YARP's port ``control:o``."""
        direction = math.degrees(math.atan2(self.vy, self.vx)) if self.speed else 0.0
        return direction, self.speed, math.degrees(self.omega)


STILL = DriveCommand()


INFLUENCE = 0.8  # meters beyond which obstacles do not repel (upstream's ``max_obstacle_distance``)
_SPARE = 0.05
_AWAY = 1.0  # meters by which a path out of the window may lead away from the goal; else the robot waits
_WORTH = 0.5
"""Meters of progress per meter of a blocked path; with less progress, the robot waits where it is."""

_AROUND, _ROOM = 1.0, 0.06
"""Within this distance of a place where the robot was held, paths keep this much more room; meters."""

_WIDE = math.radians(60.0)  # a robot that avoids obstacles drives slowly even if it has to turn by up to this angle
_BEND_FROM, _BEND, _BEND_MOST = 1.0, 0.3, math.radians(100.0)
"""Within this distance (meters), the robot bends its path to the goal's heading: it drives to a point behind the goal,
at this share of the distance. If the heading differs more (radians), it turns at the goal."""


class GoalLimits(NamedTuple):
    """The limits for one goal: the settings, overridden by its constraints. Meters, radians, seconds."""

    max_lin: float
    min_lin: float
    max_ang: float
    min_ang: float
    lin_gain: float
    ang_gain: float
    tolerance_lin: float
    tolerance_ang: float
    avoid: bool
    stop: bool

    @classmethod
    def combine(cls, settings: RobotGotoSection, constraints: Constraints, known_map: str = "") -> GoalLimits:
        """Return the limits of a goal; a goal never raises the settings' top speeds.

        Beside keep-out cells of another map than ``known_map``, the robot waits for obstacles instead of avoiding them.
        """
        waits = constraints.beside_keep_out not in ("", known_map)
        on_obstacle = "wait" if waits else constraints.on_obstacle

        def chosen(value: float | None, own: float) -> float:
            return own if value is None else value

        max_lin = min(chosen(constraints.max_lin_speed, settings.max_lin_speed), settings.max_lin_speed)
        max_ang = min(chosen(constraints.max_ang_speed, settings.max_ang_speed), settings.max_ang_speed)
        return cls(
            max_lin,
            min(chosen(constraints.min_lin_speed, settings.min_lin_speed), max_lin),
            math.radians(max_ang),
            math.radians(min(chosen(constraints.min_ang_speed, settings.min_ang_speed), max_ang)),
            chosen(constraints.lin_speed_gain, settings.lin_speed_gain),
            chosen(constraints.ang_speed_gain, settings.ang_speed_gain),
            chosen(constraints.tolerance_lin, settings.goal_tolerance_lin),
            math.radians(chosen(constraints.tolerance_ang, settings.goal_tolerance_ang)),
            on_obstacle == "around" or (not on_obstacle and settings.enable_obstacles_avoidance),
            on_obstacle == "wait" or settings.enable_obstacles_emergency_stop,
        )

    def speed(self, value: float) -> float:
        """Clip a speed to its limits; 0 stays 0."""
        return clip(value, self.min_lin, self.max_lin)

    def turn(self, value: float) -> float:
        """Clip an angular velocity to its limits; 0 stays 0."""
        return clip(value, self.min_ang, self.max_ang)


def clip(value: float, least: float, most: float) -> float:
    """Clip the magnitude of a value; 0 stays 0."""
    return math.copysign(min(most, max(least, abs(value))), value) if value else 0.0


class Aim(NamedTuple):
    """The point to drive to."""

    x: float  #: meters in the grid's frame; also y
    y: float
    blocked: float  #: meters of path up to the obstacle that blocks it; infinite if none does
    left: float  #: meters of path to the goal, weighted by cost
    direct: bool  #: whether it is the goal itself, without a detour
    end: tuple[float, float]  #: x, y of the path's end: the goal, or a point at the window's edge
    bend: bool = False  #: whether there is room to arrive with the goal's heading


def behind(goal: Pose, here: Pose) -> tuple[float, float] | None:
    """Return the point, x and y, back from a goal along its heading; a robot that aims at it arrives with that heading.

    None if the robot is too far away, or the goal's heading is NaN or differs too much from the direction to the goal.
    """
    away, toward = here.distance(goal), math.atan2(goal.y - here.y, goal.x - here.x)
    if not (away < _BEND_FROM and abs(wrapped(goal.theta - toward)) < _BEND_MOST):
        return None
    length = _BEND * away
    return goal.x - length * math.cos(goal.theta), goal.y - length * math.sin(goal.theta)


def aim(
    grid: LocalGrid,
    now: float,
    here: Pose,
    to: Pose,
    radius: float,
    before: Aim | None = None,
    narrow: Pose | None = None,
    *,
    leave: bool = False,
) -> Aim:
    """Follow the potential field from one pose to another in the grid's frame; radius in meters, time in seconds.

    If the goal is outside the window, the path leaves the window near the end of the previous path (``before``), unless
    another exit is clearly better. Around the place ``narrow``, the path keeps more room. With ``leave``, a robot next
    to an obstacle first leaves it.
    """
    states, goal = grid.states(now), (to.x, to.y)
    distances = distance_transform(states == OCCUPIED)
    if narrow is not None:
        distances -= _more_room(grid, narrow)
    row, column = (min(max(round(at), 0), SIDE - 1) for at in grid.cell(here.x, here.y))
    path = descend(
        distances, states == UNKNOWN, (row, column), grid.cell(*goal),
        grid.cell(*before.end) if before else None, radius / RESOLUTION, INFLUENCE / RESOLUTION, _SPARE / RESOLUTION,
        leave=leave,
    )  # fmt: skip
    if path.direct or not len(path.cells):
        bend = behind(to, here)
        room = bend is not None and _is_free(grid, distances, [here[:2], bend, goal], radius + _SPARE)
        return Aim(*goal, math.inf, path.cost * RESOLUTION, True, goal, room)
    end, free = grid.place(*path.cells[-1]), grid.place(*_last_free(path))
    left = math.dist(goal, (here.x, here.y))
    nearer = left - math.dist(goal, free)
    if nearer < (-_AWAY if math.isinf(path.blocked) else _WORTH * path.blocked * RESOLUTION):
        return Aim(*goal, 0.0, left, False, goal)  # wait for a person in a corridor instead of leaving it
    at_goal = path.aim == len(path.cells) - 1 and _near(grid, goal, path.cells[-1])
    target = goal if at_goal else grid.place(*path.cells[path.aim])
    return Aim(*target, path.blocked * RESOLUTION, path.cost * RESOLUTION, False, end)


def _more_room(grid: LocalGrid, narrow: Pose) -> NDArray[np.float32]:
    """Return by how much cells around a place count as nearer to obstacles, (rows, columns), in cells."""
    row, column = grid.cell(narrow.x, narrow.y)
    rows, columns = np.ogrid[:SIDE, :SIDE]
    around = np.hypot(rows - row, columns - column) * RESOLUTION < _AROUND
    return np.where(around, np.float32(_ROOM / RESOLUTION), np.float32(0.0))


def _is_free(
    grid: LocalGrid, distances: NDArray[np.float32], corners: Sequence[tuple[float, float]], least: float
) -> bool:
    """Return whether lines between corners in the window stay at least ``least`` meters from obstacles."""
    for begin, end in pairwise(corners):
        shares = np.linspace(0.0, 1.0, 2 + math.ceil(math.dist(begin, end) / RESOLUTION))[:, None]
        places = np.array(begin) + (np.array(end) - begin) * shares - grid.origin
        columns, rows = np.clip(np.floor(places / RESOLUTION).astype(np.int64), 0, SIDE - 1).T
        if (distances[rows, columns] * RESOLUTION < least).any():
            return False
    return True


def _last_free(path: Descent) -> tuple[int, int]:
    """Return the last cell of a path before the obstacle."""
    steps = np.hypot(*np.diff(path.cells, axis=0).T)
    place = int(np.searchsorted(np.cumsum(steps), path.blocked - 0.5))
    return int(path.cells[place, 0]), int(path.cells[place, 1])


def _near(grid: LocalGrid, goal: tuple[float, float], cell: tuple[int, int]) -> bool:
    x, y = grid.place(*cell)
    return math.hypot(goal[0] - x, goal[1] - y) <= RESOLUTION


def drive(
    settings: RobotGotoSection,  # the robot's
    limits: GoalLimits,  # the goal's
    distance: float,  # to the goal, meters
    beta: float,  # the direction to drive in, from the robot's front, radians
    aside: float,  # distance to the nearest obstacle at the robot's side, meters
    ramp: float,  # share of the speed, after an obstacle has moved away
    *,
    through: bool,  # whether the goal is passed without a stop
) -> DriveCommand:
    """Return the command by the control law far from the goal."""
    most = math.radians(settings.max_beta_angle)
    faced = abs(beta) < most
    share = 1.0 if faced else 0.0
    if limits.avoid:
        wide = max(most, _WIDE)
        if not faced and abs(beta) < wide:
            share = (wide - abs(beta)) / max(wide - most, 1e-6)
        share *= 1.0 - side_slowdown(settings, aside)
    gain = limits.max_lin if through else limits.lin_gain * distance
    braking = math.inf if through else math.sqrt(settings.max_lin_acc * distance)
    speed = max(limits.speed(min(gain, braking)) * share * ramp, limits.min_lin) if share else 0.0
    turn = limits.turn(limits.ang_gain * beta) if abs(beta) > 1e-3 else 0.0
    if settings.robot_is_holonomic:
        return DriveCommand(speed * math.cos(beta), speed * math.sin(beta), turn)
    return DriveCommand(speed, 0.0, turn)


def side_slowdown(settings: RobotGotoSection, aside: float) -> float:
    """Return the share of its speed that the robot drops next to obstacles; upstream defines it but does not use it."""
    weight = max(0.0, 1.0 - aside / INFLUENCE) / 2.0
    return min(2.2 * weight, settings.speed_reduction_factor)


def people_speed(settings: RobotGotoSection, gap: float) -> float:
    """Return the speed from which the robot can stop before a person, at a distance ``gap``, reaches it at 1 m/s."""
    walking, reaction, braking = 1.0, settings.reaction, settings.max_lin_acc
    left = gap - walking * reaction
    if left <= 0.0:
        return 0.0
    half = reaction + walking / braking
    return braking * (math.sqrt(half * half + 2.0 * left / braking) - half)
