"""The planner without laser, pose, map or navigator: its reasons for waiting, and when it aborts the goal."""

from __future__ import annotations

import math
from typing import Any

import pytest

from navigation.goals import MapPlace
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground
from navigation.robot_path_planner.planner import PathPlanner
from navigation.status import Fault, State
from tests.peers.navigation.floors import EAST, KEPT, ROOMS, WEST, Drive, floor, least_room


def test_a_local_navigator_that_paused_itself_is_resumed() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    drive.local.state, drive.local.reason = State.PAUSED, "deadlock: no progress for 20 s"
    drive.run(5.0)
    assert drive.planner.status[:2] == (State.PAUSED, "deadlock: no progress for 20 s")
    drive.planner.resume()
    assert drive.run(30.0).state is State.REACHED


def test_without_a_laser_five_attempts_end_with_the_navigators_reason() -> None:
    drive = Drive(floor(), WEST)
    drive.local.crates = [(2.5, 1.0, 0.4)]
    drive.local.patience = 0.5
    status = drive.goto(EAST, 200.0)
    assert (status.state, status.fault) == (State.ABORTED, Fault.BLOCKED)
    assert status.reason == "the obstacle did not go away; aborted after 5 more attempts"


@pytest.mark.parametrize("fault", [Fault.NO_LASER, Fault.NOT_LOCALIZED, Fault.BASE_STANDS])
def test_faults_of_the_robot_are_waited_for_and_then_abort_the_goal(fault: Fault) -> None:
    """The local navigator decides how long to wait, and gives the reason; the planner tries no other path."""
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


def test_a_localization_jump_triggers_a_new_plan() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    drive.goto(EAST, seconds=2.0)
    sent = len(drive.local.sent)
    drive.local.pose = Pose(1.0, 4.0, 0.0)
    drive.tick()
    assert len(drive.local.sent) == sent + 1
    assert drive.run(60.0).state is State.REACHED
    assert least_room(drive, floor(*ROOMS)) > KEPT


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


def test_the_robot_stops_when_its_map_is_closed() -> None:
    drive = Drive(floor(*ROOMS), WEST)
    drive.goto(EAST, 2.0)
    ground = drive.planner.ground
    assert ground is not None
    drive.planner.use_map(Ground(ground.grid, ground.radius, closed="an area cannot be read"))
    assert drive.run(1.0) == (State.ABORTED, "an area cannot be read", Fault.NO_MAP)
    assert drive.local.state is State.IDLE
    assert drive.goto(EAST, 1.0) == (State.ABORTED, "an area cannot be read", Fault.NO_MAP)


def test_a_goal_may_end_while_another_thread_reads_it() -> None:
    drive = Drive(floor(), WEST)
    drive.goto(EAST, seconds=2.0)
    task: Any = drive.planner.task

    class Ending(PathPlanner):
        @property  # type: ignore[override]
        def task(self) -> Any:
            return self.tasks.pop()

        @task.setter
        def task(self, _task: Any) -> None:
            self.tasks = [None, task]

    assert Ending().target == task.goal
    assert Ending().waypoints == task.waypoints
