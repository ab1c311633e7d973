"""A way to a place on one map, as waypoints with what holds on the way to each, and the goal that is driven to so."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bridge.config.sections.planners import RobotPathPlannerSection
from navigation.algorithms.astar import Cells, Weights, astar
from navigation.algorithms.shortcut import sees, shortcut
from navigation.constraints import Constraints
from navigation.goals import MapPlace
from navigation.pose import Pose, wrapped
from navigation.robot_path_planner.atlas import Leg
from navigation.robot_path_planner.ground import Cell, Ground
from navigation.status import Fault, PlanError
from yarp_compat.dev.extras import AreaBehaviour

Places = NDArray[np.float64]  # (n, 2) x and y, metres


def blocked(ground: Ground, closed: NDArray[np.bool_], places: Places) -> bool:
    """Whether a line over places, (n, 2) metres, comes through closed cells; those that it begins in do not count."""
    columns, rows = ground.grid.cells_at(sampled(places, ground.grid.resolution / 2)).T
    fits = (rows >= 0) & (rows < closed.shape[0]) & (columns >= 0) & (columns < closed.shape[1])
    found = closed[rows[fits], columns[fits]]
    free = np.flatnonzero(~found)
    return bool(len(free)) and bool(found[free[0] :].any())


def sampled(places: Places, step: float) -> Places:
    """Places along a line, no further apart than a step."""
    made = [places[:1]]
    for one, other in pairwise(places):
        count = max(math.ceil(math.dist(one, other) / step), 1)
        made.append(one + (other - one) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(made)


def is_straight(ground: Ground, one: Pose, other: Pose) -> bool:
    """Whether nothing lies between; one that stands where it should not is on its way out."""
    here, there = ground.cell(one.x, one.y), ground.cell(other.x, other.y)
    return here is None or there is None or not ground.open[here] or sees(ground.open, here, there)


def length(places: Places) -> float:
    """Metres of a line."""
    return float(np.hypot(*np.diff(places, axis=0).T).sum())


def cut(places: Places, metres: float) -> Places:
    """The first metres of a line."""
    steps = np.hypot(*np.diff(places, axis=0).T)
    whole = np.concatenate(([0.0], np.cumsum(steps)))
    if whole[-1] <= metres:
        return places
    number = int(np.searchsorted(whole, metres))
    share = (metres - whole[number - 1]) / steps[number - 1]
    end = places[number - 1] + share * (places[number] - places[number - 1])
    return np.concatenate((places[:number], [end]))


_STUCK = 2  # cells around the start in which walls do not matter: localisation is not better than that
_STEPS = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]


def escape(weights: Weights, solid: NDArray[np.bool_], start: Cell) -> Cells | None:
    """The shortest way from a cell to one where the robot may be: (n, 2) cells from the start on; None without one.

    ``weights`` are 0 where the robot is not to be; ``solid`` cannot be driven through at all; both (rows, columns).
    """
    rows, columns = weights.shape
    lengths, came = {start: 0.0}, {start: start}
    waiting = [(0.0, start)]
    while waiting:
        length, cell = heapq.heappop(waiting)
        if length > lengths[cell]:
            continue
        if weights[cell]:
            return _tracked(came, cell)
        for row, column in _STEPS:
            other = cell[0] + row, cell[1] + column
            if not (0 <= other[0] < rows and 0 <= other[1] < columns):
                continue
            near = max(abs(other[0] - start[0]), abs(other[1] - start[1])) <= _STUCK
            found = length + math.hypot(row, column)
            if (near or not solid[other]) and found < lengths.get(other, math.inf):
                lengths[other], came[other] = found, cell
                heapq.heappush(waiting, (found, other))
    return None


def _tracked(came: dict[Cell, Cell], cell: Cell) -> Cells:
    found = [cell]
    while came[cell] != cell:
        cell = came[cell]
        found.append(cell)
    return np.array(found[::-1], np.int32)


@dataclass(frozen=True)
class Waypoint:
    """Where to drive next, and what holds until there."""

    pose: Pose  #: where
    constraints: Constraints  #: what holds
    waits: bool = False  #: whether an area on the way asks to wait for obstacles rather than to look for another way

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
    """A way that was found."""

    waypoints: tuple[Waypoint, ...]  #: from the first after the start to the goal
    length: float  #: metres
    note: str = ""  #: what people should know of it, as that it begins where robots are kept out; often empty


def way(
    ground: Ground,  # the map
    start: Pose,  # where the robot is
    goal: Pose,  # where it is to go; theta is NaN where any heading will do
    settings: RobotPathPlannerSection,  # what holds for waypoints and the goal
    wanted: Constraints | None = None,  # what whoever sent the goal asks for instead
    weights: Weights | None = None,  # the map's with what the laser sees; by default the map's own
) -> Way:
    """A way over a map; raises `PlanError` if there is none; `PlanError.passing` where the map alone would have one."""
    here, there = _ends(ground, start, goal)
    cells = None
    if weights is not None and weights[there]:
        cells = _found(ground, weights, here, there)
    if cells is None and weights is not None:
        _checked(ground, start, goal, ground.weights)
        raise PlanError(Fault.BLOCKED, "what the laser sees, or a layer, closes the way to the goal", passing=True)
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
    """The way over the map alone; raises `PlanError` with the reason without one."""
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
    """The cells of the way out of a forbidden place, and of the way on; None without a way."""
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


def _joined(ground: Ground, weights: Weights, cells: Cells, settings: RobotPathPlannerSection) -> Places:
    """The places of few waypoints."""
    if settings.use_optimized_path:
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
    ground: Ground, places: Places, goal: Pose, settings: RobotPathPlannerSection, wanted: Constraints
) -> tuple[Waypoint, ...]:
    """Waypoints at all turns, and where an area with a behaviour begins or ends."""
    made: list[Waypoint] = []
    to_waypoint = Constraints(**settings.waypoint.model_dump(), heading=False, through=True)
    through = replace(wanted, heading=False, through=True, tolerance_lin=None, tolerance_ang=None)
    for one, other in pairwise(places):
        theta = math.atan2(other[1] - one[1], other[0] - one[0])
        for (x, y), behaviour, beside in _parts(ground, one, other):
            constraints = _merged(to_waypoint, through, behaviour, beside=beside)
            made.append(Waypoint(Pose(float(x), float(y), theta), constraints, behaviour.on_obstacle == "wait"))
    constraints = _merged(Constraints(**settings.goal.model_dump()), wanted, behaviour, beside=beside)
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
    """The settings, overridden by the goal's wishes, and limited by areas and keep-out cells nearby."""
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


@dataclass
class DriveTask:
    """One goal under way. Times are the caller's seconds."""

    goal: MapPlace  #: where to
    wanted: Constraints  #: what whoever sent it asks for
    since: float  #: when it came
    then: tuple[MapPlace, ...] = ()  #: where to go on to from there, one after the other
    due: str = "a new goal"  #: why a way is to be planned; empty where that is not so
    not_before: float = -math.inf  #: when that is tried next
    leg: Leg | None = None  #: what is driven on the map at hand
    waypoints: tuple[Waypoint, ...] = field(default=())  #: of the way at hand
    at: int = 0  #: the number of the one that is driven to
    note: str = ""  #: what people should know of the way
    attempts: int = 0  #: other ways that were tried since the robot last came nearer
    recoveries: int = 0  #: the same in all
    best: float = math.inf  #: metres to the goal, the least so far
    driven: bool = False  #: whether a local navigator has taken anything
    gone_since: float | None = None  #: since when there is no local navigator
    lost_since: float | None = None  #: since when it is not known where the robot is
    silent_since: float | None = None  #: since when a layer is silent
    blocked_since: float | None = None  #: since when what the laser sees closes every way
    closed_since: float | None = None  #: since when it lies on the way at hand
    arrived: float | None = None  #: when the robot came to the end of the leg, from where it goes on to another map

    def is_on(self, map_name: str) -> None:
        """Its places that were said without a map are on this one."""
        places = (self.goal, *self.then)
        self.goal, *further = (replace(one, map_name=one.map_name or map_name) for one in places)
        self.then = tuple(further)

    @property
    def waypoint(self) -> Waypoint:
        """The one that is driven to."""
        return self.waypoints[self.at]

    @property
    def last(self) -> bool:
        """Whether that is the last one."""
        return self.at == len(self.waypoints) - 1


_TURNED = math.radians(30.0)
_FRESH = 1.0  # seconds after which a pose says nothing of the next


class JumpDetector:
    """Compares each pose with the one before."""

    def __init__(self) -> None:
        self.pose: Pose | None = None  # the last one; None before the first
        self._at = -math.inf

    def add(self, now: float, pose: Pose, least: float) -> str:
        """Take up a pose on the map; a message about a jump (so many metres, or 30 degrees), or nothing. Seconds."""
        before, passed = self.pose, now - self._at
        self.pose, self._at = pose, now
        if before is None or not 0 <= passed < _FRESH:
            return ""
        moved, turned = pose.distance(before), abs(wrapped(pose.theta - before.theta))
        if moved > least + passed or turned > _TURNED + math.pi * passed:
            return f"localisation moved the robot by {moved:.2f} m and {math.degrees(turned):.0f} degrees at once"
        return ""
