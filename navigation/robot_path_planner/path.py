"""Paths on one map as waypoints, each with its constraints, and the state of the active goal."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.astar import Cells, Weights, astar
from navigation.algorithms.shortcut import sees, shortcut
from navigation.constraints import Constraints
from navigation.goals import MapPlace
from navigation.pose import Pose, wrapped
from navigation.robot_path_planner.atlas import Leg
from navigation.robot_path_planner.ground import Cell, Clutter, Ground
from navigation.robot_path_planner.section import RobotPathPlannerSection
from navigation.status import Fault, PlanError
from yarp_compat.dev.extras import AreaBehavior

Places = NDArray[np.float64]  # (n, 2) x and y, meters


def blocked(ground: Ground, closed: NDArray[np.bool_], places: Places, *, inside: bool = False) -> bool:
    """Whether a line through points, (n, 2) meters, enters closed cells or, with ``inside``, begins in them."""
    columns, rows = ground.grid.cells_at(sample_line(places, ground.grid.resolution / 2)).T
    fits = (rows >= 0) & (rows < closed.shape[0]) & (columns >= 0) & (columns < closed.shape[1])
    on_line = closed[rows[fits], columns[fits]]
    if inside:
        return bool(on_line.any())
    free = np.flatnonzero(~on_line)
    return bool(len(free)) and bool(on_line[free[0] :].any())


def sample_line(places: Places, step: float) -> Places:
    """Return points along a line, at most one step apart."""
    parts = [places[:1]]
    for start, end in pairwise(places):
        count = max(math.ceil(math.dist(start, end) / step), 1)
        parts.append(start + (end - start) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(parts)


def is_straight(ground: Ground, first: Pose, second: Pose) -> bool:
    """Whether no wall is between two poses.

    Always true from a forbidden cell, which the robot is leaving, and if a pose is outside the map.
    """
    start, end = ground.cell(first.x, first.y), ground.cell(second.x, second.y)
    return start is None or end is None or not ground.open[start] or sees(ground.open, start, end)


def fits_straight(ground: Ground, clutter: Clutter, first: Pose, second: Pose) -> bool:
    """Whether a robot fits on the line between two poses with a cell to spare.

    The line must be free of obstacles, and must not cross the border of an area with a behavior or near keep-out areas.
    A robot that is too close to an obstacle must have left it after its radius; otherwise the line leads through it.
    """
    start, end = ground.cell(first.x, first.y), ground.cell(second.x, second.y)
    if start is None or end is None or not ground.spare[start] or not sees(ground.spare, start, end):
        return False
    line, closed = np.array([first[:2], second[:2]]), clutter.closed()
    beyond = line[0] + (line[1] - line[0]) * min(1.0, ground.radius / max(first.distance(second), 1e-6))
    if blocked(ground, closed, line) or blocked(ground, closed, np.stack((beyond, line[1])), inside=True):
        return False
    return len(_parts(ground, *line)) == 1


def length(places: Places) -> float:
    """Return the length of a line, meters."""
    return float(np.hypot(*np.diff(places, axis=0).T).sum())


def cut(places: Places, meters: float) -> Places:
    """Return the first meters of a line."""
    steps = np.hypot(*np.diff(places, axis=0).T)
    whole = np.concatenate(([0.0], np.cumsum(steps)))
    if whole[-1] <= meters:
        return places
    number = int(np.searchsorted(whole, meters))
    share = (meters - whole[number - 1]) / steps[number - 1]
    end = places[number - 1] + share * (places[number] - places[number - 1])
    return np.concatenate((places[:number], [end]))


_STUCK = 2  # walls within this many cells of the start may be crossed: localization is not more accurate
_STEPS = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]


def escape(weights: Weights, solid: NDArray[np.bool_], start: Cell) -> Cells | None:
    """Return the shortest path from a forbidden cell to an allowed one, (n, 2) cells with the start, or None.

    ``weights`` are 0 in forbidden cells; ``solid`` cells cannot be crossed at all; both are (rows, columns).
    """
    rows, columns = weights.shape
    lengths, previous = {start: 0.0}, {start: start}
    waiting = [(0.0, start)]
    while waiting:
        length, cell = heapq.heappop(waiting)
        if length > lengths[cell]:
            continue
        if weights[cell]:
            return _trace_back(previous, cell)
        for row, column in _STEPS:
            other = cell[0] + row, cell[1] + column
            if not (0 <= other[0] < rows and 0 <= other[1] < columns):
                continue
            near = max(abs(other[0] - start[0]), abs(other[1] - start[1])) <= _STUCK
            cost = length + math.hypot(row, column)
            if (near or not solid[other]) and cost < lengths.get(other, math.inf):
                lengths[other], previous[other] = cost, cell
                heapq.heappush(waiting, (cost, other))
    return None


def _trace_back(previous: dict[Cell, Cell], cell: Cell) -> Cells:
    path = [cell]
    while previous[cell] != cell:
        cell = previous[cell]
        path.append(cell)
    return np.array(path[::-1], np.int32)


@dataclass(frozen=True)
class Waypoint:
    """A waypoint, and the constraints on the path to it."""

    pose: Pose
    constraints: Constraints
    waits_for_obstacles: bool = False  #: an area on the path to it asks to wait for obstacles instead of replanning

    def is_passed(self, pose: Pose) -> bool:
        """Whether a robot is near enough for the next waypoint to be sent."""
        return pose.distance(self.pose) <= (self.constraints.tolerance_lin or 0.1)

    def has_limits_of(self, other: Waypoint) -> bool:
        """Whether speed limits, behavior at obstacles and nearby keep-out areas are the same for another waypoint."""
        own, its = self.constraints, other.constraints
        return (own.max_lin_speed, own.min_lin_speed, own.on_obstacle, own.beside_keep_out) == (
            its.max_lin_speed,
            its.min_lin_speed,
            its.on_obstacle,
            its.beside_keep_out,
        )

    def is_reached(self, pose: Pose) -> bool:
        """Whether a robot is at the waypoint, with its heading if that matters."""
        near, turn = self.constraints.tolerance_lin or 0.0, math.radians(self.constraints.tolerance_ang or 0.0)
        turned = not self.constraints.heading or abs(wrapped(pose.theta - self.pose.theta)) <= turn
        return pose.distance(self.pose) <= near and turned


@dataclass(frozen=True, eq=False)
class PlannedPath:
    """A path that the planner found."""

    waypoints: tuple[Waypoint, ...]  #: the waypoints from the first after the start to the goal
    length: float  #: meters
    note: str = ""  #: for people, for example that the path starts in a keep-out area; often empty


def plan_path(
    ground: Ground,  # the map
    start: Pose,  # the robot's pose
    goal: Pose,  # theta is NaN if the heading does not matter
    settings: RobotPathPlannerSection,  # constraints of waypoints and goal
    wanted: Constraints | None = None,  # the client's constraints, which override the settings
    weights: Weights | None = None,  # the map's weights with obstacles; by default the map's own
) -> PlannedPath:
    """Plan a path on a map; raises `PlanError` if every path is blocked, with ``passing`` if only by obstacles."""
    start_cell, goal_cell = _ends(ground, start, goal)
    cells = None
    if weights is not None and weights[goal_cell]:
        cells = _search(ground, weights, start_cell, goal_cell)
    if cells is None and weights is not None:
        _path_on_map(ground, start, goal, ground.weights)
        raise PlanError(Fault.BLOCKED, "obstacles of the laser or a layer block every path to the goal", passing=True)
    if cells is None:
        weights = ground.weights
        cells = _path_on_map(ground, start, goal, weights)
    assert weights is not None
    exit_cells, path_cells = cells
    places = np.concatenate((_exit_start(ground, exit_cells), _simplify(ground, weights, path_cells, settings)))
    note = ""
    if len(exit_cells):
        reason = ground.reason(start_cell) or "too close to the laser's obstacles"
        note = f"the robot is {reason}; it leaves by the shortest path"
    places = np.concatenate(([(start.x, start.y)], places[1:-1], [(goal.x, goal.y)]))
    waypoints = _waypoints(ground, places, goal, settings, wanted or Constraints())
    return PlannedPath(waypoints, length(places), note)


def passing(path: PlannedPath, settings: RobotPathPlannerSection) -> PlannedPath:
    """Return a path whose end the robot passes without a stop, with any heading."""
    end = path.waypoints[-1]
    near = settings.waypoint.tolerance_lin
    constraints = replace(end.constraints, heading=False, through=True, tolerance_lin=near)
    return replace(path, waypoints=(*path.waypoints[:-1], replace(end, constraints=constraints)))


def _ends(ground: Ground, start: Pose, goal: Pose) -> tuple[Cell, Cell]:
    goal_cell = ground.cell(goal.x, goal.y)
    if goal_cell is None:
        raise PlanError(Fault.OFF_THE_MAP, f"the goal ({goal.x:.2f}, {goal.y:.2f}) is outside the map {ground.name}")
    start_cell = ground.cell(start.x, start.y)
    if start_cell is None:
        raise PlanError(
            Fault.OFF_THE_MAP, f"the robot at ({start.x:.2f}, {start.y:.2f}) is outside the map {ground.name}"
        )
    return start_cell, goal_cell


def _path_on_map(ground: Ground, start: Pose, goal: Pose, weights: Weights) -> tuple[Cells, Cells]:
    """Return the path on the map without obstacles; raises `PlanError` with the reason if every path is blocked."""
    start_cell, goal_cell = _ends(ground, start, goal)
    if not ground.fits(goal_cell):
        raise PlanError(
            Fault.GOAL_OCCUPIED, f"the goal ({goal.x:.2f}, {goal.y:.2f}) is {ground.reason(goal_cell)}; choose another"
        )
    cells = _search(ground, weights, start_cell, goal_cell)
    if cells is not None:
        return cells
    if escape(ground.weights, ground.solid, start_cell) is None:
        raise PlanError(
            Fault.START_OCCUPIED,
            f"the robot is {ground.reason(start_cell)} and cannot get out; check its localization",
        )
    raise PlanError(Fault.NO_PATH, f"no path from ({start.x:.2f}, {start.y:.2f}) to ({goal.x:.2f}, {goal.y:.2f})")


def _search(ground: Ground, weights: Weights, start_cell: Cell, goal_cell: Cell) -> tuple[Cells, Cells] | None:
    """Return the cells that lead out of a forbidden start, and the path's cells from there; None without a path."""
    exit_cells = np.empty((0, 2), np.int32)
    if not weights[start_cell]:
        exit_path = escape(weights, ground.solid, start_cell)
        if exit_path is None:
            return None
        exit_cells, start_cell = exit_path[:-1], (int(exit_path[-1, 0]), int(exit_path[-1, 1]))
    path = astar(weights, start_cell, goal_cell)
    return None if path is None else (exit_cells, path.cells)


def _exit_start(ground: Ground, cells: Cells) -> Places:
    """Return the first point of a path out of a forbidden cell; the rest is left out, as it is nearly straight."""
    return ground.places(cells[:1]) if len(cells) else np.empty((0, 2))


def _simplify(ground: Ground, weights: Weights, cells: Cells, settings: RobotPathPlannerSection) -> Places:
    """Return the points of a path with few corners."""
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
    """Return waypoints at all corners, and at the borders of areas with a behavior or near keep-out areas."""
    waypoints: list[Waypoint] = []
    to_waypoint = Constraints(**settings.waypoint.model_dump(), heading=False, through=True)
    through = replace(wanted, heading=False, through=True, tolerance_lin=None, tolerance_ang=None)
    for begin, end in pairwise(places):
        theta = math.atan2(end[1] - begin[1], end[0] - begin[0])
        for (x, y), behavior, near in _parts(ground, begin, end):
            beside = (ground.name or "?") if near else ""
            constraints = _merge(to_waypoint, through, behavior, beside=beside)
            waypoints.append(Waypoint(Pose(float(x), float(y), theta), constraints, behavior.on_obstacle == "wait"))
    constraints = _merge(Constraints(**settings.goal.model_dump()), wanted, behavior, beside=beside)
    if not math.isfinite(goal.theta):
        goal, constraints = goal._replace(theta=theta), replace(constraints, heading=False)
    waypoints[-1] = Waypoint(goal, constraints, behavior.on_obstacle == "wait")
    return tuple(waypoints)


def _parts(ground: Ground, begin: Places, far_end: Places) -> list[tuple[Places, AreaBehavior, bool]]:
    """Split a line at the borders of areas: each part's end, behavior, and whether the end is near a keep-out area."""
    along = sample_line(np.stack((begin, far_end)), ground.grid.resolution / 2)
    columns, rows = ground.grid.cells_at(along).T
    high, wide = ground.labels.shape
    at = np.clip(rows, 0, high - 1), np.clip(columns, 0, wide - 1)
    labels, beside = ground.labels[at], ground.beside[at]
    changes = (labels[1:] != labels[:-1]) | (beside[1:] != beside[:-1])
    ends = [*np.flatnonzero(changes), len(along) - 1]
    return [(along[end], ground.behaviors[labels[end]], bool(beside[end])) for end in ends]


def _merge(defaults: Constraints, wanted: Constraints, behavior: AreaBehavior, *, beside: str) -> Constraints:
    """Return the settings, overridden by the goal's constraints, and limited by areas.

    ``beside`` is the map's name if its keep-out cells are near.
    """
    given = {
        name: value
        for name, value in vars(wanted).items()
        if value not in (None, "") and name not in ("heading", "through", "map")
    }
    merged = replace(defaults, **given, heading=defaults.heading and wanted.heading, through=defaults.through)
    speeds = [speed for speed in (merged.max_lin_speed, behavior.max_speed) if speed is not None]
    most = min(speeds, default=None)
    least = merged.min_lin_speed
    if most is not None and least is not None:
        least = min(least, most)
    on_obstacle = behavior.on_obstacle or merged.on_obstacle
    beside = beside or merged.beside_keep_out
    return replace(merged, max_lin_speed=most, min_lin_speed=least, on_obstacle=on_obstacle, beside_keep_out=beside)


_ELSEWHERE = 0.1  # meters from a place at which a robot counts as elsewhere
_CORNER = 0.4  # meters from a waypoint within which the robot may cut the corner


@dataclass
class DriveTask:
    """An active goal and its progress. Times are in seconds of the caller's clock."""

    goal: MapPlace
    constraints: Constraints  #: the client's constraints
    since: float  #: when the goal arrived
    further: tuple[MapPlace, ...] = ()  #: the goals after this one, in sequence
    passed: int = 0  #: the number of goals before this one
    replan_reason: str = "a new goal"  #: why a path has to be planned; empty if the path is valid
    not_before: float = -math.inf  #: when planning may be tried next
    leg: Leg | None = None  #: the part on the current map
    waypoints: tuple[Waypoint, ...] = field(default=())  #: the waypoints of the current path
    index: int = 0  #: the index of the current waypoint
    note: str = ""  #: a note on the path, for people
    attempts: int = 0  #: new plans after an obstacle or a failure, since the robot last came nearer
    recoveries: int = 0  #: the same in total
    best: float = math.inf  #: the meters that remained when the robot last came nearer
    driven: bool = False  #: whether a local navigator has been available
    navigator_lost_since: float | None = None  #: since when the local navigator is missing
    pose_lost_since: float | None = None  #: since when the robot's pose is unknown
    layer_silent_since: float | None = None  #: since when the robot waits for a silent layer
    all_blocked_since: float | None = None  #: since when obstacles block every path
    path_blocked_since: float | None = None  #: since when an obstacle is on the current path
    arrived_at: float | None = None  #: when the robot reached the link at the leg's end
    beside_wall: Pose | None = None  #: where the robot last waited with a wall next to its line to the waypoint

    def set_map(self, map_name: str) -> None:
        """Set the map of the goals that were given without one."""
        goals = (self.goal, *self.further)
        self.goal, *further = (replace(goal, map_name=goal.map_name or map_name) for goal in goals)
        self.further = tuple(further)

    def numbered(self, reason: str) -> str:
        """Return a reason with the number of the current goal, if there are several."""
        total = self.passed + 1 + len(self.further)
        return f"place {self.passed + 1} of {total}: {reason}" if total > 1 else reason

    @property
    def waypoint(self) -> Waypoint:
        """The waypoint that the robot drives to."""
        return self.waypoints[self.index]

    def line(self, pose: Pose | None) -> Places:
        """Return the remaining waypoints, (n, 2), after the robot's position if it is known."""
        line = [(waypoint.pose.x, waypoint.pose.y) for waypoint in self.waypoints[self.index :]]
        if pose is not None:
            line.insert(0, pose[:2])
        return np.array(line)

    def passes_wall(self, ground: Ground, pose: Pose) -> bool:
        """Whether the robot, which has left the path, does not fit on the line to its waypoint.

        Returns True only once at each place.
        """
        if self.beside_wall is not None and self.beside_wall.distance(pose) < _ELSEWHERE:
            return False
        if not blocked(ground, ground.weights == 0, self.line(pose)[:2], inside=True):
            return False
        self.beside_wall = pose
        return True

    @property
    def passes(self) -> bool:
        """Whether the robot passes the current goal without a stop and drives on to the next one."""
        return bool(self.further) and self.leg is not None and self.leg.onto is None

    def can_skip(self, ground: Ground, clutter: Clutter, pose: Pose, *, waits: bool) -> bool:
        """Whether to skip this waypoint, because it is near or blocked, and drive straight to the next one.

        ``waits`` is whether the robot waits for an obstacle. The line to the next waypoint must be free, and have the
        same limits.
        """
        if self.last or self.waypoint.waits_for_obstacles:
            return False
        after = self.waypoints[self.index + 1]
        return (
            (waits or pose.distance(self.waypoint.pose) < _CORNER)
            and self.waypoint.has_limits_of(after)
            and fits_straight(ground, clutter, pose, after.pose)
        )

    @property
    def last(self) -> bool:
        """Whether the current waypoint is the last waypoint."""
        return self.index == len(self.waypoints) - 1


_TURNED = math.radians(30.0)
_FRESH = 1.0  # poses that are further apart in time than this (seconds) are not compared


class JumpDetector:
    """Compares each pose with the previous one."""

    def __init__(self) -> None:
        self.pose: Pose | None = None  # the last pose; None before the first
        self._at = -math.inf

    def add(self, now: float, pose: Pose, least: float) -> str:
        """Add a pose on the map; return a text about a jump, else "".

        A jump is more than `least` meters or 30 degrees beyond what a robot moves at 1 m/s or turns at 180 degrees/s.
        """
        before, passed = self.pose, now - self._at
        self.pose, self._at = pose, now
        if before is None or not 0 <= passed < _FRESH:
            return ""
        moved, turned = pose.distance(before), abs(wrapped(pose.theta - before.theta))
        if moved > least + passed or turned > _TURNED + math.pi * passed:
            return f"localization jumped by {moved:.2f} m and {math.degrees(turned):.0f} degrees"
        return ""
