"""Exploration: the order of goals on drawn maps, and a floor that a simulated robot explores in lock-step."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.closedloop.robot import Robot
from benchmarks.closedloop.stack import Ours
from benchmarks.closedloop.worlds import World
from navigation.algorithms.submaps import Scan
from navigation.exploration import MOST_FAILURES, Exploration, FrontierGoal, NoRoomError
from navigation.mapper2d.drawn import DrawnMap
from navigation.mapper2d.mapper import Mapper
from navigation.mapper2d.section import Mapper2DSection
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground
from navigation.scan import clean_ranges
from navigation.status import State
from sim import export
from sim.plan import Plan
from tests.peers.navigation.floors import floor, paint
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

ROBOT = Pose(0.8, 2.5, 0.0)


def explored() -> MapGrid2D:
    """Return a floor whose right half is unknown, behind a wall with two doors."""
    grid = floor((2.4, 0.0, 2.6, 0.6), (2.4, 1.4, 2.6, 3.6), (2.4, 4.6, 2.6, 5.0))
    paint(grid, (2.5, 0.0, 5.0, 5.0), MapFlag.UNKNOWN)
    return grid


def choose(exploration: Exploration, grid: MapGrid2D) -> FrontierGoal:
    goal = exploration.choose(grid, ROBOT)
    assert goal is not None
    return goal


def test_goals_are_in_view_of_the_frontiers_that_the_robot_reaches() -> None:
    grid, exploration = explored(), Exploration(radius=0.25, clearance=0.1)
    goal = choose(exploration, grid)
    # the upper door is wider, and no farther away
    assert 1.7 < goal.pose.x < 2.4
    assert abs(goal.pose.y - 4.1) < 0.4
    assert abs(goal.pose.theta) < 0.5
    assert goal.size >= 0.9
    assert Ground(grid, 0.25).fits(Ground(grid, 0.25).cell(goal.pose.x, goal.pose.y) or (0, 0))
    exploration.reached(goal)
    other = choose(exploration, grid)
    assert abs(other.pose.y - 1.0) < 0.4
    exploration.failed(other)
    assert exploration.choose(grid, ROBOT) is None
    assert exploration.failures == 1 < MOST_FAILURES
    assert Exploration(radius=0.55).choose(grid, ROBOT) is None, "the robot does not fit through the doors"


def test_a_frontier_without_a_path_is_left_out() -> None:
    grid = explored()
    paint(grid, (1.4, 0.0, 1.6, 5.0))
    assert Exploration(radius=0.25).choose(grid, ROBOT) is None


@pytest.mark.parametrize(("x", "reason"), [(-3.0, "outside the map"), (4.0, "in an unknown part of the map")])
def test_a_robot_at_which_no_path_can_begin_is_an_error_and_not_the_end(x: float, reason: str) -> None:
    with pytest.raises(NoRoomError, match=reason):
        Exploration(radius=0.25).choose(explored(), Pose(x, 2.5, 0.0))


PLAN = Plan.model_validate({"name": "rooms", "floors": {"rooms": {
    "thickness": 0.12,
    "walls": [
        [[0, 0], [6, 0], [6, 4], [0, 4], [0, 0]], [[2.5, 0], [2.5, 4]], [[2.5, 2.2], [6, 2.2]], [[5, 2.2], [5, 4]],
    ],
    "openings": [[[2.5, 0.6], [2.5, 1.7]], [[3.4, 2.2], [4.5, 2.2]]],
    "start": [1.2, 3.0, 0],
}}})  # fmt: skip
"""Three rooms in a row around a corner, and a chamber of 1 by 1.8 m without a door."""


class Mapping:
    """A robot whose planner uses the map that is drawn from the robot's own scans."""

    def __init__(self) -> None:
        self.robot = robot = Robot(PLAN, seed=1)
        self.drawn = DrawnMap(Mapper(Mapper2DSection(width=4.0, height=4.0, farthest=8.0)))
        floor = PLAN.first
        self.stack = Ours(robot, World("rooms", PLAN, export.grid(PLAN, floor), ()), localized=False)
        self.drawn.locate(robot.truth)
        self._scanned = -1
        self.tick(500)

    @property
    def grid(self) -> MapGrid2D:
        return self.drawn.mapper.grid()

    def tick(self, count: int) -> None:
        for _ in range(count):
            self.stack.step()
            self.robot.tick()
            scan = self.robot.scan
            if scan.time_ns != self._scanned:
                self._scanned = scan.time_ns
                odometry = self.robot.odometry._replace(stamp_ns=scan.time_ns)
                self.drawn.scan(odometry, Scan(clean_ranges(scan), scan.first, scan.step, 8.0))
                self.drawn.work()

    def drive(self, goal: FrontierGoal) -> State:
        """Drive to a goal on the growing map; return how it ended."""
        settings = self.stack.planner.settings
        for second in range(120):
            self.stack.planner.use_map(Ground(self.grid, settings.robot_radius, settings.clearance))
            if second == 0:
                self.stack.goal(goal.pose)
            self.tick(100)
            if self.stack.status[0].ended:
                break
        return self.stack.status[0]


def test_a_robot_explores_all_rooms_that_it_reaches() -> None:
    mapping = Mapping()
    settings = mapping.stack.planner.settings
    exploration = Exploration(settings.robot_radius, settings.clearance)
    while (goal := exploration.choose(mapping.grid, mapping.robot.truth)) is not None:
        assert exploration.sent < 20, "the exploration ends"
        exploration.begin()
        state = mapping.drive(goal)
        if state is State.REACHED:
            exploration.reached(goal)
        else:
            exploration.failed(goal)
        assert exploration.failures < MOST_FAILURES, mapping.stack.status
    assert known_share(mapping.grid) > 0.97


def known_share(grid: MapGrid2D) -> float:
    """Return the share of the rooms' floor that is known in a map."""
    truth = export.grid(PLAN, PLAN.first)
    rows, columns = np.nonzero(truth.flags == MapFlag.FREE)
    at = grid.cells_at(truth.centers_of(np.stack((columns, rows), -1)))
    inside = ((at >= 0) & (at < (grid.m_width, grid.m_height))).all(axis=1)
    return float((grid.flags[at[inside, 1], at[inside, 0]] != MapFlag.UNKNOWN).sum() / len(at))
