"""A way to a place on one map, as waypoints with what holds on the way to each."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from navigation.algorithms.astar import Cells, Weights, astar
from navigation.algorithms.shortcut import sees, shortcut
from navigation.constraints import Constraints
from navigation.plan_error import PlanError
from navigation.pose import Pose, wrapped
from navigation.robot_path_planner.escape import escape
from navigation.robot_path_planner.ground import Cell, Ground
from navigation.robot_path_planner.lines import Places, length, sampled
from navigation.robot_path_planner.settings import Settings
from navigation.status import Fault
from yarp_compat.dev.area_behaviour import AreaBehaviour


@dataclass(frozen=True)
class Waypoint:
    """Where to drive next, and what holds until there.

    Attributes:
        pose: where.
        constraints: what holds.
        waits: whether an area on the way asks to wait for obstacles rather than to look for another way.
    """

    pose: Pose
    constraints: Constraints
    waits: bool = False

    def is_passed(self, pose: Pose) -> bool:
        """Whether a robot is so near that the next one may be sent."""
        return pose.distance(self.pose) <= (self.constraints.tolerance_lin or 0.1)

    def is_there(self, pose: Pose) -> bool:
        """Whether a robot stands at it, heading as it should."""
        near, turn = self.constraints.tolerance_lin or 0.0, math.radians(self.constraints.tolerance_ang or 0.0)
        turned = not self.constraints.heading or abs(wrapped(pose.theta - self.pose.theta)) <= turn
        return pose.distance(self.pose) <= near and turned


@dataclass(frozen=True, eq=False)
class Way:
    """A way that was found.

    Attributes:
        waypoints: from the first after the start to the goal.
        length: metres.
        note: what people should know of it, as that it begins where robots are kept out; often empty.
    """

    waypoints: tuple[Waypoint, ...]
    length: float
    note: str = ""


def way(
    ground: Ground,
    start: Pose,
    goal: Pose,
    settings: Settings,
    wanted: Constraints | None = None,
    weights: Weights | None = None,
) -> Way:
    """A way over a map.

    Args:
        ground: the map.
        start: where the robot is.
        goal: where it is to go; theta is NaN where any heading will do.
        settings: what holds for waypoints and the goal.
        wanted: what whoever sent the goal asks for instead.
        weights: the map's with what the laser sees; by default the map's own.

    Raises:
        PlanError: there is none; `PlanError.passing` where the map alone would have one.
    """
    here, there = _ends(ground, start, goal)
    cells = None
    if weights is not None and weights[there]:
        cells = _found(ground, weights, here, there)
    if cells is None and weights is not None:
        _checked(ground, start, goal, ground.weights)
        raise PlanError(Fault.BLOCKED, "what the laser sees closes the way to the goal", passing=True)
    if cells is None:
        weights = ground.weights
        cells = _checked(ground, start, goal, weights)
    assert weights is not None
    out, on = cells
    places = np.concatenate((_places(ground, out), _joined(ground, weights, on, settings)))
    note = ""
    if len(out):
        reason = ground.reason(here) or "beside what the laser sees"
        note = f"the robot stands {reason}; it leaves by the shortest way"
    places = np.concatenate(([(start.x, start.y)], places[1:-1], [(goal.x, goal.y)]))
    made = _waypoints(ground, places, goal, settings, wanted or Constraints())
    return Way(made, length(places), note)


def _ends(ground: Ground, start: Pose, goal: Pose) -> tuple[Cell, Cell]:
    there = ground.cell(goal.x, goal.y)
    if there is None:
        raise PlanError(Fault.OFF_THE_MAP, f"the goal ({goal.x:.2f}, {goal.y:.2f}) is off the map {ground.name}")
    here = ground.cell(start.x, start.y)
    if here is None:
        raise PlanError(Fault.OFF_THE_MAP, f"the robot at ({start.x:.2f}, {start.y:.2f}) is off the map {ground.name}")
    return here, there


def _checked(ground: Ground, start: Pose, goal: Pose, weights: Weights) -> tuple[Cells, Cells]:
    """The way over the map alone; raises `PlanError` with why there is none."""
    here, there = _ends(ground, start, goal)
    if not ground.fits(there):
        raise PlanError(
            Fault.GOAL_OCCUPIED, f"the goal ({goal.x:.2f}, {goal.y:.2f}) lies {ground.reason(there)}; choose another"
        )
    cells = _found(ground, weights, here, there)
    if cells is not None:
        return cells
    if escape(ground.weights, ground.solid, here) is None:
        raise PlanError(
            Fault.START_OCCUPIED,
            f"the robot stands {ground.reason(here)}, and there is no way out; is its localisation right?",
        )
    raise PlanError(Fault.NO_PATH, f"no way leads from ({start.x:.2f}, {start.y:.2f}) to ({goal.x:.2f}, {goal.y:.2f})")


def _found(ground: Ground, weights: Weights, here: Cell, there: Cell) -> tuple[Cells, Cells] | None:
    """The cells on which the robot leaves where it should not be, and those of the way on; None where there is none."""
    out = np.empty((0, 2), np.int32)
    if not weights[here]:
        left = escape(weights, ground.solid, here)
        if left is None:
            return None
        out, here = left[:-1], (int(left[-1, 0]), int(left[-1, 1]))
    found = astar(weights, here, there)
    return None if found is None else (out, found.cells)


def _places(ground: Ground, cells: Cells) -> Places:
    """Where a way out begins; the rest of it is straight enough."""
    return ground.places(cells[:1]) if len(cells) else np.empty((0, 2))


def _joined(ground: Ground, weights: Weights, cells: Cells, settings: Settings) -> Places:
    """The places of few waypoints."""
    if settings.shortened:
        cells = shortcut(weights, cells)
    kept = [cells[0]]
    least = settings.min_waypoint_distance / ground.grid.resolution
    for cell, after in pairwise(cells[1:]):
        near = math.dist(kept[-1], cell) < least
        if not (near and sees(weights, (int(kept[-1][0]), int(kept[-1][1])), (int(after[0]), int(after[1])))):
            kept.append(cell)
    if len(cells) > 1:
        kept.append(cells[-1])
    return ground.places(np.array(kept, np.int32))


def _waypoints(
    ground: Ground, places: Places, goal: Pose, settings: Settings, wanted: Constraints
) -> tuple[Waypoint, ...]:
    """Waypoints at all turns, and where an area with a behaviour begins or ends."""
    made: list[Waypoint] = []
    through = replace(wanted, heading=False, through=True, tolerance_lin=None, tolerance_ang=None)
    for one, other in pairwise(places):
        theta = math.atan2(other[1] - one[1], other[0] - one[0])
        for (x, y), behaviour, beside in _parts(ground, one, other):
            constraints = _merged(settings.waypoint, through, behaviour, beside=beside)
            made.append(Waypoint(Pose(float(x), float(y), theta), constraints, behaviour.on_obstacle == "wait"))
    constraints = _merged(settings.goal, wanted, behaviour, beside=beside)
    if not math.isfinite(goal.theta):
        goal, constraints = goal._replace(theta=theta), replace(constraints, heading=False)
    made[-1] = Waypoint(goal, constraints, behaviour.on_obstacle == "wait")
    return tuple(made)


def _parts(ground: Ground, one: Places, other: Places) -> list[tuple[Places, AreaBehaviour, bool]]:
    """The ends of a line's parts in which one behaviour holds, that, and whether robots are kept out nearby."""
    along = sampled(np.stack((one, other)), ground.grid.resolution / 2)
    columns, rows = ground.grid.cells_at(along).T
    high, wide = ground.labels.shape
    at = np.clip(rows, 0, high - 1), np.clip(columns, 0, wide - 1)
    labels, beside = ground.labels[at], ground.beside[at]
    changes = (labels[1:] != labels[:-1]) | (beside[1:] != beside[:-1])
    ends = [*np.flatnonzero(changes), len(along) - 1]
    return [(along[end], ground.behaviours[labels[end]], bool(beside[end])) for end in ends]


def _merged(ours: Constraints, wanted: Constraints, behaviour: AreaBehaviour, *, beside: bool) -> Constraints:
    """What is set, what is wanted instead, and what an area, or keep-out cells nearby, do not let be exceeded."""
    given = {
        name: value
        for name, value in vars(wanted).items()
        if value not in (None, "") and name not in ("heading", "through", "map")
    }
    made = replace(ours, **given, heading=ours.heading and wanted.heading, through=ours.through)
    speeds = [speed for speed in (made.max_lin_speed, behaviour.max_speed) if speed is not None]
    most = min(speeds, default=None)
    least = made.min_lin_speed if most is None or made.min_lin_speed is None else min(made.min_lin_speed, most)
    word = "wait" if beside else behaviour.on_obstacle or made.on_obstacle
    return replace(made, max_lin_speed=most, min_lin_speed=least, on_obstacle=word)
