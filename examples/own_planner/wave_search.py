"""The search of the planner `wavefront`: functions on arrays, without a hub."""

from __future__ import annotations

from collections import deque

import numpy as np

from navigation.algorithms.shortcut import shortcut
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground
from navigation.status import Fault, PlanError


def plan(ground: Ground, start: Pose, goal: Pose) -> list[Pose]:
    """Return waypoints to a goal, in meters, by a wave that spreads from the goal; raises `PlanError`.

    The path stays in the cells in which `Ground` lets the robot be: outside walls, unknown parts and keep-out areas.
    """
    if ground.closed:
        raise PlanError(Fault.NO_MAP, ground.closed)
    free = ground.weights.copy()
    free[[0, -1]] = free[:, [0, -1]] = 0  # so that all neighbors of free cells are on the map
    begin, end = ground.cell(*start[:2]), ground.cell(*goal[:2])
    if begin is None or end is None:
        raise PlanError(Fault.OFF_THE_MAP, "the robot or the goal is off the map")
    if not free[end]:
        raise PlanError(Fault.GOAL_OCCUPIED, f"the goal is {ground.reason(end) or 'at the border of the map'}")
    free[begin] = 1  # where the robot stands
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
    corners = shortcut(free, np.array(cells, np.int32))[1:-1]
    return [*(Pose(x, y, 0.0) for x, y in ground.places(corners).tolist()), goal]
