"""Layers of obstacles: which paths the planner takes, and when the robot waits or stops."""

from __future__ import annotations

import math

import numpy as np

from bridge.config.sections.obstacles import ObstacleSection
from navigation.robot_path_planner.section import RobotPathPlannerSection
from navigation.status import Fault, State
from tests.peers.navigation.floors import EAST, KEPT, LOW_DOOR, ROOMS, SETTINGS, WEST, Drive, floor


def cells(left: float, bottom: float, right: float, top: float) -> np.ndarray:
    """Return the centers of a layer's cells in a rectangle, (n, 2) meters."""
    xs, ys = np.meshgrid(np.arange(left + 0.025, right, 0.05), np.arange(bottom + 0.025, top, 0.05))
    return np.stack((xs.ravel(), ys.ravel()), axis=1)


LAYER = ObstacleSection(topic="/layer")
TABLE = (1.5, 0.5, 2.2, 1.6)


def apart(drive: Drive, box: tuple[float, float, float, float]) -> float:
    """Return the smallest distance between the robot's center and a rectangle during the drive, meters."""
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
    section = RobotPathPlannerSection(obstacles=({"topic": "/points", "type": "cloud"},))
    [(path, text)] = section.mistakes(None)
    assert path == ("obstacles", 0)
    assert text.startswith("/points is a cloud")
