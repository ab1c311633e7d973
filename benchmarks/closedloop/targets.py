"""Goals to drive to, drawn at random, and how long the shortest way to each is."""

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
"""Meters between the hull at a goal and anything: it can be reached by whoever keeps 0.2 m away."""

_TIGHT = 0.12
"""The same on the way: what is narrower is no way."""

_LEAST = 1.0
_TRIES = 10_000


class Targets:
    """Draws goals on a world's map that a robot can reach while the doors are as they are.

    Args:
        world: where.
        robot: who.
        seed: of the goals.
        farthest: meters of way to a goal at most.
    """

    def __init__(self, world: World, robot: Robot, seed: int, farthest: float = math.inf) -> None:
        self._world, self._robot, self._farthest = world, robot, farthest
        self._random = np.random.default_rng(seed)
        self._resolution = world.map.getResolution()
        self._around = self._distances()

    def _distances(self) -> NDArray[np.float32]:
        """Meters from each cell to what stands there or is kept out of; rows from the top one down."""
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
        """How long the shortest way is, meters; infinite where there is none for a robot of this width."""
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
        """Whether people turn round and rest there: the robot would wait for them until they are elsewhere."""
        people = [walker.person for walker in self._robot.simulation.world.people.values()]
        return any(
            math.dist((goal.x, goal.y), point) < self._robot.radius + person.radius + _ROOM
            for person in people
            for point in (person.at, *person.path)
        )

    def __iter__(self) -> Iterator[tuple[Pose, float]]:
        """Goals, each with the length of the shortest way from where the robot then is."""
        rows, columns = np.nonzero(self._around > self._robot.radius + _ROOM)
        for _ in range(_TRIES):
            place = int(self._random.integers(len(rows)))
            x, y = self._world.map.centers_of([(columns[place], rows[place])])[0]
            goal = Pose(float(x), float(y), float(self._random.uniform(-math.pi, math.pi)))
            length = math.inf if self._is_somebodys(goal) else self.path_length(self._robot.truth, goal)
            if math.isfinite(length) and _LEAST <= length <= self._farthest:
                yield goal, length
        msg = f"no goal in {self._world.name} can be reached from {self._robot.truth}"
        raise RuntimeError(msg)
