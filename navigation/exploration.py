"""Exploration of a floor: which frontier of the growing map to drive to next, and when to end."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.astar import astar
from navigation.algorithms.frontiers import Cells, frontiers, in_sight
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Cell, Ground
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

MOST_FAILURES = 3
"""Goals in a row that may fail before the exploration ends."""

_VIEW = 1.0  # a goal is at most this many meters, plus the robot's radius, from its frontier
_TRIES = 3  # views of a frontier that are tried
_APART = 0.3  # meters between two of these views
_NEAR_VISITED, _NEAR_FAILED = 0.3, 0.5  # meters around earlier goals in which no other goal is sent
_MOST_GROUPS = 200
_MOST_SIZE = 5.0  # meters; larger frontiers do not count more


class NoRoomError(ValueError):
    """The robot is outside the map, or in a cell that is too narrow for it."""


class FrontierGoal(NamedTuple):
    """A goal in view of a frontier.

    Attributes:
        pose: the goal's pose on the map, facing the frontier.
        size: the frontier's size, meters.
        cost: the path's length in meters, multiplied by the planner's cell weights.
    """

    pose: Pose
    size: float
    cost: float


@dataclass
class Exploration:
    """Chooses the goals of one exploration, without a thread or a clock.

    Attributes:
        radius: distance that paths keep from walls, meters.
        clearance: additional distance that paths keep if the space allows, meters.
        sent: the number of goals sent.
        failures: the number of goals in a row that have failed.
    """

    radius: float = 0.3
    clearance: float = 0.2
    sent: int = 0
    failures: int = 0
    _visited: list[Pose] = field(default_factory=list)
    _failed: list[Pose] = field(default_factory=list)

    def choose(self, grid: MapGrid2D, robot: Pose) -> FrontierGoal | None:
        """Return the next goal on the current map; None if no frontier is left that can be reached.

        A meter of frontier is worth a meter of path. Frontiers that the robot does not fit through do not count.
        Raises `NoRoomError` if paths cannot begin at the robot's pose.
        """
        ground = Ground(grid, self.radius, self.clearance)
        start = self._start(ground, robot)
        resolution = ground.grid.resolution
        least = max(1, math.ceil(2.0 * self.radius / resolution))
        free = (ground.grid.flags == MapFlag.FREE) & ~ground.solid
        groups = frontiers(free, ground.grid.flags == MapFlag.UNKNOWN, least)[:_MOST_GROUPS]
        bounds = [_least_distance(start, group) * resolution - self._worth(len(group) * resolution) for group in groups]
        best: FrontierGoal | None = None
        best_rank = math.inf
        for number in np.argsort(bounds, kind="stable"):
            # a view is nearer to the robot than its frontier by at most the distance between the two
            if bounds[number] - self.radius - _VIEW >= best_rank:
                break
            goal = self._goal(ground, free, start, groups[number])
            if goal is not None and goal.cost - self._worth(goal.size) < best_rank:
                best, best_rank = goal, goal.cost - self._worth(goal.size)
        return best

    def begin(self) -> None:
        """Count a goal that is sent."""
        self.sent += 1

    def reached(self, goal: FrontierGoal) -> None:
        """Note that the robot has seen a frontier from a goal, which is not sent again."""
        self._visited.append(goal.pose)
        self.failures = 0

    def failed(self, goal: FrontierGoal) -> None:
        """Note that a goal could not be reached; it and its surroundings are not tried again."""
        self._failed.append(goal.pose)
        self.failures += 1

    @staticmethod
    def _worth(size: float) -> float:
        return min(size, _MOST_SIZE)

    def _start(self, ground: Ground, robot: Pose) -> Cell:
        """Return the robot's cell, or the nearest cell in which the robot fits, at most the robot's radius away."""
        cell = ground.cell(robot.x, robot.y)
        if cell is None:
            raise NoRoomError(f"the robot is outside the map, at {robot.x:.2f}, {robot.y:.2f} m")
        if ground.fits(cell):
            return cell
        reach = math.ceil(self.radius / ground.grid.resolution)
        cells = _window(ground.weights, cell, reach)
        if not len(cells):
            raise NoRoomError(f"the robot, at {robot.x:.2f}, {robot.y:.2f} m, is {ground.reason(cell)}")
        return _cell(cells[np.abs(cells - cell).max(axis=1).argmin()])

    def _goal(self, ground: Ground, free: NDArray[np.bool_], start: Cell, group: Cells) -> FrontierGoal | None:
        """Return a goal in view of a frontier; None if no path leads to one."""
        resolution = ground.grid.resolution
        middle = _cell(group[np.square(group - group.mean(axis=0)).sum(axis=1).argmin()])
        x, y = ground.places(np.array([middle], np.int32))[0]
        for view in self._views(ground, free, middle):
            at_x, at_y = ground.places(np.array([view], np.int32))[0]
            pose = Pose(float(at_x), float(at_y), math.atan2(y - at_y, x - at_x))
            if self._is_done(pose):
                continue
            path = astar(ground.weights, start, view)
            if path is not None:
                return FrontierGoal(pose, len(group) * resolution, path.cost * resolution)
        return None

    def _views(self, ground: Ground, free: NDArray[np.bool_], middle: Cell) -> Iterator[Cell]:
        """Yield cells in which the robot fits and sees a given cell, the nearest one first."""
        resolution = ground.grid.resolution
        cells = _window(ground.weights, middle, math.ceil((self.radius + _VIEW) / resolution))
        cells = cells[in_sight(free, cells, middle)]
        cells = cells[np.argsort(np.square(cells - middle).sum(axis=1), kind="stable")]
        for _ in range(_TRIES):
            if not len(cells):
                return
            yield _cell(cells[0])
            cells = cells[np.hypot(*(cells - cells[0]).T) * resolution > _APART]

    def _is_done(self, pose: Pose) -> bool:
        near_visited = any(pose.distance(other) < _NEAR_VISITED for other in self._visited)
        return near_visited or any(pose.distance(other) < _NEAR_FAILED for other in self._failed)


def _cell(values: NDArray[np.integer]) -> Cell:
    return int(values[0]), int(values[1])


def _window(weights: NDArray[np.uint8], middle: Cell, reach: int) -> Cells:
    """Return the cells with a weight within a number of rows and columns."""
    row, column = max(0, middle[0] - reach), max(0, middle[1] - reach)
    part = weights[row : middle[0] + reach + 1, column : middle[1] + reach + 1]
    cells: Cells = (np.argwhere(part) + np.array((row, column))).astype(np.int32)
    return cells


def _least_distance(start: Cell, group: Cells) -> float:
    return float(np.sqrt(np.square(group - start).sum(axis=1).min()))
