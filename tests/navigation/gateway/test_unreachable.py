"""The planner's side loses its worker while the robot drives: no answer claims that the robot stands before it does."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from bridge.messages.actions import GoalState
from bridge.modules import worker as modules_worker
from navigation.gateway import gateway as gateway_module
from navigation.gateway import motion
from navigation.gateway.foreign import GoalMark
from navigation.gateway.machine import PlannerState
from navigation.status import Fault, State
from tests.peers.navigation.driving import MAY_MOVE, Scene, scene
from tests.peers.navigation.gateway import ClientGoal, Rig, patient, pose
from tests.support.wait import until
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.inavigation2d import INavigation2DMsgs, NavigationStatusEnum

PLANNER = "move_base"
PLANNERS_OWN = f"/planner/{PLANNER}/navigate_to_pose"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with Rig(tmp_path_factory.mktemp("unreachable"), planner=PLANNER) as started:
        started.planners.pop("robot_goto").close()
        yield started


@pytest.fixture
def robot(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    # on a busy machine odometry is late, and then a second without velocities would show that the moving base stands
    monkeypatch.setattr(motion, "SILENCE_SECONDS", 60.0)
    with scene(rig, PLANNER, lists=True) as started:
        yield started


@pytest.fixture
def unreachable(robot: Scene) -> Scene:
    """The robot drives, and its planner has become unreachable."""
    robot.drive()
    robot.planner.withdraw()
    status = robot.rig.state(State.MOVING, f"{PLANNER} is not available; waiting for it; {MAY_MOVE}")
    assert status["error_code"] == Fault.NO_NAVIGATOR
    return robot


# -- a pause -----------------------------------------------------------------------------------------------------------


def test_a_pause_is_confirmed_by_the_base_and_kept_while_the_planner_is_unreachable(unreachable: Scene) -> None:
    robot, rig = unreachable, unreachable.rig
    begin = len(rig.statuses)
    answer = rig.ask("pause")
    assert not answer["success"]
    assert f"{MAY_MOVE}: the planner {PLANNER} is not available" in answer["message"]
    assert rig.state(State.MOVING, f"it was paused; {MAY_MOVE}")["error_code"] == Fault.MAY_MOVE
    assert State.PAUSED not in robot.states(begin)
    assert all("it was paused" in status["reason"] for status in rig.statuses[begin:])
    assert rig.gateway.held, "the planner's velocities are held meanwhile"
    robot.base.speed = 0.0
    rig.state(State.PAUSED)
    with patient():  # odometry may be late
        assert rig.ask("pause")["success"]
    robot.moves()  # the planner, which has not been asked yet, ends a recovery and drives on
    rig.state(State.MOVING, "it was paused")
    robot.planner.serve()
    until(lambda: not robot.planner.executes(robot.planner.goals[0]), "the planner is asked to stop once it is back")
    robot.base.speed = 0.0
    rig.state(State.PAUSED)
    assert len(robot.planner.goals) == 1
    assert rig.ask("resume")["success"]
    robot.goal(2)
    rig.state(State.MOVING)


def test_yarps_pause_is_not_ok_before_the_base_stands(unreachable: Scene) -> None:
    with ServiceClient(INavigation2DMsgs, "/navigationServer/rpc", naming=unreachable.rig.names, timeout=20) as started:
        client = started.remote
        assert not client.suspend_navigation_RPC(1000.0)
        assert client.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_moving
        unreachable.base.speed = 0.0
        unreachable.rig.state(State.PAUSED)
        with patient():  # odometry may be late
            assert client.suspend_navigation_RPC(1000.0)
        paused = NavigationStatusEnum.navigation_status_paused  # but not while odometry is late
        until(lambda: client.get_navigation_status_RPC()[1] is paused, "the status is paused")


# -- goals of the planner's own clients --------------------------------------------------------------------------------


@pytest.mark.parametrize("first", ["status", "send_goal"])
def test_a_goal_of_the_planners_own_client_is_never_idle_while_the_base_moves(robot: Scene, first: str) -> None:
    """This holds whichever part of the action leaves the hub first, the list's publisher or a service."""
    rig, planner = robot.rig, robot.planner
    planner.set(b"a foreign goal..")
    planner.tell()
    rig.state(State.MOVING, "its own client")
    begin = len(rig.statuses)
    planner.close_part(first)
    rig.state(State.MOVING, MAY_MOVE)
    planner.withdraw()
    rig.state(State.MOVING, f"the planner {PLANNER} is not available; {MAY_MOVE}")
    planner.serve()
    until(lambda: rig.statuses[-1]["error_code"] == 0, "the planner is back, and its goal continues")
    assert robot.states(begin - 1) == {State.MOVING}


def test_a_new_goal_while_the_old_one_may_still_drive_is_reported_as_moving(unreachable: Scene) -> None:
    robot, rig = unreachable, unreachable.rig
    begin = len(rig.statuses)
    client_goal = ClientGoal(rig.client, pose(9.0))
    status = robot.reported(client_goal)
    assert status["state"] == State.MOVING
    assert status["reason"] == f"the planner {PLANNER} is not available; waiting for it; {MAY_MOVE}"
    assert robot.states(begin) == {State.MOVING}
    robot.base.speed = 0.0
    rig.state(State.MOVING, "the robot stands, and may move again")
    robot.moves()
    rig.state(State.MOVING, MAY_MOVE)
    robot.planner.serve()
    robot.goal(2)
    until(lambda: rig.statuses[-1]["reason"] == "", "the planner has the new goal")
    assert robot.states(begin) == {State.MOVING}
    robot.planner.end(GoalState.SUCCEEDED)
    assert client_goal.end() == ("SUCCEEDED", "")


def test_a_new_goal_that_is_canceled_while_the_old_one_may_drive_ends_when_the_base_stands(unreachable: Scene) -> None:
    robot, rig = unreachable, unreachable.rig
    client_goal = ClientGoal(rig.client, pose(9.0))
    robot.reported(client_goal)
    client_goal.cancel()
    rig.state(State.MOVING, MAY_MOVE)
    until(lambda: rig.gateway.state().fault == Fault.MAY_MOVE, "the stop is late")
    assert not client_goal.ended
    robot.base.speed = 0.0
    assert client_goal.end()[0] == "CANCELED"


def test_a_new_goal_without_odometry_counts_the_old_one_as_driving(unreachable: Scene) -> None:
    robot, rig = unreachable, unreachable.rig
    robot.base.silent = True
    until(lambda: not rig.gateway.motion.known, "odometry is missing")
    status = robot.reported(ClientGoal(rig.client, pose(9.0)))
    assert status["state"] == State.MOVING
    assert MAY_MOVE in status["reason"]


# -- another gateway ---------------------------------------------------------------------------------------------------


def orphan(robot: Scene) -> bytes:
    """Let the planner execute a goal from an earlier run of the gateway, and return the goal's ID."""
    goal = GoalMark("here").new_id()
    robot.planner.set(goal)
    return goal


@pytest.mark.parametrize("whose", ["own", "foreign"])
def test_a_gateway_that_starts_while_the_planner_is_unreachable_is_not_idle(
    robot: Scene, monkeypatch: pytest.MonkeyPatch, whose: str
) -> None:
    rig = robot.rig
    monkeypatch.setattr(gateway_module, "ANSWER_SECONDS", 0.5)
    robot.planner.withdraw()
    goal = orphan(robot) if whose == "own" else b"a foreign goal.."
    robot.planner.set(goal)
    robot.restart()
    status = rig.state(State.MOVING, f"it is not known whether {PLANNER} has a goal: it is not available; {MAY_MOVE}")
    assert status["error_code"] == Fault.MAY_MOVE
    until(lambda: rig.gateway.link.state is PlannerState.UNKNOWN, "the planner's side has not reported")
    answer = rig.ask("stop")
    assert not answer["success"]
    assert f"{MAY_MOVE}: the planner {PLANNER} is not available" in answer["message"]
    robot.planner.lists = robot.planner.cancels = False  # the action's parts are back before its goal list
    robot.planner.serve()
    until(lambda: rig.gateway.link.state is PlannerState.UNREPORTED, "the planner is found")
    answer = rig.ask("stop")
    assert not answer["success"]
    assert f"{PLANNER} has not reported its goals yet" in answer["message"]
    begin = len(rig.statuses)
    robot.planner.cancels = True
    robot.planner.tell()
    until(lambda: not robot.planner.executes(goal), "the goal is canceled once it is reported")
    assert not rig.ask("stop")["success"], "the base still moves"
    assert robot.states(begin - 1) == {State.MOVING}
    robot.base.speed = 0.0
    until(lambda: rig.ask("stop")["success"], "the stop is confirmed")


def test_the_first_status_of_a_gateway_is_not_idle_while_the_base_moves(robot: Scene) -> None:
    robot.planner.withdraw()
    begin = robot.restart()
    robot.rig.state(State.MOVING, f"it is not known whether {PLANNER} has a goal")
    assert State.IDLE not in robot.states(begin)


def test_a_goal_from_before_a_restart_is_canceled_and_not_reported_as_foreign(robot: Scene) -> None:
    rig = robot.rig
    robot.planner.cancels = False
    goal = orphan(robot)
    robot.planner.tell()
    status = rig.state(State.MOVING, f"stopping: {PLANNER} still has a goal from before the gateway was restarted")
    assert status["error_code"] == Fault.MAY_MOVE
    until(
        lambda: robot.planner.canceled.count(goal) > 1,
        "cancellation is requested again until the goal list shows the goal's end",
    )
    assert rig.module.status().goals_of_others == 0
    assert not any("its own client" in status["reason"] for status in rig.statuses if "before" in status["reason"])
    robot.planner.cancel(goal)
    robot.base.speed = 0.0
    rig.state(State.IDLE)


def test_a_goal_of_another_daemons_gateway_is_foreign(robot: Scene) -> None:
    goal = GoalMark("there").new_id()
    robot.planner.set(goal)
    robot.planner.tell()
    robot.rig.state(State.MOVING, "its own client")
    assert robot.planner.executes(goal)
    assert not robot.planner.canceled


# -- the end of the gateway --------------------------------------------------------------------------------------------


@pytest.fixture
def stopping(robot: Scene) -> Iterator[threading.Thread]:
    """A thread that stops the gateway once the test starts the thread; the gateway runs again afterwards."""
    running = robot.rig.worker.running("gateway")
    thread = threading.Thread(target=running.stop)
    yield thread
    thread.join()
    running.start()


def test_a_gateway_that_is_stopped_ends_its_goal_once_the_base_stands(
    robot: Scene, stopping: threading.Thread, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGTERM to the daemon: if the goal ended earlier, the client could assume that the robot stands."""
    monkeypatch.setattr(modules_worker, "WIND_DOWN_SECONDS", 60.0)
    monkeypatch.setattr(gateway_module, "ANSWER_SECONDS", 60.0)  # the gateway ends before, if the base is late to stand
    client_goal = robot.drive()
    robot.planner.cancels = False
    stopping.start()
    until(lambda: robot.planner.canceled, "the planner receives a cancel request")
    moving = robot.rig.state(State.MOVING, f"the gateway is shutting down; {MAY_MOVE}")
    assert moving["error_code"] == Fault.MAY_MOVE
    assert not client_goal.ended
    robot.base.speed = 0.0
    status, reason = client_goal.end()
    assert status == "CANCELED"
    assert "the gateway is shutting down" in reason
    assert "the base stands" in reason


def test_a_gateway_that_is_stopped_with_a_moving_base_ends_its_goal_as_aborted(
    robot: Scene, stopping: threading.Thread, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(modules_worker, "WIND_DOWN_SECONDS", 0.2)
    monkeypatch.setattr(modules_worker, "STOP_SECONDS", 60.0)  # the module's thread may begin late to stop it
    client_goal = robot.drive()
    robot.planner.cancels = False
    stopping.start()
    status, reason = client_goal.end()
    assert status == "ABORTED"
    assert reason.startswith(f"the gateway is shutting down; {MAY_MOVE}")
    assert client_goal.result is not None
    assert client_goal.result["error_code"] == Fault.MAY_MOVE


def test_a_new_goal_answers_a_stop_that_is_not_confirmed(robot: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gateway_module, "ANSWER_SECONDS", 60.0)
    first = robot.drive()
    robot.planner.cancels = False
    stop = robot.begin("stop")
    robot.rig.state(State.MOVING, "it was stopped")
    ClientGoal(robot.rig.client, pose(9.0))
    reply = stop.result()["reply"]
    assert reply == {"success": False, "message": f"{MAY_MOVE}: a client of the action gave another goal"}
    assert first.end()[0] == "CANCELED"
    robot.rig.state(State.MOVING)


# -- words -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("restarted", [False, True])
def test_the_reason_of_a_lost_foreign_goal_is_not_stale_once_the_planner_is_back(robot: Scene, restarted: bool) -> None:
    rig, planner = robot.rig, robot.planner
    planner.set(b"a foreign goal..")
    planner.tell()
    rig.state(State.MOVING, "its own client")
    planner.withdraw()
    robot.base.speed = 0.0
    rig.state(State.ABORTED, f"the planner {PLANNER} has disappeared")
    if restarted:
        planner.forget()
    else:
        planner.set(b"a foreign goal..", GoalState.CANCELED)
    planner.serve()
    until(lambda: rig.gateway.link.state is PlannerState.IDLE, "the planner is back")
    rig.worker.running("gateway").host.loop.call(rig.gateway.poll)
    assert "has disappeared" not in rig.gateway.state().reason
    assert rig.gateway.state().state is (State.ABORTED if restarted else State.IDLE)


def test_the_reason_of_a_goal_without_a_planner_is_in_the_past_tense_after_its_return(robot: Scene) -> None:
    rig = robot.rig
    rig.worker.reload(rig.configured(patience=0.3))
    try:
        client_goal = robot.drive()
        robot.planner.withdraw()
        status, reason = client_goal.end()
        assert status == "ABORTED"
        assert reason.startswith(f"the planner {PLANNER} was not available for 0.3 s")
        rig.state(State.MOVING, MAY_MOVE)
        robot.planner.serve()
        until(
            lambda: not robot.planner.executes(robot.planner.goals[0]), "the goal is canceled once the planner is back"
        )
        robot.base.speed = 0.0
        rig.state(State.ABORTED, f"the planner {PLANNER} was not available for 0.3 s")
        assert "is not available" not in rig.gateway.state().reason
    finally:
        rig.worker.reload(rig.configured(patience=60.0))


def test_a_goal_whose_planner_stays_unreachable_ends_when_the_base_stands(robot: Scene) -> None:
    rig = robot.rig
    rig.worker.reload(rig.configured(patience=0.3))
    try:
        client_goal = robot.drive()
        begin = len(rig.statuses)
        robot.planner.withdraw()
        reason = f"the planner {PLANNER} was not available for 0.3 s"
        rig.status_since(begin, State.MOVING, f"stopping: {reason}")  # a second later, the stop is late
        assert not client_goal.ended
        robot.base.speed = 0.0
        assert client_goal.end() == ("ABORTED", reason)
        rig.state(State.ABORTED, reason)
        assert robot.states(begin) == {State.MOVING, State.ABORTED}
    finally:
        rig.worker.reload(rig.configured(patience=60.0))


def test_lost_localization_is_named_while_a_foreign_planner_drives(robot: Scene) -> None:
    rig = robot.rig
    status_topic = rig.far.advertise("/localization/status", "std_msgs/String", latched=True)
    reason_topic = rig.far.advertise("/localization/reason", "std_msgs/String", latched=True)
    try:
        robot.drive()
        rig.far.publish(reason_topic, {"data": "amcl is silent"})
        rig.far.publish(status_topic, {"data": "localized_error"})
        status = rig.state(State.MOVING, "'localized_error': amcl is silent")
        assert status["error_code"] == Fault.NOT_LOCALIZED
        rig.far.publish(status_topic, {"data": "localized_ok"})
        until(lambda: rig.statuses[-1]["reason"] == "", "the robot is localized again")
        assert rig.statuses[-1]["error_code"] == 0
    finally:
        rig.far.publish(status_topic, {"data": "localized_ok"})
        for endpoint in (status_topic, reason_topic):
            rig.far.drop(endpoint)


def test_the_reason_of_a_goal_in_an_unknown_frame_reaches_the_client(robot: Scene) -> None:
    robot.planner.rejects = True
    robot.rig.gateway.link.presence.unreachable_at = 0.0  # reachable for long, so a rejection is final
    client_goal = ClientGoal(robot.rig.client, pose(1.0, frame="dock"))
    status, reason = client_goal.end()
    assert status == "ABORTED"
    assert reason.startswith(f"{PLANNER} rejected the goal: ")
    assert "dock" in reason
    assert "map" in reason
    robot.base.speed = 0.0
    assert robot.rig.state(State.ABORTED, "dock")["error_code"] == Fault.BAD_GOAL
