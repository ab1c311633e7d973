"""The planner in lock-step with a robot that drives straight."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from navigation.constraints import Constraints
from navigation.goals import MapPlace
from navigation.pose import Pose, wrapped
from navigation.robot_path_planner.ground import Ground, Zone
from navigation.robot_path_planner.path import Waypoint
from navigation.status import Fault, State
from tests.navigation.robot_path_planner.test_path import LIFT, Two, area
from tests.peers.navigation.floors import EAST, KEPT, LOW_DOOR, ROOMS, SETTINGS, WEST, Drive, floor, least_room, paint
from yarp_compat.dev.extras import AreaBehavior
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.sig.vec2d import Vec2D


def test_the_robot_reaches_the_goal_with_its_heading_and_keeps_clear_of_walls() -> None:
    grid = floor(*ROOMS)
    drive = Drive(grid, Pose(1.0, 2.5, 0.0))
    status = drive.goto(EAST)
    assert status == (State.REACHED, "goal reached", Fault.NONE)
    assert drive.local.pose[:3] == EAST[:3]
    assert least_room(drive, grid) > KEPT
    assert {status.state for status in drive.statuses} == {State.MOVING, State.REACHED}


def test_a_goal_at_the_robots_pose_is_reached_immediately() -> None:
    drive = Drive(floor(), WEST)
    assert drive.goto(Pose(1.02, 1.0, 0.0)).state is State.REACHED
    assert not drive.local.sent
    assert drive.goto(Pose(1.02, 1.0, 1.0)).state is State.REACHED
    assert drive.local.sent[-1][1].heading


def test_a_goal_at_the_robots_pose_stops_the_drive_to_the_previous_goal() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    pose = drive.local.pose
    assert drive.goto(Pose(pose.x + 0.05, pose.y, pose.theta)).state is State.REACHED
    assert drive.local.sent[-1][0] == EAST
    assert drive.local.state is State.IDLE


def test_distance_remaining_decreases_to_zero() -> None:
    drive = Drive(floor(*ROOMS), Pose(1.0, 2.5, 0.0))
    drive.planner.goal(EAST)
    drive.tick()
    left = [drive.planner.remaining(drive.local.pose)]
    while drive.planner.active:
        drive.tick()
        left.append(drive.planner.remaining(drive.local.pose))
    assert left[0] > 3.5
    assert left == sorted(left, reverse=True)
    assert left[-1] == 0.0


def test_the_robot_drives_at_the_speed_of_the_goal() -> None:
    drive = Drive(floor(), WEST)
    drive.planner.goal(Pose(4.0, 1.0, 0.0), constraints=Constraints(max_lin_speed=0.2))
    drive.run(60.0)
    assert max(a.distance(b) for a, b in itertools.pairwise(drive.track)) == pytest.approx(0.02)  # in a tick of 0.1 s


def test_a_new_goal_replaces_the_old_one_without_a_stop() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    assert drive.goto(Pose(1.0, 4.0, 0.0)).state is State.REACHED
    assert not drive.local.canceled


def test_the_goals_of_a_path_are_passed_in_sequence_without_stops() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    north = MapPlace("", Pose(1.0, 4.0, 1.5))
    drive.planner.goal(EAST, now=drive.now, then=[north, MapPlace("floor", WEST)])
    assert drive.run(120.0).state is State.REACHED
    assert drive.local.pose[:2] == WEST[:2]
    assert abs(wrapped(drive.local.pose.theta)) < 1e-6
    headed = list(dict.fromkeys(sent[0][:3] for sent in drive.local.sent if sent[1].heading))
    assert headed == [WEST[:3]], "only the last waypoint is sent with its heading"
    passed = [sent for sent in drive.local.sent if sent[0][:2] in (EAST[:2], north.pose[:2])]
    assert [sent[0][:2] for sent in passed] == [EAST[:2], north.pose[:2]]
    assert all(sent[1].through for sent in passed)
    assert all(min(pose.distance(place) for pose in drive.track) <= 0.1 for place in (EAST, north.pose))
    assert not drive.local.canceled


def test_the_reason_names_the_unreachable_place_of_several() -> None:
    drive = Drive(floor(), WEST)
    wall = MapPlace("", Pose(0.0, 0.0, 0.0))
    drive.planner.goal(Pose(2.0, 1.0, 0.0), then=[wall, MapPlace("", EAST)], now=drive.now)
    status = drive.run(60.0)
    assert (status.state, status.fault) == (State.ABORTED, Fault.GOAL_OCCUPIED)
    assert status.reason.startswith("place 2 of 3: the goal (0.00, 0.00) is in a wall")


def test_cancel_and_pause_stop_the_robot() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    drive.planner.pause(drive.now, 3.0)
    assert drive.tick().state is State.PAUSED
    pose = drive.local.pose
    drive.run(1.5)
    assert drive.local.pose == pose
    drive.until(State.MOVING, 2.0)
    drive.planner.pause(drive.now)
    drive.run(5.0)
    assert drive.planner.status.state is State.PAUSED
    drive.planner.resume()
    drive.until(State.MOVING, 1.0)
    drive.planner.cancel()
    assert drive.tick().state is State.IDLE
    assert drive.local.state is State.IDLE


@pytest.mark.parametrize("then", ["cancel", "pause"])
def test_a_braked_goal_sends_no_waypoint_while_a_path_is_planned(then: str) -> None:
    """Another thread cancels or pauses the goal while the current step plans a path."""
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    planner = drive.planner
    assert planner.task
    planner.brake(planner.task)
    drive.local.cancel()
    planner.recompute()
    sent = len(drive.local.sent)
    drive.run(0.2)
    assert planner.status.state is State.MOVING, "the goal is not canceled"
    if then == "cancel":
        planner.cancel()
        drive.run(0.2)
        assert planner.status.state is State.IDLE
    else:
        planner.pause(drive.now)
        drive.run(0.2)
        assert planner.status.state is State.PAUSED
    assert len(drive.local.sent) == sent
    drive.goto(EAST, seconds=0.5) if then == "cancel" else planner.resume()
    drive.until(State.MOVING, 1.0)
    drive.run(0.5)
    assert len(drive.local.sent) > sent


@pytest.mark.parametrize("patience", [5.0, math.inf])
def test_a_door_that_closes_during_the_drive_is_bypassed(patience: float) -> None:
    """The planner replans once the local navigator fails, or earlier, if the navigator waits for long."""
    drive = Drive(floor(*ROOMS), WEST)
    drive.laser = True
    drive.local.crates, drive.local.patience = [LOW_DOOR], patience
    assert drive.goto(EAST).state is State.REACHED
    assert max(pose.y for pose in drive.track) > 3.5
    assert drive.now < 50


def test_an_obstacle_beside_the_path_that_stops_the_robot_is_bypassed() -> None:
    """The obstacle's distance from the path is between half the robot's radius and its radius."""
    drive = Drive(floor(), WEST)
    drive.laser, drive.local.crates = True, [(2.5, 1.2, 0.05)]
    drive.local.patience, drive.local.fault = math.inf, Fault.BLOCKED
    assert drive.goto(EAST, 30.0).state is State.REACHED


def test_the_robot_drives_through_a_door_that_reopens() -> None:
    drive = Drive(floor((2.4, 0.0, 2.6, 0.6), (2.4, 1.4, 2.6, 5.0)), WEST)
    drive.laser = True
    drive.local.crates = [LOW_DOOR]
    drive.planner.goal(EAST)
    status = drive.until(State.WAITING, 30.0)
    drive.run(8.0)
    status = drive.planner.status
    assert status.state is State.WAITING
    assert "laser" in status.reason
    drive.local.crates = []
    assert drive.run(60.0).state is State.REACHED


def test_a_door_that_stays_closed_aborts_the_goal_with_a_reason() -> None:
    drive = Drive(floor((2.4, 0.0, 2.6, 0.6), (2.4, 1.4, 2.6, 5.0)), WEST)
    drive.laser = True
    drive.local.crates = [LOW_DOOR]
    status = drive.goto(EAST, 200.0)
    assert (status.state, status.fault) == (State.ABORTED, Fault.BLOCKED)
    assert drive.local.state is State.IDLE


def test_the_robot_waits_in_an_area_with_on_obstacle_wait() -> None:
    zone = Zone(area(1.5, 0.0, 3.5, 5.0), AreaBehavior(on_obstacle="wait"))
    drive = Drive(floor(*ROOMS), WEST, zones=[zone])
    drive.laser = True
    drive.local.crates = [LOW_DOOR]
    drive.local.patience = 60.0
    drive.goto(EAST, 40.0)
    assert drive.planner.status.state is State.WAITING
    assert max(pose.y for pose in drive.track) < 1.5
    drive.local.crates = []
    assert drive.run(30.0).state is State.REACHED


SLOW = Zone(area(2.0, 0.0, 3.0, 5.0), AreaBehavior(max_speed=0.1))


@pytest.mark.parametrize(
    ("wall", "crates", "limits", "zones", "skipped"),
    [
        ((), (), {}, (), True),
        (((2.0, 0.0, 2.2, 2.2),), (), {}, (), False),
        ((), ((2.5, 1.7, 0.2),), {}, (), False),
        ((), (), {"max_lin_speed": 0.1}, (), False),
        ((), (), {}, (SLOW,), False),
    ],
    ids=["free", "a wall is between", "an obstacle is between", "other limits", "a slow area is between"],
)
def test_a_waypoint_on_which_a_person_stands_is_skipped(
    wall: Any, crates: Any, limits: Any, zones: Any, skipped: bool
) -> None:
    drive = Drive(floor(*wall), WEST, SETTINGS.model_copy(update={"recoveries": 0}), zones=list(zones))
    drive.local.patience, drive.laser = 60.0, True
    drive.local.crates, drive.local.fault = [(1.0, 3.0, 0.4), *crates], Fault.BLOCKED
    drive.planner.goal(EAST)
    drive.run(0.2)
    task = drive.planner.task
    assert task is not None
    corner = Waypoint(Pose(1.0, 3.0, 0.0), Constraints(tolerance_lin=0.1, heading=False, through=True, **limits))
    goal = Waypoint(EAST, Constraints(tolerance_lin=0.1))
    task.waypoints, task.index = (corner, goal), 0
    drive.local.send(corner.pose, corner.constraints)
    drive.run(20.0)
    assert (drive.local.sent[-1][0] == EAST) == skipped


@pytest.mark.parametrize(("blind", "cut"), [("", True), ("the laser is silent", False)])
def test_a_corner_is_cut_if_the_robot_can_drive_straight_to_the_next_waypoint(blind: str, cut: bool) -> None:
    drive = Drive(floor(), WEST)
    drive.planner.blind = blind
    drive.planner.goal(EAST)
    drive.run(0.2)
    task = drive.planner.task
    assert task is not None
    corner = Waypoint(Pose(2.5, 1.5, 0.0), Constraints(tolerance_lin=0.05, heading=False, through=True))
    task.waypoints, task.index = (corner, Waypoint(EAST, Constraints(tolerance_lin=0.1))), 0
    drive.local.send(corner.pose, corner.constraints)
    assert drive.run(20.0).state is State.REACHED
    assert (min(pose.distance(corner.pose) for pose in drive.track) > 0.15) == cut


def test_a_robot_beside_its_path_that_waits_for_a_door_frame_gets_another_path() -> None:
    drive = Drive(floor(*ROOMS), Pose(1.8, 0.75, 0.0))
    drive.planner.goal(EAST)
    drive.run(0.2)
    task = drive.planner.task
    assert task is not None
    waypoint = Waypoint(Pose(3.2, 0.75, 0.0), Constraints(tolerance_lin=0.1, heading=False, through=True))
    task.waypoints, task.index = (waypoint, Waypoint(EAST, Constraints(tolerance_lin=0.1))), 0
    drive.local.crates, drive.local.patience, drive.local.fault = [(2.5, 0.55, 0.05)], math.inf, Fault.BLOCKED
    drive.local.send(waypoint.pose, waypoint.constraints)
    drive.until(State.WAITING, 10.0)
    assert drive.run(30.0).state is State.REACHED


def test_a_changed_map_triggers_a_new_plan_or_aborts_the_goal() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    sent = len(drive.local.sent)
    drive.use(floor((0.5, 3.0, 1.0, 3.5)))
    drive.tick()
    assert len(drive.local.sent) == sent, "the path is still free"
    swapped = floor(*ROOMS[1:], (2.4, 0.0, 2.6, 1.4))
    drive.use(swapped)
    drive.tick()
    assert len(drive.local.sent) == sent + 1
    drive.track.clear()
    assert drive.run(60.0).state is State.REACHED
    assert least_room(drive, swapped) > KEPT
    drive.goto(WEST, seconds=1.0)
    drive.use(floor(name="other"))
    status = drive.tick()
    assert (status.state, status.fault) == (State.ABORTED, Fault.MAP_CHANGED)
    assert "other" in status.reason
    assert drive.local.state is State.IDLE


def test_a_keep_out_area_over_the_robot_and_its_goal_ends_the_drive() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    corners = [Vec2D(-1.0, -1.0), Vec2D(9.0, -1.0), Vec2D(9.0, 9.0), Vec2D(-1.0, 9.0)]
    drive.zones = [Zone(Map2DArea("floor", corners), AreaBehavior(keep_out=True))]
    drive.use(floor())
    status = drive.tick()
    assert (status.state, status.fault) == (State.ABORTED, Fault.GOAL_OCCUPIED)
    assert "in a keep-out area" in status.reason
    assert drive.local.state is State.IDLE


def test_a_robot_leaves_a_keep_out_area_that_is_drawn_around_it() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    x, y = drive.local.pose[:2]
    corners = [Vec2D(x - 0.4, y - 0.4), Vec2D(x + 0.4, y - 0.4), Vec2D(x + 0.4, y + 0.4), Vec2D(x - 0.4, y + 0.4)]
    drive.zones = [Zone(Map2DArea("floor", corners), AreaBehavior(keep_out=True))]
    drive.use(floor())
    assert drive.run(60.0).state is State.REACHED


def test_a_goal_on_another_map_is_reached_over_a_link() -> None:
    atlas = Two(LIFT)
    drive = Drive(None, WEST, atlas=atlas)
    drive.planner.use_map(atlas.maps["floor"])
    goal = Pose(1.0, 4.0, 0.5)
    drive.planner.goal(goal, "up", now=drive.now)
    status = drive.until(State.WAITING)
    assert "waiting for the map to change to up" in status.reason
    assert drive.local.pose.distance(LIFT.first.pose) < 0.05
    drive.run(20.0)
    drive.planner.use_map(None)  # no map between the two maps
    drive.tick()
    drive.planner.use_map(atlas.maps["up"])
    drive.local.pose = Pose(0.5, 0.5, 0.0)  # the robot is not localized on the new map yet
    assert "localized near lift 1" in drive.tick().reason
    drive.local.pose = Pose(4.1, 4.0, 3.0)
    assert drive.run(60.0).state is State.REACHED
    assert drive.local.pose[:3] == goal[:3]


def test_a_goal_is_aborted_if_the_map_never_changes() -> None:
    atlas = Two(LIFT)
    drive = Drive(None, Pose(4.0, 3.0, 0.0), atlas=atlas)
    drive.planner.use_map(atlas.maps["floor"])
    drive.planner.goal(Pose(1.0, 4.0, 0.0), "up")
    status = drive.run(400.0)
    assert (status.state, status.fault) == (State.ABORTED, Fault.MAP_CHANGED)


@pytest.mark.parametrize("seed", range(4))
def test_random_goals_are_reached_without_entering_keep_out_areas(seed: int) -> None:
    random = np.random.default_rng(seed)
    grid = floor(*ROOMS)
    paint(grid, (0.8, 1.8, 1.6, 2.4), MapFlag.KEEP_OUT)
    zone = Zone(area(3.0, 2.0, 4.2, 2.6), AreaBehavior(keep_out=True))
    drive = Drive(grid, WEST, zones=[zone])
    ground = Ground(grid, 0.2, zones=[zone])
    free = np.argwhere(ground.weights)
    for row, column in free[random.integers(len(free), size=6)]:
        x, y = grid.centers_of((column, row))
        status = drive.goto(Pose(float(x), float(y), random.uniform(-math.pi, math.pi)))
        assert status.state is State.REACHED, status
    assert least_room(drive, grid) > KEPT
