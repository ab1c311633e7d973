"""The search of the planner `wavefront`: functions on arrays, without a hub."""

from __future__ import annotations

from collections import deque

import numpy as np

from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.shortcut import shortcut
from navigation.pose import Pose
from navigation.status import Fault, PlanError
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.vec2d import Vec2D


def plan(grid: MapGrid2D, start: Pose, goal: Pose, radius: float) -> list[Pose]:
    """Return waypoints to a goal, in meters, by a wave that spreads from the goal; raises `PlanError`."""
    free = distance_transform(grid.flags != 0) * grid.getResolution() > radius
    free[[0, -1]] = free[:, [0, -1]] = False  # so that all neighbors of free cells are on the map
    begin, end = (tuple(cell) for cell in grid.cells_at([start[:2], goal[:2]])[:, ::-1].tolist())
    if not (grid.isInsideMap(Vec2D(*start[:2])) and grid.isInsideMap(Vec2D(*goal[:2])) and free[end]):
        raise PlanError(
            Fault.GOAL_OCCUPIED, "the robot or the goal is off the map, or the robot does not fit at the goal"
        )
    free[begin] = True  # where the robot stands
    following, front = {end: end}, deque([end])
    while front and begin not in following:
        row, column = front.popleft()
        for cell in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
            if free[cell] and cell not in following:
                following[cell] = row, column
                front.append(cell)
    if begin not in following:
        raise PlanError(Fault.NO_PATH, "no path to the goal")
    cells = [begin]
    while cells[-1] != end:
        cells.append(following[cells[-1]])
    corners = shortcut(free.astype(np.uint8), np.array(cells, np.int32))[1:-1, ::-1]
    return [*(Pose(x, y, 0.0) for x, y in grid.centers_of(corners).tolist()), goal]
