"""Random goals, with the length of the shortest path to each."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.closedloop.robot import Robot
from benchmarks.closedloop.worlds import World, covered, hidden
from navigation.algorithms.astar import astar
from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.shortcut import shortcut
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapFlag

_ROOM = 0.25
"""Minimum clearance of the hull at a goal, meters; a planner that stays 0.2 m away from obstacles can reach it."""

_TIGHT = 0.12
"""Minimum clearance on the path; narrower passages are not used."""

_LEAST = 1.0  # minimum length of the path to a goal, meters
_TRIES = 10_000  # maximum number of places that are drawn for each goal


class Targets:
    """Draws goals on a world's map that a robot can reach with the doors in their current state.

    Args:
        world: the floor.
        robot: the robot.
        seed: seed of the goals.
        farthest: maximum length of the path to a goal, meters.
    """

    def __init__(self, world: World, robot: Robot, seed: int, farthest: float = math.inf) -> None:
        self._world, self._robot, self._farthest = world, robot, farthest
        self._random = np.random.default_rng(seed)
        self._resolution = world.map.getResolution()
        self._around = self._distances()

    def _distances(self) -> NDArray[np.float32]:
        """Return each cell's distance to obstacles and keep-out areas, in meters; the top row first."""
        grid, floor_world = self._world.map, self._robot.simulation.world
        solid = grid.flags != MapFlag.FREE
        pieces = [*floor_world.leaves(is_open=False), *(crate.now() for crate in floor_world.crates.values())]
        pieces += hidden(floor_world)
        columns, rows = grid.cells_at(covered(grid, pieces)).T
        solid[rows, columns] = True
        return distance_transform(solid) * np.float32(self._resolution)

    def _cell(self, pose: Pose) -> tuple[int, int]:
        column, row = self._world.map.cells_at([(pose.x, pose.y)])[0]
        return int(row), int(column)

    def path_length(self, start: Pose, goal: Pose) -> float:
        """Return the length of the shortest path, in meters; infinite if this robot has none."""
        weights = (self._around > self._robot.radius + _TIGHT).astype(np.uint8)
        row, column = self._cell(start)
        free = np.argwhere(weights)
        start_cell = free[
            ((free - (row, column)) ** 2).sum(1).argmin()
        ]  # a robot may stand nearer to a wall than it drives
        path = astar(weights, (int(start_cell[0]), int(start_cell[1])), self._cell(goal))
        if path is None:
            return math.inf
        corners = shortcut(weights, path.cells)
        return float(np.hypot(*np.diff(corners, axis=0).T).sum()) * self._resolution

    def _is_somebodys(self, goal: Pose) -> bool:
        """Return whether people turn around and rest at a goal, so that the robot would wait for them."""
        people = [walker.person for walker in self._robot.simulation.world.people.values()]
        return any(
            math.dist((goal.x, goal.y), point) < self._robot.radius + person.radius + _ROOM
            for person in people
            for point in (person.at, *person.path)
        )

    def __iter__(self) -> Iterator[tuple[Pose, float]]:
        """Yield goals, with the length of the shortest path from the robot's current position."""
        rows, columns = np.nonzero(self._around > self._robot.radius + _ROOM)
        tries = _TRIES
        while tries:
            tries -= 1
            place = int(self._random.integers(len(rows)))
            x, y = self._world.map.centers_of([(columns[place], rows[place])])[0]
            goal = Pose(float(x), float(y), float(self._random.uniform(-math.pi, math.pi)))
            length = math.inf if self._is_somebodys(goal) else self.path_length(self._robot.truth, goal)
            if math.isfinite(length) and _LEAST <= length <= self._farthest:
                yield goal, length
                tries = _TRIES
        msg = f"no reachable goal in {self._world.name} from {self._robot.truth}"
        raise RuntimeError(msg)
