"""Ways over one map, and over several."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from bridge.config.sections.planners import RobotPathPlannerSection, WaypointSection
from navigation.constraints import Constraints
from navigation.goals import MapPlace
from navigation.pose import Pose
from navigation.robot_path_planner.atlas import Leg, LinkedPlaces, leg
from navigation.robot_path_planner.ground import Clutter, Ground, Zone
from navigation.robot_path_planner.way import blocked, sampled, way
from navigation.status import Fault, PlanError
from tests.navigation.robot_path_planner.floors import ROOMS, SETTINGS, floor, paint
from yarp_compat.dev.extras import AreaBehaviour
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.vec2d import Vec2D

WEST, EAST = Pose(1.0, 1.0, 0.0), Pose(4.0, 1.0, 1.0)


def places(found: object, start: Pose) -> np.ndarray:
    return np.array([start[:2], *(each.pose[:2] for each in found.waypoints)])  # type: ignore[attr-defined]


def area(left: float, bottom: float, right: float, top: float, name: str = "floor") -> Map2DArea:
    return Map2DArea(name, [Vec2D(left, bottom), Vec2D(right, bottom), Vec2D(right, top), Vec2D(left, top)])


def test_the_golden_vector_of_upstream_comes_out_to_within_a_cell() -> None:
    """A real run's waypoints (facts/yarp.md, section g).

    Upstream takes a cell's corner for its place where we take its middle, keeps the first computed cell (1.05, 2.5) and
    the goal's own (3.95, 2.5) as waypoints, and enlarges walls to squares where ours keep the robot's radius round
    corners: so the two turns may lie one cell off, and two of five waypoints are not needed.
    """
    flags = np.zeros((100, 100), np.uint8)
    flags[[0, -1]] = flags[:, [0, -1]] = flags[:60, 50] = MapFlag.WALL
    ground = Ground(MapGrid2D.of(flags, name="m1", resolution=0.05), 0.1)
    found = way(ground, Pose(1.0, 2.5, 0.0), Pose(4.0, 2.5, 0.0), RobotPathPlannerSection(min_waypoint_distance=0.0))
    theirs = np.array([(2.4, 1.85), (2.6, 1.85), (4.0, 2.5)])
    ours = np.array([each.pose[:2] for each in found.waypoints])
    assert ours.shape == theirs.shape
    assert np.abs(ours - theirs - (0.025, 0.025))[:2].max() <= 0.05 + 1e-9
    assert tuple(ours[-1]) == (4.0, 2.5)
    upstream = [(1.0, 2.5), (1.05, 2.5), *map(tuple, theirs[:2]), (3.95, 2.5), (4.0, 2.5)]
    assert found.length <= sum(math.dist(a, b) for a, b in itertools.pairwise(upstream))


def test_every_line_keeps_the_radius_and_the_goal_is_exact() -> None:
    ground = Ground(floor(*ROOMS), SETTINGS.robot_radius, SETTINGS.clearance)
    found = way(ground, Pose(1.0, 2.5, 0.0), Pose(4.01, 2.52, 1.0), SETTINGS)
    line = sampled(places(found, Pose(1.0, 2.5, 0.0)), 0.01)
    columns, rows = ground.grid.cells_at(line).T
    assert (ground.weights[rows, columns] > 0).all()
    assert found.waypoints[-1].pose == Pose(4.01, 2.52, 1.0)
    assert [each.constraints.heading for each in found.waypoints] == [False] * (len(found.waypoints) - 1) + [True]
    assert all(each.constraints.through for each in found.waypoints[:-1])


def test_the_clearance_keeps_ways_off_walls_where_there_is_room() -> None:
    def nearest(clearance: float) -> float:
        ground = Ground(floor((1.5, 0.0, 2.0, 3.0)), 0.2, clearance)
        line = sampled(places(way(ground, WEST, Pose(3.0, 1.0, 0.0), SETTINGS), WEST), 0.02)
        columns, rows = ground.grid.cells_at(line).T
        return float(ground.room[rows, columns].min())

    assert nearest(0.4) > nearest(0.0) + 0.15


@pytest.mark.parametrize(
    ("goal", "fault", "said"),
    [
        (Pose(2.5, 2.5, 0.0), Fault.GOAL_OCCUPIED, "in a wall"),
        (Pose(0.1, 0.1, 0.0), Fault.GOAL_OCCUPIED, "nearer than the robot's radius"),
        (Pose(9.0, 1.0, 0.0), Fault.OFF_THE_MAP, "off the map"),
        (Pose(math.nan, 1.0, 0.0), Fault.OFF_THE_MAP, "off the map"),
        (Pose(4.0, 4.5, 0.0), Fault.GOAL_OCCUPIED, "kept out"),
        (Pose(1.0, 4.5, 0.0), Fault.GOAL_OCCUPIED, "knows nothing"),
        (Pose(4.0, 1.0, 0.0), Fault.NO_PATH, "no way leads"),
    ],
)
def test_goals_that_cannot_be_driven_to_say_why(goal: Pose, fault: Fault, said: str) -> None:
    grid = floor((2.4, 0.0, 2.6, 5.0))
    paint(grid, (3.5, 4.0, 4.9, 4.9), MapFlag.KEEP_OUT)
    paint(grid, (0.5, 4.0, 1.5, 4.9), MapFlag.UNKNOWN)
    with pytest.raises(PlanError, match=said) as caught:
        way(Ground(grid, 0.2), WEST, goal, SETTINGS)
    assert caught.value.fault is fault


def test_a_start_in_a_wall_says_so() -> None:
    grid = floor((1.0, 1.0, 3.0, 3.0))
    with pytest.raises(PlanError, match="no way out") as caught:
        way(Ground(grid, 0.2), Pose(2.0, 2.0, 0.0), Pose(4.0, 4.0, 0.0), SETTINGS)
    assert caught.value.fault is Fault.START_OCCUPIED


def test_keep_out_cells_and_areas_are_driven_round_and_left_by_the_shortest_way() -> None:
    grid = floor()
    paint(grid, (1.5, 0.5, 2.0, 3.0), MapFlag.KEEP_OUT)
    zone = Zone(area(2.8, 2.0, 3.3, 4.9), AreaBehaviour(keep_out=True))
    ground = Ground(grid, 0.2, zones=[zone])
    goal = Pose(4.2, 3.5, 0.0)
    line = sampled(places(way(ground, WEST, goal, SETTINGS), WEST), 0.02)
    columns, rows = ground.grid.cells_at(line).T
    assert (ground.room[rows, columns] >= 0.2 - 0.05).all()
    inside = Pose(2.9, 3.0, 0.0)
    found = way(ground, inside, goal, SETTINGS)
    assert "kept out" in found.note
    out = found.waypoints[0].pose
    assert out.x < 2.8 - 0.19  # west is nearer than east
    assert inside.distance(out) < 0.5
    line = sampled(places(found, inside)[1:], 0.02)
    columns, rows = ground.grid.cells_at(line).T
    assert not ground.kept[rows, columns].any()


def test_areas_split_the_way_and_say_how_to_drive_in_them() -> None:
    slow = Zone(area(2.0, 0.0, 3.0, 5.0), AreaBehaviour(0.15))
    wait = Zone(area(2.5, 0.0, 3.5, 5.0), AreaBehaviour(0.3, "wait"))
    ground = Ground(floor(), 0.2, zones=[slow, wait])
    settings = RobotPathPlannerSection(
        robot_radius=0.2, waypoint=WaypointSection(tolerance_lin=None, max_lin_speed=0.5, min_lin_speed=0.2)
    )
    found = way(ground, WEST, EAST, settings)
    told = [(each.constraints.max_lin_speed, each.constraints.on_obstacle) for each in found.waypoints]
    assert told == [(0.5, ""), (0.15, ""), (0.15, "wait"), (0.3, "wait"), (None, "")]
    assert [each.pose.x for each in found.waypoints] == pytest.approx([2.0, 2.5, 3.0, 3.5, 4.0], abs=0.08)
    assert found.waypoints[1].constraints.min_lin_speed == 0.15


def test_beside_what_is_kept_out_of_nothing_is_gone_round_by_the_laser_alone() -> None:
    grid = floor(size=10.0)
    paint(grid, (8.0, 0.5, 9.5, 1.5), MapFlag.KEEP_OUT)
    near, far = way(Ground(grid, 0.2), WEST, Pose(7.5, 1.0, 0.0), SETTINGS).waypoints
    assert (near.constraints.on_obstacle, far.constraints.on_obstacle) == ("", "wait")
    assert near.pose.x == pytest.approx(6.5, abs=0.1)
    assert not far.waits, "the planner itself may look for another way"


def test_what_the_sender_asks_for_holds_and_areas_are_stronger() -> None:
    ground = Ground(floor(), 0.2, zones=[Zone(area(3.0, 0.0, 5.0, 5.0), AreaBehaviour(0.3))])
    wanted = Constraints(max_lin_speed=0.4, tolerance_lin=0.5, heading=False)
    first, last = way(ground, WEST, EAST, SETTINGS, wanted).waypoints
    assert (first.constraints.max_lin_speed, first.constraints.tolerance_lin) == (0.4, 0.1)
    assert (last.constraints.max_lin_speed, last.constraints.tolerance_lin) == (0.3, 0.5)
    assert not last.constraints.heading
    (last,) = way(Ground(floor(), 0.2), WEST, EAST._replace(theta=math.nan), SETTINGS).waypoints
    assert (last.pose.theta, last.constraints.heading) == (0.0, False)


def test_waypoints_keep_their_least_distance_where_the_line_is_free() -> None:
    ground = Ground(floor((1.5, 0.0, 2.0, 3.0)), 0.2, 0.4)

    def count(least: float) -> int:
        given = RobotPathPlannerSection(robot_radius=0.2, min_waypoint_distance=least)
        return len(way(ground, WEST, Pose(3.0, 1.0, 0.0), given).waypoints)

    assert count(0.6) < count(0.0)
    given = RobotPathPlannerSection(robot_radius=0.2, min_waypoint_distance=0.0, use_optimized_path=False)
    assert len(way(ground, WEST, Pose(3.0, 1.0, 0.0), given).waypoints) > 40


def test_flags_and_doubtful_cells_cost_more() -> None:
    grid = floor()
    paint(grid, (2.0, 0.0, 3.0, 2.5), MapFlag.ENLARGED_OBSTACLE)
    line = places(way(Ground(grid, 0.2), WEST, EAST, SETTINGS), WEST)
    assert line[:, 1].max() > 2.4  # round the room about an obstacle
    grid = floor()
    grid.occupancy[grid.flags == 0] = 40
    assert way(Ground(grid, 0.2), WEST, EAST, SETTINGS).waypoints


def test_what_the_laser_sees_closes_a_door_until_it_is_forgotten() -> None:
    ground = Ground(floor(*ROOMS), 0.2)
    clutter = Clutter(ground, memory=30.0)
    ranges = np.hypot(1.5, np.tan(np.linspace(-0.15, 0.15, 61)) * 1.5)
    for _ in range(6):
        clutter.see(WEST, ranges, -0.15, 0.005, 5.0)
    assert len(clutter.cells)
    found = way(ground, WEST, EAST, SETTINGS, weights=clutter.weights())
    assert places(found, WEST)[:, 1].max() > 3.5  # by the other door
    both = clutter.weights()
    both[:50] = 0
    with pytest.raises(PlanError) as caught:
        way(ground, WEST, EAST, SETTINGS, weights=both)
    assert caught.value.passing
    for second in range(40):
        clutter.forget(float(second))
    assert not len(clutter.cells)
    for _ in range(6):
        clutter.see(WEST, ranges, -0.15, 0.005, 5.0)
    for _ in range(20):
        clutter.see(WEST, np.full(61, np.inf), -0.15, 0.005, 5.0)
    assert not len(clutter.cells), "what is seen through is not there"


def test_echoes_of_walls_that_the_map_has_are_no_obstacles() -> None:
    ground = Ground(floor((2.0, 0.0, 2.5, 5.0)), 0.2)
    clutter = Clutter(ground, memory=30.0)
    for distance in (0.9, 1.1):  # the wall's at 1 m, seen by a robot that is not quite where it thinks
        for _ in range(6):
            clutter.see(WEST, np.full(3, distance), -0.005, 0.005, 5.0)
    assert not len(clutter.cells)
    for _ in range(10):
        clutter.see(WEST, np.full(3, 0.5), -0.005, 0.005, 5.0)
    assert len(clutter.cells)
    stopped = np.array([(1.29, 1.0), (1.9, 1.0)])
    assert blocked(ground, clutter.struck(), stopped), "also for a robot that has stopped right before it"


class Two:
    """Two maps, with a stair of little and a lift of much cost between them; the stair leads to a closed room."""

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


def test_links_lead_to_other_maps_by_the_cheapest_way_that_there_is() -> None:
    atlas = Two(LIFT, STAIR)
    ground = atlas.maps["floor"]
    assert leg(atlas, ground, WEST, MapPlace("up", Pose(4.0, 1.0, 0.0))) == Leg(STAIR.second, STAIR.first)
    assert leg(atlas, ground, WEST, MapPlace("up", Pose(1.0, 4.0, 0.0))) == Leg(LIFT.first, LIFT.second)
    assert leg(atlas, ground, WEST, MapPlace("floor", EAST)) == Leg(MapPlace("floor", EAST))
    near = replace(STAIR, cost=20.0)  # nearer, and dearer
    further = LinkedPlaces(
        MapPlace("floor", Pose(4.0, 4.0, 0.0), "c"), MapPlace("up", Pose(4.0, 1.0, 0.0), "d"), 1.0, "ramp"
    )
    goal = MapPlace("up", Pose(2.0, 1.0, 0.0))
    assert leg(Two(near, further), ground, WEST, goal) == Leg(further.first, further.second)


@pytest.mark.parametrize(("links", "name", "fault"), [((), "up", Fault.NO_PATH), ((LIFT,), "roof", Fault.NO_MAP)])
def test_maps_that_no_link_leads_to_say_so(links: tuple[LinkedPlaces, ...], name: str, fault: Fault) -> None:
    atlas = Two(*links)
    with pytest.raises(PlanError, match=name) as caught:
        leg(atlas, atlas.maps["floor"], WEST, MapPlace(name, EAST))
    assert caught.value.fault is fault
