"""The planner in lock-step with a robot that drives straight."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError

from bridge.config.sections.obstacles import ObstacleSection
from navigation.goals import MapPlace
from navigation.pose import Pose, wrapped
from navigation.robot_path_planner.ground import Ground, Zone
from navigation.robot_path_planner.section import RobotPathPlannerSection
from navigation.status import Fault, State
from tests.navigation.robot_path_planner.test_path import LIFT, Two, area
from tests.peers.navigation.floors import ROOMS, SETTINGS, Drive, floor, paint
from yarp_compat.dev.extras import AreaBehavior
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

WEST, EAST = Pose(1.0, 1.0, 0.0), Pose(4.0, 1.0, 1.0)
KEPT = 0.14
"""Meters kept free: the radius is 0.2 m, but waypoints are passed within 0.1 m, which cuts corners by 0.05 m."""
LOW_DOOR = (2.5, 1.0, 0.5)


def room(drive: Drive, grid: MapGrid2D) -> float:
    """Return the smallest distance of the robot to obstacles on its track, meters."""
    ground = Ground(grid, 0.2, zones=drive.zones)
    columns, rows = grid.cells_at([pose[:2] for pose in drive.track]).T
    return float(ground.room[rows, columns].min())


def test_the_robot_reaches_the_goal_with_its_heading_and_keeps_clear_of_walls() -> None:
    grid = floor(*ROOMS)
    drive = Drive(grid, Pose(1.0, 2.5, 0.0))
    status = drive.goto(EAST)
    assert status == (State.REACHED, "goal reached", Fault.NONE)
    assert drive.local.pose[:3] == EAST[:3]
    assert room(drive, grid) > KEPT
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
    assert headed == [WEST[:3]], "only the last one is reached with its heading"
    passed = [sent for sent in drive.local.sent if sent[0][:2] in (EAST[:2], north.pose[:2])]
    assert [sent[0][:2] for sent in passed] == [EAST[:2], north.pose[:2]]
    assert all(sent[1].through for sent in passed)
    assert all(min(pose.distance(place) for pose in drive.track) <= 0.1 for place in (EAST, north.pose))
    assert not drive.local.canceled


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
    """Another thread brakes while the current step plans."""
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


def test_a_local_navigator_that_paused_itself_is_resumed() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    drive.local.state, drive.local.reason = State.PAUSED, "deadlock: no progress for 20 s"
    drive.run(5.0)
    assert drive.planner.status[:2] == (State.PAUSED, "deadlock: no progress for 20 s")
    drive.planner.resume()
    assert drive.run(30.0).state is State.REACHED


@pytest.mark.parametrize("patience", [5.0, math.inf])
def test_a_door_that_closes_during_the_drive_is_bypassed(patience: float) -> None:
    """Once the local navigator fails, or earlier if it waits for long."""
    drive = Drive(floor(*ROOMS), WEST)
    drive.laser = True
    drive.local.crates, drive.local.patience = [LOW_DOOR], patience
    assert drive.goto(EAST).state is State.REACHED
    assert max(pose.y for pose in drive.track) > 3.5
    assert drive.now < 50


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


def test_without_a_laser_five_attempts_end_with_the_navigators_reason() -> None:
    drive = Drive(floor(), WEST)
    drive.local.crates = [(2.5, 1.0, 0.4)]
    drive.local.patience = 0.5
    status = drive.goto(EAST, 200.0)
    assert (status.state, status.fault) == (State.ABORTED, Fault.BLOCKED)
    assert status.reason == "the obstacle did not go away; aborted after 5 more attempts"


@pytest.mark.parametrize("fault", [Fault.NO_LASER, Fault.NOT_LOCALIZED, Fault.BASE_STANDS])
def test_faults_of_the_robot_are_waited_for_and_then_abort_the_goal(fault: Fault) -> None:
    """The local navigator decides how long, and gives the reason; the planner tries no other path."""
    drive = Drive(floor(*ROOMS), WEST)
    drive.goto(EAST, 2.0)
    drive.local.patience = math.inf
    drive.local.crates, drive.local.fault = [(*drive.local.sent[-1][0][:2], 9.0)], fault
    drive.run(30.0)
    assert drive.planner.status == (State.WAITING, "obstacles are detected", fault)
    drive.local.patience, sent = 5.0, len(drive.local.sent)
    status = drive.run(1.0)
    assert status == (State.ABORTED, "the obstacle did not go away", fault)
    assert len(drive.local.sent) == sent


def test_the_robot_drives_on_when_its_laser_returns() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    drive.goto(EAST, 2.0)
    drive.local.crates, drive.local.fault = [(*drive.local.sent[-1][0][:2], 9.0)], Fault.NO_LASER
    drive.local.patience = math.inf
    drive.run(20.0)
    assert drive.planner.status.state is State.WAITING
    drive.local.crates, drive.local.fault = [], Fault.NONE
    assert drive.run(60.0) == (State.REACHED, "goal reached", Fault.NONE)


def test_a_pose_lost_with_the_laser_is_reported_as_the_lasers_fault() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    drive.goto(EAST, 2.0)
    drive.lost = "localization status is 'error'"
    drive.run(0.5)
    assert drive.planner.status.fault is Fault.NOT_LOCALIZED
    drive.planner.blind = "the laser is silent"
    drive.run(0.5)
    assert drive.planner.status == (State.WAITING, "the laser is silent", Fault.NO_LASER)
    assert drive.run(100.0) == (State.ABORTED, "the laser is silent", Fault.NO_LASER)


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


def test_a_localization_jump_triggers_a_new_plan() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    drive.goto(EAST, seconds=2.0)
    sent = len(drive.local.sent)
    drive.local.pose = Pose(1.0, 4.0, 0.0)
    drive.tick()
    assert len(drive.local.sent) == sent + 1
    assert drive.run(60.0).state is State.REACHED
    assert room(drive, floor(*ROOMS)) > KEPT


def test_lost_localization_stops_the_robot_until_it_returns() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    drive.lost = "tf is stale"
    drive.run(1.0)
    assert drive.planner.status.state is State.WAITING
    assert "tf is stale" in drive.planner.status.reason
    assert drive.local.state is State.IDLE
    drive.lost = ""
    assert drive.run(30.0).state is State.REACHED
    drive.lost = "tf is stale"
    status = drive.goto(WEST)
    assert (status.state, status.fault) == (State.ABORTED, Fault.NOT_LOCALIZED)


def test_a_missing_map_aborts_the_goal() -> None:
    status = Drive(None, WEST).goto(EAST)
    assert (status.state, status.fault) == (State.ABORTED, Fault.NO_MAP)
    assert "send the goal again" in status.reason


def test_an_early_goal_waits_and_reports_what_is_missing() -> None:
    drive = Drive(None, WEST)
    drive.lost, drive.local.state, drive.local.reason = "no frame yet", State.ERROR, "no server"
    drive.goto(EAST, seconds=20.0)
    assert drive.planner.status == (
        State.PREPARING,
        "the robot's pose is unknown: no frame yet",
        Fault.NOT_LOCALIZED,
    )
    drive.lost = ""
    drive.run(10.0)
    assert drive.planner.status == (State.PREPARING, "waiting for a map", Fault.NO_MAP)
    drive.use(floor())
    drive.run(20.0)
    assert drive.planner.status == (State.PREPARING, "no server", Fault.NO_NAVIGATOR)
    assert drive.local.pose == WEST, "the robot does not drive"
    drive.local.state = State.IDLE
    assert drive.run(30.0).state is State.REACHED


def test_an_early_goal_is_canceled_immediately() -> None:
    drive = Drive(None, WEST)
    drive.goto(EAST, seconds=3.0)
    drive.planner.cancel()
    assert drive.tick().state is State.IDLE
    drive.use(floor())
    drive.run(1.0)
    assert drive.local.pose == WEST
    assert not drive.local.sent


def test_goals_received_before_any_map_are_on_the_first_map() -> None:
    drive = Drive(None, WEST)
    drive.planner.goal(EAST, now=drive.now, then=[MapPlace("", WEST)])
    drive.run(1.0)
    drive.use(floor())
    assert drive.run(60.0).state is State.REACHED
    assert drive.local.pose[:2] == WEST[:2]


def test_removing_the_map_aborts_the_goal() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    drive.planner.use_map(None)
    status = drive.run(1.0)
    assert (status.state, status.fault) == (State.ABORTED, Fault.NO_MAP)
    assert drive.local.state is State.IDLE


def test_an_unavailable_navigator_is_waited_for() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    drive.local.state, drive.local.reason = State.ERROR, "no server"
    drive.run(3.0)
    assert drive.planner.status[:2] == (State.WAITING, "no server")
    drive.local.state = State.IDLE
    assert drive.run(30.0).state is State.REACHED
    drive.local.state = State.ERROR
    status = drive.goto(WEST)
    assert (status.state, status.fault) == (State.ABORTED, Fault.NO_NAVIGATOR)


def test_a_navigator_stopped_by_another_client_aborts_the_goal() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    drive.local.state, drive.local.reason = State.IDLE, "canceled"
    status = drive.tick()
    assert (status.state, status.fault) == (State.ABORTED, Fault.OTHER)
    assert "canceled" in status.reason


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
    assert room(drive, swapped) > KEPT
    drive.goto(WEST, seconds=1.0)
    drive.use(floor(name="other"))
    status = drive.tick()
    assert (status.state, status.fault) == (State.ABORTED, Fault.MAP_CHANGED)
    assert "other" in status.reason
    assert drive.local.state is State.IDLE


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
    drive.local.pose = Pose(0.5, 0.5, 0.0)  # not localized on the new map yet
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
    assert room(drive, grid) > KEPT


def cells(left: float, bottom: float, right: float, top: float) -> np.ndarray:
    """Return the centers of a layer's cells in a rectangle, (n, 2) meters."""
    xs, ys = np.meshgrid(np.arange(left + 0.025, right, 0.05), np.arange(bottom + 0.025, top, 0.05))
    return np.stack((xs.ravel(), ys.ravel()), axis=1)


LAYER = ObstacleSection(topic="/layer")
TABLE = (1.5, 0.5, 2.2, 1.6)


def apart(drive: Drive, box: tuple[float, float, float, float]) -> float:
    """Return the smallest distance of the robot's center to a rectangle on its track, meters."""
    track = np.array([pose[:2] for pose in drive.track])
    offsets = np.maximum(np.maximum(np.subtract(box[:2], track), track - box[2:]), 0.0)
    return float(np.hypot(*offsets.T).min())


def test_the_first_path_avoids_a_layer_without_waiting() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    drive.planner.layer("/layer", cells(*TABLE))
    assert drive.goto(EAST).state is State.REACHED
    assert apart(drive, TABLE) > KEPT
    assert drive.planner.recoveries == 0
    without = Drive(floor(*ROOMS), WEST)
    without.goto(EAST)
    assert apart(without, TABLE) == 0.0


def test_a_layer_that_blocks_the_path_triggers_a_new_plan() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    drive.goto(EAST, seconds=0.5)
    drive.planner.layer("/layer", cells(*TABLE))
    assert drive.run(60.0).state is State.REACHED
    assert apart(drive, TABLE) > KEPT
    assert drive.planner.recoveries == 0


def test_the_robot_waits_while_a_layer_blocks_every_path() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    drive.planner.layer("/layer", cells(2.3, 0.0, 2.5, 5.0))
    drive.planner.goal(EAST, now=drive.now)
    assert "or a layer block every path" in drive.until(State.WAITING).reason
    drive.planner.layer("/layer", np.empty((0, 2)))
    assert drive.run(60.0).state is State.REACHED


def test_mapped_walls_in_a_layer_do_not_close_doors() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    drive.planner.layer("/layer", np.concatenate([cells(2.35, 0.0, 2.65, 0.65), cells(2.35, 1.35, 2.65, 3.6)]))
    drive.goto(EAST)
    assert min(math.dist(pose[:2], LOW_DOOR[:2]) for pose in drive.track) < 0.3


def test_the_robot_does_not_start_before_its_layer_arrives() -> None:
    settings = SETTINGS.model_copy(update={"obstacles": (LAYER,), "max_waiting_time": 5.0})
    drive = Drive(floor(*ROOMS), WEST, settings)
    drive.planner.goal(EAST, now=drive.now)
    assert drive.until(State.PREPARING).reason == "waiting for layer /layer"
    drive.planner.layer("/layer", np.array([(-3.0, 99.0)]))  # off the map
    assert drive.run(60.0).state is State.REACHED
    late = Drive(floor(*ROOMS), WEST, settings)
    assert late.goto(EAST).fault is Fault.NO_MAP
    assert not late.local.sent


def test_a_silent_layer_stops_the_robot_until_it_is_received_again() -> None:
    settings = SETTINGS.model_copy(update={"max_waiting_time": 5.0})
    drive = Drive(floor(*ROOMS), WEST, settings)
    drive.planner.layer("/layer", np.empty((0, 2)))
    drive.goto(EAST, seconds=0.5)
    drive.planner.silent = "the layer /layer is silent"
    drive.run(4.0)
    assert drive.planner.status == (State.WAITING, "the layer /layer is silent", Fault.NO_LASER)
    assert drive.local.state is State.IDLE
    assert drive.local.canceled == 1
    drive.planner.layer("/layer", cells(*TABLE))
    drive.planner.silent = ""
    drive.run(0.5)
    drive.planner.silent = "the layer /layer is silent"
    drive.run(4.0)  # each silence has its own time-out
    drive.planner.silent = ""
    assert drive.run(60.0).state is State.REACHED
    assert apart(drive, TABLE) > KEPT


def test_a_layer_that_stays_silent_aborts_the_goal_and_the_previous_drive() -> None:
    drive = Drive(floor(*ROOMS), WEST, SETTINGS.model_copy(update={"max_waiting_time": 5.0}))
    drive.goto(EAST, seconds=0.5)
    drive.planner.silent = "the layer /layer is silent"
    drive.planner.goal(WEST, now=drive.now)
    drive.tick()
    assert (drive.planner.status.state, drive.local.state) == (State.PREPARING, State.IDLE)
    status = drive.run(60.0)
    assert (status.state, status.fault) == (State.ABORTED, Fault.NO_LASER)
    assert status.reason.startswith("the layer /layer is silent, for 5 s now: send the goal again")


def test_layers_survive_a_map_change() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    drive.planner.layer("/layer", cells(*TABLE))
    drive.use(floor(*ROOMS))
    assert drive.goto(EAST).state is State.REACHED
    assert apart(drive, TABLE) > KEPT


def test_the_planner_rejects_clouds() -> None:
    with pytest.raises(ValidationError, match="/points is a cloud"):
        RobotPathPlannerSection(obstacles=({"topic": "/points", "type": "cloud"},))
