"""Nav2 as planner: its other actions that move the base, servers that disappear one by one, and its error codes."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.messages.actions import PARTS, GoalState
from bridge.modules.action_server import Goal
from navigation.gateway import execution as execution_module
from navigation.gateway import gateway as gateway_module
from navigation.gateway import motion, planner_link
from navigation.gateway import stop as stop_module
from navigation.gateway.machine import DriveState
from navigation.status import Fault, State
from tests.peers.hub.calls import Calling
from tests.peers.hub.node import HubNode
from tests.peers.navigation.driving import MAY_MOVE, SPEED, Scene, scene
from tests.peers.navigation.gateway import ClientGoal, Rig, pose
from tests.support.wait import until

PLANNER = "nav2"
LONG = 60.0
TYPES = {"/follow_path": "nav2_msgs/action/FollowPath", "/spin": "nav2_msgs/action/Spin"}


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with Rig(tmp_path_factory.mktemp("nav2"), planner=PLANNER) as rig:
        rig.planners.pop("robot_goto").close()
        yield rig


@pytest.fixture
def robot(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    # on a busy machine odometry is late, and then a second without velocities would show that the moving base stands
    monkeypatch.setattr(motion, "SILENCE_SECONDS", LONG)
    with scene(rig, PLANNER, lists=False) as robot:
        yield robot


# -- other actions that move the base ----------------------------------------------------------------------------------


class Controller(HubNode):
    """A server of another action that moves the base: controller_server or behavior_server.

    Attributes:
        canceled: set when a client requests cancellation; the goal continues until the test ends it.
    """

    def __init__(self, rig: Rig, action: str) -> None:
        super().__init__(rig.hubs.settings(action[1:]))
        self.goals: list[Goal] = []
        self.canceled = threading.Event()
        self.on(lambda: self.node.action_server(action, TYPES[action], self._accept, self._cancel))
        self.client = self.on(lambda: self.node.action_client(action, TYPES[action]))
        self._own = HubNode(rig.hubs.settings("bt_navigator"))
        client = self._own.on(lambda: self._own.node.action_client(action, TYPES[action]))
        until(lambda: client.ready, f"{action} is served")
        self._own.on(lambda: client.send({}, lambda *_end: None))
        until(lambda: self.goals, "bt_navigator's goal is accepted")

    def _accept(self, goal: Goal) -> bool:
        self.goals.append(goal)
        goal.execute()
        return True

    def _cancel(self, _goal: Goal) -> bool:
        self.canceled.set()
        return True

    def end(self) -> None:
        """End the controller's goal as canceled."""
        self.on(self.goals[0].canceled)

    def close(self) -> None:
        self._own.close()
        super().close()


@pytest.fixture(params=["/follow_path"])
def controller(request: pytest.FixtureRequest, robot: Scene) -> Iterator[Controller]:
    server = Controller(robot.rig, request.param)
    try:
        robot.planner.tell()  # bt_navigator has no goal
        until(lambda: robot.rig.gateway.link.state.reported, "the gateway has the planner's goal list")
        until(lambda: robot.rig.gateway.link.motion == (request.param,), "the gateway has the controller's goal list")
        yield server
    finally:
        server.end()
        server.close()


def test_odometry_from_before_the_goal_of_another_client_does_not_show_that_the_base_stands(robot: Scene) -> None:
    robot.stands()
    robot.rig.state(State.IDLE)
    begin = len(robot.rig.statuses)
    server = Controller(robot.rig, "/spin")
    try:
        robot.planner.tell()  # bt_navigator has no goal
        # until odometry covers 0.4 s
        assert robot.rig.status_since(begin, State.MOVING, "/spin moves the base")
        robot.rig.state(State.IDLE)
    finally:
        server.end()
        server.close()


def answered(calling: Calling) -> bool:
    return bool(calling.result(0.0)["done"])


def confirmed(calling: Calling) -> str:
    """Wait for the reply to a stop or pause, which must be a success; return its message."""
    reply: dict[str, Any] = calling.result(LONG)["reply"]
    assert reply["success"], reply
    return str(reply["message"])


@pytest.mark.parametrize("controller", TYPES, indirect=True)
def test_a_stop_cancels_another_clients_goal_that_moves_the_base(
    robot: Scene, controller: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gateway_module, "ANSWER_SECONDS", LONG)
    rig, (action,) = robot.rig, robot.rig.gateway.link.motion
    rig.state(State.MOVING, f"{action} moves the base")
    begin = len(rig.statuses)
    stop = robot.begin("stop")
    assert controller.canceled.wait(20)
    # not only the newest status: a second later, the reason is that the robot may still be moving
    reported = lambda: [status for status in rig.statuses[begin:] if status["reason"] == "stopping: it was stopped"]  # noqa: E731
    until(reported, "the stop is in the status")
    assert {status["state"] for status in rig.statuses[begin:]} == {State.MOVING}
    polls = count_polls(rig)
    until(lambda: polls() > 5, "the gateway has polled the planner several times")
    assert rig.gateway.held, "the controller's velocities are held, although Nav2 itself has no goal"
    assert not answered(stop)
    controller.end()
    until(lambda: not rig.gateway.held, "the controller's goal has ended")
    assert not answered(stop), "the base still moves"
    assert rig.gateway.state().state is State.MOVING
    robot.base.speed = 0.0
    assert confirmed(stop) == f"the goals of {action} are canceled"
    rig.state(State.IDLE)


def test_an_abort_is_reported_when_the_controller_has_ended_and_the_base_stands(
    robot: Scene, controller: Controller
) -> None:
    """On a busy machine bt_navigator aborts the goal, and controller_server continues to drive for seconds."""
    rig = robot.rig
    client_goal = robot.drive()
    begin = len(rig.statuses)
    robot.planner.end(GoalState.ABORTED, 100)
    assert controller.canceled.wait(20)
    rig.state(State.MOVING, "the controller failed (Nav2 100)")
    assert not client_goal.ended
    controller.end()
    until(lambda: not rig.gateway.held, "the controller's goal has ended")
    assert not client_goal.ended, "the base still moves"
    robot.base.speed = 0.0
    assert client_goal.end() == ("ABORTED", "the controller failed (Nav2 100)")
    rig.state(State.ABORTED, "the controller failed (Nav2 100)")
    states = [status["state"] for status in rig.statuses[begin:]]
    assert set(states[:-1]) == {State.MOVING}, "no other state is reported before the base stands"


def test_an_abort_ends_the_controllers_goal_although_the_base_stood_before_the_goal(
    robot: Scene, controller: Controller
) -> None:
    """The worker that carries odometry is starved as the robot starts: the last poses still show that it stands."""
    robot.base.speed = 0.0
    robot.stands()
    robot.base.silent = True
    client_goal = ClientGoal(robot.rig.client, pose(5.0))
    robot.goal(1)
    robot.planner.end(GoalState.ABORTED, 100)
    assert controller.canceled.wait(20)
    assert not client_goal.ended
    robot.rig.state(State.MOVING, "the controller failed (Nav2 100)")
    controller.end()
    robot.base.silent = False
    assert client_goal.end() == ("ABORTED", "the controller failed (Nav2 100)")


@pytest.mark.parametrize("request_", ["pause", "stop", "cancel"])
def test_a_request_after_an_abort_without_a_code_ends_the_controllers_goal(
    robot: Scene, controller: Controller, monkeypatch: pytest.MonkeyPatch, request_: str
) -> None:
    """The planner's reason is still awaited; its controller drives on."""
    monkeypatch.setattr(execution_module, "JUDGING_SECONDS", LONG)
    monkeypatch.setattr(gateway_module, "ANSWER_SECONDS", LONG)
    client_goal = robot.drive()
    robot.planner.end(GoalState.ABORTED)
    robot.rig.state(State.MOVING, "ended the goal; waiting for its reason")
    begin = len(robot.rig.statuses)
    calling = None if request_ == "cancel" else robot.begin(request_)
    if calling is None:
        client_goal.cancel()
    assert controller.canceled.wait(20)
    polls = count_polls(robot.rig)
    until(lambda: polls() > 5, "the gateway has polled the planner several times")
    assert robot.states(begin) <= {State.MOVING}
    assert not client_goal.ended
    controller.end()
    robot.base.speed = 0.0
    if calling is not None:
        confirmed(calling)
    if request_ == "pause":
        robot.rig.state(State.PAUSED)
    else:
        assert client_goal.end()[0] == "CANCELED"
        robot.rig.state(State.IDLE)


def test_a_stop_that_is_late_names_the_action_that_has_not_ended(robot: Scene, controller: Controller) -> None:
    answer = robot.rig.ask("stop")
    assert controller.canceled.wait(20)
    assert answer == {"success": False, "message": f"{MAY_MOVE}: /follow_path of {PLANNER} has not ended"}
    status = robot.rig.state(State.MOVING, f"it was stopped; {MAY_MOVE}: /follow_path of {PLANNER} has not ended")
    assert status["error_code"] == Fault.MAY_MOVE


def test_a_client_that_cancels_its_goal_has_the_controllers_goal_canceled_too(
    robot: Scene, controller: Controller
) -> None:
    client_goal = robot.drive()
    client_goal.cancel()
    assert controller.canceled.wait(20)
    controller.end()
    robot.base.speed = 0.0
    assert client_goal.end()[0] == "CANCELED"
    robot.rig.state(State.IDLE)


def test_a_goal_that_nav2_counts_as_reached_when_its_path_is_canceled_ends_canceled(
    robot: Scene, controller: Controller
) -> None:
    robot.planner.cancels = False
    client_goal = robot.drive()
    client_goal.cancel()
    assert controller.canceled.wait(20)
    controller.end()
    robot.planner.end(GoalState.SUCCEEDED)
    robot.base.speed = 0.0
    assert client_goal.end()[0] == "CANCELED"
    robot.rig.state(State.IDLE)


def test_a_goal_that_nav2_counts_as_reached_ends_canceled_although_its_path_is_not_listed_yet(
    robot: Scene, controller: Controller
) -> None:
    """The cancel request for all paths also ends a path that controller_server has just accepted."""
    controller.end()
    until(lambda: not robot.rig.gateway.link.may_move, "the list has no path")
    robot.planner.cancels = False
    client_goal = robot.drive()
    client_goal.cancel()
    until(lambda: robot.planner.canceled, "the planner's goal is canceled")
    robot.planner.end(GoalState.SUCCEEDED)
    robot.base.speed = 0.0
    assert client_goal.end()[0] == "CANCELED"
    robot.rig.state(State.IDLE)


def test_a_pause_does_not_end_a_goal_that_nav2_counts_as_reached(
    robot: Scene, controller: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gateway_module, "ANSWER_SECONDS", LONG)
    robot.planner.cancels = False
    robot.drive()
    pause = robot.begin("pause")
    assert controller.canceled.wait(20)
    controller.end()
    robot.planner.end(GoalState.SUCCEEDED)
    robot.base.speed = 0.0
    assert confirmed(pause) == ""
    robot.rig.state(State.PAUSED)


def test_a_pause_is_not_confirmed_before_the_controllers_goal_has_ended(
    robot: Scene, controller: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gateway_module, "ANSWER_SECONDS", LONG)
    robot.drive()
    pause = robot.begin("pause")
    assert controller.canceled.wait(20)
    assert not answered(pause)
    assert robot.rig.gateway.state().state is State.MOVING
    controller.end()
    robot.base.speed = 0.0
    assert confirmed(pause) == ""
    robot.rig.state(State.PAUSED)


def test_without_odometry_a_stop_needs_the_end_of_the_controllers_goal_and_zero_velocity(
    robot: Scene, controller: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gateway_module, "ANSWER_SECONDS", LONG)
    monkeypatch.setattr(stop_module, "SETTLING_SECONDS", LONG)  # on a busy machine, 20 velocities take seconds
    rig = robot.rig
    robot.base.silent = True
    until(lambda: not rig.gateway.motion.known, "odometry is missing")
    with contextlib.closing(Commander(rig)) as commander:
        stop = robot.begin("stop")
        assert controller.canceled.wait(20)
        controller.end()
        until(lambda: not rig.gateway.held, "the controller's goal has ended")
        sent = commander.sent
        until(lambda: commander.sent > sent + 20, "more velocities arrive than the zeros that a stop needs")
        assert not answered(stop)
        commander.speed = 0.0
        assert confirmed(stop)


class Commander:
    """Publishes a velocity twenty times a second."""

    def __init__(self, rig: Rig) -> None:
        self.speed, self.sent = SPEED, 0
        self._far, self._out = rig.far, rig.far.advertise("/cmd_vel", "geometry_msgs/Twist")
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._end.wait(0.05):
            self._far.publish(self._out, {"linear": {"x": self.speed}})
            self.sent += 1

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self._far.drop(self._out)


# -- contact with the planner ------------------------------------------------------------------------------------------


def lost(robot: Scene) -> None:
    """Wait until the gateway has lost contact with the goal."""
    until(lambda: robot.rig.gateway.drive.state is DriveState.LOST, "contact is lost")


@pytest.mark.parametrize("first", PARTS)
def test_a_planner_whose_parts_disappear_one_by_one_is_lost_and_has_not_aborted(robot: Scene, first: str) -> None:
    rig, planner = robot.rig, robot.planner
    client_goal = robot.drive()
    begin = len(rig.statuses)
    planner.close_part(first)
    lost(robot)
    for part in PARTS:
        if part != first:
            planner.close_part(part)
    rig.state(State.MOVING, f"{PLANNER} is not available; waiting for it; {MAY_MOVE}")
    planner.serve()
    planner.tell()
    robot.goal(1)  # the gateway tracks it again
    until(lambda: rig.gateway.drive.state is DriveState.DRIVING, "contact is restored")
    until(lambda: rig.statuses[-1]["reason"] == "", "the status shows a normal drive")
    assert robot.states(begin - 1) == {State.MOVING}
    assert not client_goal.ended
    planner.end(GoalState.SUCCEEDED)
    assert client_goal.end() == ("SUCCEEDED", "")
    assert len(planner.goals) == 1, "the goal is sent only once"


def test_a_goal_that_a_bridge_reports_as_lost_has_not_aborted(robot: Scene) -> None:
    """A side's worker responds with status UNKNOWN while all parts of the action are still on the hub."""
    client_goal = robot.drive()
    robot.planner.answer(GoalState.UNKNOWN, why="nav2 gave it up")
    lost(robot)
    robot.planner.withdraw()
    robot.rig.state(State.MOVING, f"{PLANNER} is not available")
    assert not client_goal.ended
    robot.planner.serve()
    robot.planner.tell()
    robot.goal(1)
    robot.planner.end(GoalState.SUCCEEDED)
    assert client_goal.end() == ("SUCCEEDED", "")
    assert len(robot.planner.goals) == 1


def test_a_planner_that_returns_without_the_goal_receives_it_again(robot: Scene) -> None:
    rig, planner = robot.rig, robot.planner
    client_goal = robot.drive()
    planner.withdraw()
    lost(robot)
    planner.forget()
    planner.serve()
    planner.tell()
    robot.goal(2)
    planner.end(GoalState.SUCCEEDED)
    assert client_goal.end() == ("SUCCEEDED", "")
    rig.state(State.REACHED)


def test_a_goal_that_only_the_list_of_a_killed_planner_has_is_sent_again(robot: Scene) -> None:
    """The parts and last goal list of a killed bt_navigator remain until its DDS lease expires, next to new ones."""
    rig, planner = robot.rig, robot.planner
    client_goal = robot.drive()
    planner.tell()
    until(lambda: rig.gateway.link.state.reported, "the gateway has the planner's goal list")
    planner.forget()
    planner.answer(GoalState.UNKNOWN)
    lost(robot)
    robot.goal(2)
    planner.end(GoalState.SUCCEEDED)
    assert client_goal.end() == ("SUCCEEDED", "")


def test_a_lost_reply_of_a_restarted_planner_is_requested_again(robot: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """The new bt_navigator does not know the goal, but has not discovered the reader of its reply yet."""
    monkeypatch.setattr(planner_link, "ASK_SECONDS", 0.2)
    rig, planner = robot.rig, robot.planner
    client_goal = robot.drive()
    planner.tell()
    until(lambda: rig.gateway.link.state.reported, "the gateway has the planner's goal list")
    planner.forget()
    planner.loses = 1
    planner.answer(GoalState.UNKNOWN)
    robot.goal(2)
    planner.end(GoalState.SUCCEEDED)
    assert client_goal.end() == ("SUCCEEDED", "")
    assert planner.loses == 0


def test_a_goal_is_not_sent_again_before_all_parts_are_back(robot: Scene) -> None:
    rig, planner = robot.rig, robot.planner
    client_goal = robot.drive()
    planner.withdraw()
    lost(robot)
    planner.forget()
    planner.serve(feedback=False)
    polls = count_polls(rig)
    until(lambda: polls() > 5, "the gateway has polled the graph")
    assert len(planner.goals) == 1
    planner.withdraw()
    planner.serve()
    planner.tell()
    robot.goal(2)
    planner.end(GoalState.SUCCEEDED)
    assert client_goal.end() == ("SUCCEEDED", "")


def count_polls(rig: Rig) -> Any:
    """Return a function that counts the gateway's polls from now on."""
    polls: list[None] = []
    loop = rig.worker.running("gateway").host.loop

    def count() -> int:
        polls.append(loop.call(rig.gateway.poll))
        return len(polls)

    return count


# -- how the planner ends a goal ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("code", [102, 202])
def test_a_goal_that_fails_without_a_transform_is_sent_again_within_the_patience(robot: Scene, code: int) -> None:
    rig, planner = robot.rig, robot.planner
    client_goal = robot.drive()
    begin = len(rig.statuses)
    planner.end(GoalState.ABORTED, code)
    reason = f"{PLANNER}: a transform is missing or too old (Nav2 {code}); trying again"
    status = rig.status_since(begin, State.MOVING, reason)
    assert status["error_code"] == Fault.OTHER
    robot.goal(2)
    assert not client_goal.ended
    planner.end(GoalState.SUCCEEDED)
    assert client_goal.end() == ("SUCCEEDED", "")
    assert State.ABORTED not in robot.states(begin)


def test_a_transform_that_stays_missing_aborts_the_goal_after_the_patience(robot: Scene) -> None:
    rig, planner = robot.rig, robot.planner
    rig.worker.reload(rig.configured(patience=1.2))
    try:
        client_goal = robot.drive()
        count = 0
        while not client_goal.ended:
            count += 1
            planner.end(GoalState.ABORTED, 102)
            until(lambda: client_goal.ended or len(planner.goals) > count, "the goal ends, or is sent again")  # noqa: B023
            until(
                lambda: client_goal.ended or planner.waits(planner.goals[-1]),
                "the gateway waits for the result of the goal",
            )
        assert count > 1
        assert client_goal.end() == ("ABORTED", "a transform is missing or too old (Nav2 102)")
        assert client_goal.result is not None
        assert client_goal.result["error_code"] == 102
    finally:
        rig.worker.reload(rig.configured(patience=60.0))


@pytest.mark.parametrize(
    ("code", "reason"), [(204, "the goal is outside the map"), (208, "no path to the goal"), (106, "velocity command")]
)
def test_other_codes_of_nav2_abort_the_goal_with_a_reason(robot: Scene, code: int, reason: str) -> None:
    client_goal = robot.drive()
    robot.planner.end(GoalState.ABORTED, code)
    status, text = client_goal.end()
    assert status == "ABORTED"
    assert reason in text
    assert f"(Nav2 {code})" in text
    robot.base.speed = 0.0
    assert robot.rig.state(State.ABORTED, reason)["error_code"] == code


@pytest.mark.parametrize("first", ["list", "result"])
def test_a_goal_that_nav2s_own_client_preempts_is_canceled(
    robot: Scene, monkeypatch: pytest.MonkeyPatch, first: str
) -> None:
    """Nav2 aborts the goal without a code; Nav2's goal list shows the reason, shortly before or after the result."""
    monkeypatch.setattr(execution_module, "JUDGING_SECONDS", LONG)
    rig, planner = robot.rig, robot.planner
    client_goal = robot.drive()
    planner.set(b"a foreign goal..")
    if first == "list":
        planner.end(GoalState.ABORTED)
    else:
        planner.answer(GoalState.ABORTED)
        until(lambda: rig.gateway.drive.state is DriveState.JUDGING, "the gateway has the result")
        planner.tell()
    status, reason = client_goal.end()
    assert status == "CANCELED"
    assert reason == f"{PLANNER} canceled the goal for a goal that {PLANNER} received from its own client"
    rig.state(State.MOVING, "its own client")
    assert planner.executes(b"a foreign goal.."), "the other client's goal continues"


def test_a_list_from_before_the_abort_does_not_show_that_no_other_client_sent_a_goal(
    robot: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine, Nav2's list may arrive seconds after the result."""
    monkeypatch.setattr(execution_module, "JUDGING_SECONDS", 0.0)
    monkeypatch.setattr(execution_module, "SETTLING_SECONDS", LONG)
    rig, planner = robot.rig, robot.planner
    client_goal = robot.drive()
    until(lambda: rig.gateway.link.lists(rig.gateway.drive.sent), "the gateway has the list with the goal")
    planner.answer(GoalState.ABORTED)
    until(lambda: rig.gateway.drive.state is DriveState.JUDGING, "the gateway has the result")
    polls = count_polls(rig)
    until(lambda: polls() > 5, "the gateway has polled the planner several times")
    planner.set(b"a foreign goal..")
    planner.tell()
    status, reason = client_goal.end()
    assert (status, "received from its own client" in reason) == ("CANCELED", True)


def test_a_goal_that_nav2_aborts_without_a_code_and_without_another_goal_is_aborted(robot: Scene) -> None:
    client_goal = robot.drive()
    robot.planner.end(GoalState.ABORTED)
    assert client_goal.end() == ("ABORTED", f"{PLANNER} aborted the goal")
