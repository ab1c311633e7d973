"""What to drive: commands and the goal under way, the way down the potential field, and the law that follows it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bridge.config.sections.planners import RobotGotoSection
from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.potential_field import Descent, descend
from navigation.algorithms.rolling_grid import OCCUPIED, UNKNOWN
from navigation.constraints import Constraints
from navigation.pose import Pose
from navigation.robot_goto.local_grid import RESOLUTION, SIDE, LocalGrid


class DriveCommand(NamedTuple):
    """A velocity in the robot's frame: m/s, m/s, rad/s."""

    vx: float = 0.0
    vy: float = 0.0
    omega: float = 0.0

    @property
    def speed(self) -> float:
        """m/s, whatever the direction."""
        return math.hypot(self.vx, self.vy)

    @property
    def polar(self) -> tuple[float, float, float]:
        """Direction (degrees), speed (m/s) and turn (deg/s), as YARP's ``control:o`` has them."""
        direction = math.degrees(math.atan2(self.vy, self.vx)) if self.speed else 0.0
        return direction, self.speed, math.degrees(self.omega)


STILL = DriveCommand()


@dataclass
class GotoTask:
    """A goal under way."""

    pose: Pose  #: on the map; theta is NaN where any heading will do
    asked: Constraints  #: its constraints
    driven: bool = False  #: whether there was a step in which the robot could drive
    near: bool = False  #: whether it is there, but for the heading
    best: float = math.inf  #: the least that was left of the way, metres; ``best_turn`` of the heading, radians
    best_turn: float = math.inf
    progress_at: float | None = None  #: when that was, seconds; None before the first step

    @property
    def heading(self) -> bool:
        """Whether its heading matters."""
        return self.asked.heading and not self.asked.through and math.isfinite(self.pose.theta)


INFLUENCE = 0.8  # obstacles that are farther off repel not (upstream's ``max_obstacle_distance``), metres
_SPARE = 0.05
_AWAY = 1.0  # metres by which a way out of the window may lead farther from the goal than the robot is; else it waits
_WORTH = 0.5
"""Metres nearer to the goal for each metre up to what blocks a way: where it is less, the robot waits where it is."""

_WIDE = math.radians(60.0)


class GoalLimits(NamedTuple):
    """What holds for one goal: the settings, and what the goal asks for beside them. Metres, radians, seconds."""

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
    def of(cls, settings: RobotGotoSection, asked: Constraints) -> GoalLimits:
        """The limits of a goal; none lets the robot go faster than its settings do."""

        def chosen(value: float | None, own: float) -> float:
            return own if value is None else value

        max_lin = min(chosen(asked.max_lin_speed, settings.max_lin_speed), settings.max_lin_speed)
        max_ang = min(chosen(asked.max_ang_speed, settings.max_ang_speed), settings.max_ang_speed)
        return cls(
            max_lin,
            min(chosen(asked.min_lin_speed, settings.min_lin_speed), max_lin),
            math.radians(max_ang),
            math.radians(min(chosen(asked.min_ang_speed, settings.min_ang_speed), max_ang)),
            chosen(asked.lin_speed_gain, settings.lin_speed_gain),
            chosen(asked.ang_speed_gain, settings.ang_speed_gain),
            chosen(asked.tolerance_lin, settings.goal_tolerance_lin),
            math.radians(chosen(asked.tolerance_ang, settings.goal_tolerance_ang)),
            asked.on_obstacle == "around" or (not asked.on_obstacle and settings.enable_obstacles_avoidance),
            asked.on_obstacle == "wait" or settings.enable_obstacles_emergency_stop,
        )

    def speed(self, value: float) -> float:
        """A speed within least and most; none stays none."""
        return clipped(value, self.min_lin, self.max_lin)

    def turn(self, value: float) -> float:
        """The same of turning."""
        return clipped(value, self.min_ang, self.max_ang)


def clipped(value: float, least: float, most: float) -> float:
    """A value whose size is within two bounds; 0 stays 0."""
    return math.copysign(min(most, max(least, abs(value))), value) if value else 0.0


class Aim(NamedTuple):
    """Where to drive to next."""

    x: float  #: metres, in the grid's frame; also y
    y: float
    blocked: float  #: metres along the way to what blocks it; infinite where nothing does
    left: float  #: metres of way to the goal, dear places counting for more
    direct: bool  #: whether it is the goal itself, in a straight line
    end: tuple[float, float]  #: where the way ends: x, y; the goal, or where it leaves the window


def aim(
    grid: LocalGrid, now: float, here: Pose, goal: tuple[float, float], radius: float, before: Aim | None = None
) -> Aim:
    """Where the potential field leads, for a robot of some radius (metres) at a pose in the grid's frame; seconds.

    A way that is but a little shorter than the one ``before`` does not take its place.
    """
    states = grid.states(now)
    distances = distance_transform(states == OCCUPIED)
    row, column = (min(max(round(at), 0), SIDE - 1) for at in grid.cell(here.x, here.y))
    way = descend(
        distances, states == UNKNOWN, (row, column), grid.cell(*goal),
        grid.cell(*before.end) if before else None, radius / RESOLUTION, INFLUENCE / RESOLUTION, _SPARE / RESOLUTION,
    )  # fmt: skip
    if way.direct or not len(way.cells):
        return Aim(*goal, math.inf, way.cost * RESOLUTION, True, goal)
    end, free = grid.place(*way.cells[-1]), grid.place(*_last_free(way))
    left = math.dist(goal, (here.x, here.y))
    nearer = left - math.dist(goal, free)
    if nearer < (-_AWAY if math.isinf(way.blocked) else _WORTH * way.blocked * RESOLUTION):
        return Aim(*goal, 0.0, left, False, goal)  # somebody in a corridor: no reason to flee out of it
    to = goal if way.aim == len(way.cells) - 1 and _near(grid, goal, way.cells[-1]) else grid.place(*way.cells[way.aim])
    return Aim(*to, way.blocked * RESOLUTION, way.cost * RESOLUTION, False, end)


def _last_free(way: Descent) -> tuple[int, int]:
    """The last cell of a way before what blocks it."""
    steps = np.hypot(*np.diff(way.cells, axis=0).T)
    place = int(np.searchsorted(np.cumsum(steps), way.blocked - 0.5))
    return int(way.cells[place, 0]), int(way.cells[place, 1])


def _near(grid: LocalGrid, goal: tuple[float, float], cell: tuple[int, int]) -> bool:
    x, y = grid.place(*cell)
    return math.hypot(goal[0] - x, goal[1] - y) <= RESOLUTION


def drive(
    settings: RobotGotoSection,  # the robot's
    limits: GoalLimits,  # the goal's
    distance: float,  # to the goal, metres
    beta: float,  # the direction to drive in, as seen from the front, radians
    aside: float,  # to the nearest obstacle beside the robot, metres
    ramp: float,  # share of the speed, after something made way
    *,
    through: bool,  # whether the goal is passed without a stop
) -> DriveCommand:
    """The law of the far phase."""
    most = math.radians(settings.max_beta_angle)
    faced = abs(beta) < most
    share = 1.0 if faced else 0.0
    if limits.avoid:
        wide = max(most, _WIDE)
        if not faced and abs(beta) < wide:
            share = (wide - abs(beta)) / max(wide - most, 1e-6)
        share *= 1.0 - beside(settings, aside)
    gain = limits.max_lin if through else limits.lin_gain * distance
    braking = math.inf if through else math.sqrt(settings.max_lin_acc * distance)
    speed = max(limits.speed(min(gain, braking)) * share * ramp, limits.min_lin) if share else 0.0
    turn = limits.turn(limits.ang_gain * beta) if abs(beta) > 1e-3 else 0.0
    if settings.robot_is_holonomic:
        return DriveCommand(speed * math.cos(beta), speed * math.sin(beta), turn)
    return DriveCommand(speed, 0.0, turn)


def beside(settings: RobotGotoSection, aside: float) -> float:
    """The share of its speed that the robot takes back for what is beside it: upstream's law, which it leaves out."""
    weight = max(0.0, 1.0 - aside / INFLUENCE) / 2.0
    return min(2.2 * weight, settings.speed_reduction_factor)


def people_speed(settings: RobotGotoSection, gap: float) -> float:
    """The speed from which the robot can stop before a person who comes from so many metres away arrives."""
    walking, reaction, braking = 1.0, settings.reaction, settings.max_lin_acc
    left = gap - walking * reaction
    if left <= 0.0:
        return 0.0
    half = reaction + walking / braking
    return braking * (math.sqrt(half * half + 2.0 * left / braking) - half)
