"""Paths on one map, and across several maps."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from navigation.constraints import Constraints
from navigation.goals import MapPlace
from navigation.pose import Pose
from navigation.robot_path_planner.atlas import Leg, LinkedPlaces, leg
from navigation.robot_path_planner.ground import Clutter, Ground, Zone
from navigation.robot_path_planner.path import PlannedPath, blocked, fits_straight, plan_path, sample_line
from navigation.robot_path_planner.section import RobotPathPlannerSection, WaypointSection
from navigation.status import Fault, PlanError
from tests.peers.navigation.floors import ROOMS, SETTINGS, floor, paint
from yarp_compat.dev.extras import AreaBehavior
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.vec2d import Vec2D

WEST, EAST = Pose(1.0, 1.0, 0.0), Pose(4.0, 1.0, 1.0)


def places(path: PlannedPath, start: Pose) -> np.ndarray:
    return np.array([start[:2], *(waypoint.pose[:2] for waypoint in path.waypoints)])


def area(left: float, bottom: float, right: float, top: float, name: str = "floor") -> Map2DArea:
    return Map2DArea(name, [Vec2D(left, bottom), Vec2D(right, bottom), Vec2D(right, top), Vec2D(left, top)])


def test_upstreams_recorded_path_is_matched_to_within_a_cell() -> None:
    """The waypoints are those of a real run of robotPathPlannerDev (robotology/navigation, branch YARP4, b8f251c4).

    Upstream uses a cell's corner, Midspan its center. Upstream also keeps the first computed cell (1.05, 2.5) and the
    goal's own (3.95, 2.5) as waypoints, and enlarges walls to squares, while Midspan keeps the robot's radius around
    corners. So the two turns may be one cell off, and two of five waypoints are not needed.
    """
    flags = np.zeros((100, 100), np.uint8)
    flags[[0, -1]] = flags[:, [0, -1]] = flags[:60, 50] = MapFlag.WALL
    ground = Ground(MapGrid2D.of(flags, name="m1", resolution=0.05), 0.1)
    path = plan_path(
        ground, Pose(1.0, 2.5, 0.0), Pose(4.0, 2.5, 0.0), RobotPathPlannerSection(min_waypoint_distance=0.0)
    )
    expected = np.array([(2.4, 1.85), (2.6, 1.85), (4.0, 2.5)])
    computed = np.array([waypoint.pose[:2] for waypoint in path.waypoints])
    assert computed.shape == expected.shape
    assert np.abs(computed - expected - (0.025, 0.025))[:2].max() <= 0.05 + 1e-9
    assert tuple(computed[-1]) == (4.0, 2.5)
    upstream = [(1.0, 2.5), (1.05, 2.5), *map(tuple, expected[:2]), (3.95, 2.5), (4.0, 2.5)]
    assert path.length <= sum(math.dist(a, b) for a, b in itertools.pairwise(upstream))


def test_every_segment_keeps_the_radius_and_the_goal_is_exact() -> None:
    ground = Ground(floor(*ROOMS), SETTINGS.robot_radius, SETTINGS.clearance)
    path = plan_path(ground, Pose(1.0, 2.5, 0.0), Pose(4.01, 2.52, 1.0), SETTINGS)
    line = sample_line(places(path, Pose(1.0, 2.5, 0.0)), 0.01)
    columns, rows = ground.grid.cells_at(line).T
    assert (ground.weights[rows, columns] > 0).all()
    assert path.waypoints[-1].pose == Pose(4.01, 2.52, 1.0)
    assert [waypoint.constraints.heading for waypoint in path.waypoints] == [False] * (len(path.waypoints) - 1) + [True]
    assert all(waypoint.constraints.through for waypoint in path.waypoints[:-1])


def test_the_clearance_keeps_paths_away_from_walls() -> None:
    def nearest(clearance: float) -> float:
        ground = Ground(floor((1.5, 0.0, 2.0, 3.0)), 0.2, clearance)
        line = sample_line(places(plan_path(ground, WEST, Pose(3.0, 1.0, 0.0), SETTINGS), WEST), 0.02)
        columns, rows = ground.grid.cells_at(line).T
        return float(ground.room[rows, columns].min())

    assert nearest(0.4) > nearest(0.0) + 0.15


@pytest.mark.parametrize(
    ("goal", "fault", "reason"),
    [
        (Pose(2.5, 2.5, 0.0), Fault.GOAL_OCCUPIED, "in a wall"),
        (Pose(0.1, 0.1, 0.0), Fault.GOAL_OCCUPIED, "closer than the robot's radius"),
        (Pose(9.0, 1.0, 0.0), Fault.OFF_THE_MAP, "outside the map"),
        (Pose(math.nan, 1.0, 0.0), Fault.OFF_THE_MAP, "outside the map"),
        (Pose(4.0, 4.5, 0.0), Fault.GOAL_OCCUPIED, "keep-out area"),
        (Pose(1.0, 4.5, 0.0), Fault.GOAL_OCCUPIED, "unknown part of the map"),
        (Pose(4.0, 1.0, 0.0), Fault.NO_PATH, "no path from"),
    ],
)
def test_unreachable_goals_are_rejected_with_the_reason(goal: Pose, fault: Fault, reason: str) -> None:
    grid = floor((2.4, 0.0, 2.6, 5.0))
    paint(grid, (3.5, 4.0, 4.9, 4.9), MapFlag.KEEP_OUT)
    paint(grid, (0.5, 4.0, 1.5, 4.9), MapFlag.UNKNOWN)
    with pytest.raises(PlanError, match=reason) as caught:
        plan_path(Ground(grid, 0.2), WEST, goal, SETTINGS)
    assert caught.value.fault is fault


def test_a_start_inside_a_wall_is_reported() -> None:
    grid = floor((1.0, 1.0, 3.0, 3.0))
    with pytest.raises(PlanError, match="cannot get out") as caught:
        plan_path(Ground(grid, 0.2), Pose(2.0, 2.0, 0.0), Pose(4.0, 4.0, 0.0), SETTINGS)
    assert caught.value.fault is Fault.START_OCCUPIED


def test_keep_out_areas_are_avoided_and_left_by_the_shortest_path() -> None:
    grid = floor()
    paint(grid, (1.5, 0.5, 2.0, 3.0), MapFlag.KEEP_OUT)
    zone = Zone(area(2.8, 2.0, 3.3, 4.9), AreaBehavior(keep_out=True))
    ground = Ground(grid, 0.2, zones=[zone])
    goal = Pose(4.2, 3.5, 0.0)
    line = sample_line(places(plan_path(ground, WEST, goal, SETTINGS), WEST), 0.02)
    columns, rows = ground.grid.cells_at(line).T
    assert (ground.room[rows, columns] >= 0.2 - 0.05).all()
    inside = Pose(2.9, 3.0, 0.0)
    path = plan_path(ground, inside, goal, SETTINGS)
    assert "keep-out area" in path.note
    outside = path.waypoints[0].pose
    assert outside.x < 2.8 - 0.19  # west is nearer than east
    assert inside.distance(outside) < 0.5
    line = sample_line(places(path, inside)[1:], 0.02)
    columns, rows = ground.grid.cells_at(line).T
    assert not ground.kept[rows, columns].any()


def test_areas_split_the_path_and_set_its_constraints() -> None:
    slow = Zone(area(2.0, 0.0, 3.0, 5.0), AreaBehavior(0.15))
    wait = Zone(area(2.5, 0.0, 3.5, 5.0), AreaBehavior(0.3, "wait"))
    ground = Ground(floor(), 0.2, zones=[slow, wait])
    settings = RobotPathPlannerSection(
        robot_radius=0.2, waypoint=WaypointSection(tolerance_lin=None, max_lin_speed=0.5, min_lin_speed=0.2)
    )
    path = plan_path(ground, WEST, EAST, settings)
    limits = [(waypoint.constraints.max_lin_speed, waypoint.constraints.on_obstacle) for waypoint in path.waypoints]
    assert limits == [(0.5, ""), (0.15, ""), (0.15, "wait"), (0.3, "wait"), (None, "")]
    assert [waypoint.pose.x for waypoint in path.waypoints] == pytest.approx([2.0, 2.5, 3.0, 3.5, 4.0], abs=0.08)
    assert path.waypoints[1].constraints.min_lin_speed == 0.15


def test_waypoints_report_whether_keep_out_cells_are_near() -> None:
    grid = floor(size=10.0)
    paint(grid, (8.0, 0.5, 9.5, 1.5), MapFlag.KEEP_OUT)
    near, far = plan_path(Ground(grid, 0.2), WEST, Pose(7.5, 1.0, 0.0), SETTINGS).waypoints
    assert (near.constraints.beside_keep_out, far.constraints.beside_keep_out) == ("", "floor")
    assert near.pose.x == pytest.approx(6.5, abs=0.1)
    assert not far.waits_for_obstacles, "the planner itself may replan, so the navigator does not wait for obstacles"


def test_goal_constraints_override_settings_and_areas_override_both() -> None:
    ground = Ground(floor(), 0.2, zones=[Zone(area(3.0, 0.0, 5.0, 5.0), AreaBehavior(0.3))])
    wanted = Constraints(max_lin_speed=0.4, tolerance_lin=0.5, heading=False)
    first, last = plan_path(ground, WEST, EAST, SETTINGS, wanted).waypoints
    assert (first.constraints.max_lin_speed, first.constraints.tolerance_lin) == (0.4, 0.1)
    assert (last.constraints.max_lin_speed, last.constraints.tolerance_lin) == (0.3, 0.5)
    assert not last.constraints.heading
    (last,) = plan_path(Ground(floor(), 0.2), WEST, EAST._replace(theta=math.nan), SETTINGS).waypoints
    assert (last.pose.theta, last.constraints.heading) == (0.0, False)


@pytest.mark.parametrize(
    ("x", "y", "fits"),
    [(1.2, 1.0, False), (1.15, 1.1, False), (0.8, 1.0, True), (1.0, 1.2, True), (1.6, 1.0, False)],
    ids=["ahead", "ahead, aside", "behind", "aside", "farther ahead"],
)
def test_a_robot_too_close_to_an_obstacle_may_drive_straight_away_from_it_but_not_through_it(
    x: float, y: float, fits: bool
) -> None:
    ground = Ground(floor(), SETTINGS.robot_radius)
    clutter = Clutter(ground, 30.0, [np.array([(x, y)])])
    assert fits_straight(ground, clutter, WEST, EAST) == fits


def test_waypoints_keep_their_minimum_distance_on_a_free_line() -> None:
    ground = Ground(floor((1.5, 0.0, 2.0, 3.0)), 0.2, 0.4)

    def count(least: float) -> int:
        settings = RobotPathPlannerSection(robot_radius=0.2, min_waypoint_distance=least)
        return len(plan_path(ground, WEST, Pose(3.0, 1.0, 0.0), settings).waypoints)

    assert count(0.6) < count(0.0)
    settings = RobotPathPlannerSection(robot_radius=0.2, min_waypoint_distance=0.0, use_optimized_path=False)
    assert len(plan_path(ground, WEST, Pose(3.0, 1.0, 0.0), settings).waypoints) > 40


def test_enlarged_and_uncertain_cells_cost_more() -> None:
    grid = floor()
    paint(grid, (2.0, 0.0, 3.0, 2.5), MapFlag.ENLARGED_OBSTACLE)
    line = places(plan_path(Ground(grid, 0.2), WEST, EAST, SETTINGS), WEST)
    assert line[:, 1].max() > 2.4  # around the enlarged obstacle
    grid = floor()
    grid.occupancy[grid.flags == 0] = 40
    assert plan_path(Ground(grid, 0.2), WEST, EAST, SETTINGS).waypoints


def test_the_lasers_obstacles_close_a_door_until_they_fade() -> None:
    ground = Ground(floor(*ROOMS), 0.2)
    clutter = Clutter(ground, memory=30.0)
    ranges = np.hypot(1.5, np.tan(np.linspace(-0.15, 0.15, 61)) * 1.5)
    for _ in range(6):
        clutter.see(WEST, ranges, -0.15, 0.005, 5.0)
    assert len(clutter.cells)
    path = plan_path(ground, WEST, EAST, SETTINGS, weights=clutter.weights())
    assert places(path, WEST)[:, 1].max() > 3.5  # through the other door
    both = clutter.weights()
    both[:50] = 0
    with pytest.raises(PlanError) as caught:
        plan_path(ground, WEST, EAST, SETTINGS, weights=both)
    assert caught.value.passing
    for second in range(40):
        clutter.fade(float(second))
    assert not len(clutter.cells)
    for _ in range(6):
        clutter.see(WEST, ranges, -0.15, 0.005, 5.0)
    for _ in range(20):
        clutter.see(WEST, np.full(61, np.inf), -0.15, 0.005, 5.0)
    assert not len(clutter.cells), "cells that beams pass through are free"


def test_echoes_of_mapped_walls_are_not_obstacles() -> None:
    ground = Ground(floor((2.0, 0.0, 2.5, 5.0)), 0.2)
    clutter = Clutter(ground, memory=30.0)
    for distance in (0.9, 1.1):  # the wall is at 1 m; the robot's pose has an error
        for _ in range(6):
            clutter.see(WEST, np.full(3, distance), -0.005, 0.005, 5.0)
    assert not len(clutter.cells)
    for _ in range(10):
        clutter.see(WEST, np.full(3, 0.5), -0.005, 0.005, 5.0)
    assert len(clutter.cells)
    stopped = np.array([(1.29, 1.0), (1.9, 1.0)])
    assert blocked(ground, clutter.struck(), stopped), (
        "the path is also blocked for a robot that has stopped just in front of the obstacle"
    )


class Two:
    """Two maps, connected by the given links; on ``up``, a wall separates the end of `STAIR` from that of `LIFT`."""

    def __init__(self, *links: LinkedPlaces) -> None:
        closed = floor((0.0, 2.0, 5.0, 2.2), name="up")
        self.maps = {"floor": Ground(floor(), 0.2), "up": Ground(closed, 0.2)}
        self._links = links

    def ground(self, name: str) -> Ground | None:
        return self.maps.get(name)

    def links(self) -> tuple[LinkedPlaces, ...]:
        return self._links


LIFT = LinkedPlaces(
    MapPlace("floor", Pose(4.0, 4.0, 0.0), "lift 0"), MapPlace("up", Pose(4.0, 4.0, 0.0), "lift 1"), 10.0, "lift"
)
STAIR = LinkedPlaces(
    MapPlace("up", Pose(1.0, 1.0, 0.0), "stair 1"), MapPlace("floor", Pose(1.0, 2.0, 0.0), "stair 0"), 1.0, "stair"
)


def test_the_cheapest_links_to_another_map_are_used() -> None:
    atlas = Two(LIFT, STAIR)
    ground = atlas.maps["floor"]
    assert leg(atlas, ground, WEST, MapPlace("up", Pose(4.0, 1.0, 0.0))) == Leg(STAIR.second, STAIR.first)
    assert leg(atlas, ground, WEST, MapPlace("up", Pose(1.0, 4.0, 0.0))) == Leg(LIFT.first, LIFT.second)
    assert leg(atlas, ground, WEST, MapPlace("floor", EAST)) == Leg(MapPlace("floor", EAST))
    near = replace(STAIR, cost=20.0)  # nearer, but more expensive
    further = LinkedPlaces(
        MapPlace("floor", Pose(4.0, 4.0, 0.0), "c"), MapPlace("up", Pose(4.0, 1.0, 0.0), "d"), 1.0, "ramp"
    )
    goal = MapPlace("up", Pose(2.0, 1.0, 0.0))
    assert leg(Two(near, further), ground, WEST, goal) == Leg(further.first, further.second)


@pytest.mark.parametrize(("links", "name", "fault"), [((), "up", Fault.NO_PATH), ((LIFT,), "roof", Fault.NO_MAP)])
def test_maps_without_links_are_rejected(links: tuple[LinkedPlaces, ...], name: str, fault: Fault) -> None:
    atlas = Two(*links)
    with pytest.raises(PlanError, match=name) as caught:
        leg(atlas, atlas.maps["floor"], WEST, MapPlace(name, EAST))
    assert caught.value.fault is fault
