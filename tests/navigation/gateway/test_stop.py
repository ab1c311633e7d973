"""Stops while the planner is unreachable, hangs, or has exited: replies and effects."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.client import actions
from bridge.config.sections.section import Section
from bridge.hub.errors import HubError
from bridge.hub.wire.keys import pack_attachment, topic_key
from bridge.messages.actions import STATUSES, GoalState, names
from bridge.messages.values import MessageWriter
from bridge.modules import background
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from navigation.gateway import execution, goal_list, stop
from navigation.gateway import gateway as gateway_module
from navigation.gateway.choice import RequestError
from navigation.gateway.module import GatewayModule
from navigation.gateway.velocities import YarpVelocity
from navigation.status import Fault, State
from tests.peers.hub.node import REGISTRY
from tests.peers.navigation.gateway import LATCHED, ClientGoal, Planner, Rig, patient, pose
from tests.peers.navigation.odometry import Odometry
from tests.support.faults import FaultProxy
from tests.support.wait import until
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.inavigation2d import INavigation2DMsgs, NavigationStatusEnum

PLANNER = "move_base"
ACTION = f"/planner/{PLANNER}/navigate_to_pose"


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with Rig(tmp_path_factory.mktemp("stop"), planner=PLANNER, silence=0.5) as started:
        started.planners.pop("robot_goto").close()
        yield started


@pytest.fixture
def odometry(running: Rig) -> Iterator[Odometry]:
    with Odometry(running.far) as started:
        yield started


@pytest.fixture
def rig(running: Rig, odometry: Odometry) -> Iterator[Rig]:
    """A reachable planner and a moving base."""
    running.planner = running.have(PLANNER)
    odometry.speed = 0.3
    until(lambda: running.gateway.motion.is_standing() is False, "odometry shows that the base moves", 20)
    yield running
    odometry.speed = 0.0
    running.planner.cancels = running.planner.cancel
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(actions, "CANCEL_ALL_SECONDS", 0.0)  # do not repeat the request to the next test's planner
        running.fresh()
    running.planners.pop(PLANNER).close()
    until(lambda: not running.gateway.link.reachable, "the planner is unreachable", 20)


def record(rig: Rig, topic: str, kind: str) -> list[dict[str, Any]]:
    """Return a list that collects the messages of a topic from now on, beginning with a latched one."""
    messages: list[dict[str, Any]] = []
    rig.client.on(lambda: rig.client.node.subscription(topic, kind, messages.append, LATCHED))
    return messages


def ignore_cancel(_goal: object) -> bool:
    """Accept a cancel request but continue, as move_base does in SIGSTOP or during a recovery rotation."""
    return True


class FarPlanner:
    """A planner behind a link that can be cut; to the gateway, a cut looks as if the side's worker was killed."""

    def __init__(self, rig: Rig, link: FaultProxy) -> None:
        close_planner(rig)
        self.planner: Planner = rig.have(PLANNER, behind(rig, link))
        rig.planner = self.planner


def close_planner(rig: Rig) -> None:
    """Close the planner, and wait until nobody sends a goal to it instead of the next one."""
    rig.planners.pop(PLANNER).close()
    servers = rig.client.node.hub.graph.servers
    until(lambda: not servers(names(ACTION).send_goal), "the client sees that the planner has left", 20)
    until(lambda: not rig.gateway.link.reachable, "the gateway sees that the planner has left", 20)


def behind(rig: Rig, link: FaultProxy) -> Any:
    """Return the settings of a planner's session over a link that can be cut."""
    far = {"router": f"tcp/127.0.0.1:{link.port}", "zenoh": {"mode": "client"}, "shared_memory": False}
    return rig.hubs.settings(PLANNER, **far)  # type: ignore[arg-type]


class SlowPlanner(Planner):
    """A planner that delays the acceptance of a goal."""

    def __init__(self, settings: Any, name: str) -> None:
        self.requested, self.accepts = threading.Event(), threading.Event()
        super().__init__(settings, name)

    def _accept(self, goal: Goal) -> bool:
        self.requested.set()
        self.accepts.wait(20)
        return super()._accept(goal)


def test_a_stop_without_the_planner_is_unconfirmed_until_it_is_back(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "GIVE_UP_SECONDS", 600.0)  # two replies take 5 s, and a busy planner is back late
    holds, velocities = (
        record(rig, "/navigation/hold", "std_msgs/msg/Bool"),
        record(rig, "/cmd_vel", "geometry_msgs/msg/Twist"),
    )
    with FaultProxy(rig.hubs.port) as link:
        planner = FarPlanner(rig, link).planner
        client_goal = ClientGoal(rig.client, pose(5.0))
        goal = planner.until(1)
        link.freeze()
        status = rig.state(State.MOVING, f"{PLANNER} is not available; waiting for it; the robot may still be moving")
        assert status["error_code"] == Fault.NO_NAVIGATOR
        answer = rig.ask("stop")
        assert not answer["success"]
        assert "the robot may still be moving: the planner move_base is not available" in answer["message"]
        assert rig.state(State.MOVING, "the robot may still be moving")["error_code"] == Fault.MAY_MOVE
        until(lambda: holds[-1] == {"data": True}, "the planner's velocities are held", 20)
        until(lambda: velocities, "zero is published", 20)
        assert not any(v["linear"]["x"] or v["angular"]["z"] for v in velocities)
        assert rig.gateway.drive.goal.status is GoalState.CANCELING
        assert not client_goal.ended
        with pytest.raises(HubError, match="may still be moving"):
            rig.module.halt()
        assert goal.active
        link.thaw()
        link.cut()
        until(lambda: not goal.active, "the planner has ended the goal", 30)
        assert client_goal.end()[0] == "CANCELED"
        rig.state(State.IDLE, "it was stopped")
        assert len(planner.goals) == 1, "the goal must not be sent again"
        until(lambda: holds[-1] == {"data": False}, "velocities are no longer held", 20)
        moves = lambda: rig.gateway.motion.is_standing() is False  # noqa: E731
        until(moves, "the base moves, although the planner confirmed the stop", 20)


def test_a_yarp_client_gets_no_success_for_an_unconfirmed_stop(rig: Rig, odometry: Odometry) -> None:
    rig.planner.cancels = ignore_cancel
    client_goal = ClientGoal(rig.client, pose(5.0))
    goal = rig.planner.until(1)
    with ServiceClient(INavigation2DMsgs, "/navigationServer/rpc", naming=rig.names, timeout=20) as connected:
        client = connected.remote
        assert not client.stop_navigation_RPC()
        assert client.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_moving
        odometry.speed = 0.0
        status, reason = client_goal.end()
        assert (status, "the base stands" in reason) == ("CANCELED", True)
        rig.state(State.IDLE, "has not answered, and the base stands")
        last = [entry for entry in rig.statuses if entry["error_code"] == Fault.MAY_MOVE][-1]
        assert "the base stands" not in last["reason"], "odometry from before the goal's end does not count"
        with patient():  # odometry may be late
            assert client.stop_navigation_RPC()
        idle = NavigationStatusEnum.navigation_status_idle  # but not while odometry is late
        until(lambda: client.get_navigation_status_RPC()[1] is idle, "the status is idle", 20)
        rig.state(State.IDLE)  # the status topic shows it, too
        odometry.speed = 0.3  # the robot drives on, as with move_base on SIGCONT during a recovery rotation
        assert rig.state(State.MOVING, "may still be moving")["error_code"] == Fault.MAY_MOVE
        assert client.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_moving
        rig.planner.on(goal.canceled)
        rig.state(State.IDLE, "it was stopped")


def test_without_odometry_an_unconfirmed_stop_ends_the_goal_as_aborted(
    rig: Rig, odometry: Odometry, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(execution, "GIVE_UP_SECONDS", 1.0)
    odometry.silent = True
    until(lambda: rig.gateway.motion.is_standing() is None, "the motion of the base is unknown", 20)
    rig.planner.cancels = ignore_cancel
    client_goal = ClientGoal(rig.client, pose(5.0))
    goal = rig.planner.until(1)
    client_goal.cancel()
    status, reason = client_goal.end()
    assert (status, "the robot may still be moving" in reason) == ("ABORTED", True)
    assert client_goal.result is not None
    assert client_goal.result["error_code"] == Fault.MAY_MOVE
    assert rig.state(State.MOVING, "may still be moving")["error_code"] == Fault.MAY_MOVE
    rig.planner.on(goal.canceled)
    rig.state(State.ABORTED, "may still be moving")
    assert rig.gateway.motion.is_standing() is None, "the motion was unknown throughout"


def test_a_pause_without_an_answer_of_the_planner_is_not_confirmed(rig: Rig, odometry: Odometry) -> None:
    rig.planner.cancels = ignore_cancel
    ClientGoal(rig.client, pose(5.0))
    rig.planner.until(1)
    paused = rig.ask("pause")
    assert not paused["success"]
    assert "the robot may still be moving: move_base has not released its goal" in paused["message"]
    assert rig.state(State.MOVING, "it was paused; the robot may still be moving")["error_code"] == Fault.MAY_MOVE
    odometry.speed = 0.0
    rig.state(State.PAUSED)


def test_goals_of_other_clients_are_stopped_when_the_planner_is_back(rig: Rig) -> None:
    with FaultProxy(rig.hubs.port) as link:
        planner = FarPlanner(rig, link).planner
        ClientGoal(rig.client, pose(1.0), f"/planner/{PLANNER}/navigate_to_pose")
        goal = planner.until(1)
        rig.state(State.MOVING, "its own client")
        link.freeze()
        until(lambda: not rig.gateway.link.reachable, "the planner is unreachable", 30)
        assert not rig.ask("stop")["success"]
        rig.state(State.MOVING, "may still be moving")
        link.thaw()
        link.cut()
        until(lambda: not goal.active, "the planner has ended the goal", 30)


def test_a_goal_list_that_arrives_before_the_graph_shows_the_planner_is_believed(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The list may arrive before the planner's token, while the publisher of an earlier one is still on the graph."""
    topic = names(f"/planner/{PLANNER}/navigate_to_pose").status
    listed = lambda: rig.client.node.hub.graph.publishers(topic)  # noqa: E731
    until(lambda: len(listed()) == 1, "the client knows only this planner's list")
    (before,) = listed()
    goal_status = {"goal_info": {"goal_id": {"uuid": list(bytes(range(16)))}}, "status": GoalState.EXECUTING.value}
    payload = MessageWriter(REGISTRY.schema(STATUSES)).message({"status_list": [goal_status]})
    attached = pack_attachment(1, time.time_ns(), bytes(range(16)))
    monkeypatch.setattr(goal_list, "EARLY_SECONDS", 60.0)  # on a busy machine, seconds may pass between two polls
    with rig.hubs.program() as session:
        session.put(topic_key(rig.hubs.domain, topic, before.type_name, before.type_hash), payload, attachment=attached)
        rig.state(State.MOVING, "its own client")
        count, polls, link = len(rig.statuses), [], rig.gateway.link
        refresh = link.refresh
        monkeypatch.setattr(link, "refresh", lambda motion: polls.append(refresh(motion)))
        until(lambda: len(polls) > 3, "the gateway has polled again")
        assert {status["state"] for status in rig.statuses[count - 1 :]} == {State.MOVING.value}
        monkeypatch.setattr(goal_list, "EARLY_SECONDS", 0.0)
        unknown = rig.state(State.MOVING, "has not reported its goals; the robot may still be moving")
        assert unknown["error_code"] == Fault.MAY_MOVE, "a list that is missing is not an empty one"
        rig.planner.on(rig.planner.server.publish_status)
        rig.state(State.ABORTED, "has disappeared")


def test_a_goal_of_another_client_continues_while_the_planner_is_unreachable(rig: Rig, odometry: Odometry) -> None:
    """A cut link, as if the worker of the planner's side was killed: the other client's goal and the robot continue."""
    with FaultProxy(rig.hubs.port) as link:
        planner = FarPlanner(rig, link).planner
        ClientGoal(rig.client, pose(1.0))
        planner.reach(planner.until(1))  # a new goal lifts the stop of an earlier test
        ClientGoal(rig.client, pose(1.0), f"/planner/{PLANNER}/navigate_to_pose")
        goal = planner.until(2)
        rig.state(State.MOVING, "its own client")
        link.freeze()
        status = rig.state(State.MOVING, f"the planner {PLANNER} is not available; the robot may still be moving")
        assert status["error_code"] == Fault.MAY_MOVE
        link.thaw()
        link.cut()
        until(lambda: rig.statuses[-1]["error_code"] == 0, "the planner is back, and its goal continues", 30)
        assert rig.statuses[-1]["state"] == State.MOVING
        link.freeze()
        rig.state(State.MOVING, "may still be moving")
        odometry.speed = 0.0
        rig.state(State.ABORTED, f"the planner {PLANNER} has disappeared")
        link.thaw()
        link.cut()
        until(lambda: rig.gateway.link.reachable, "the planner is back", 30)
        planner.on(goal.canceled)
        until(lambda: not goal.active, "the goal has ended", 20)


def test_a_robot_that_drove_may_still_be_moving_also_after_the_goal_was_sent_again(rig: Rig) -> None:
    ClientGoal(rig.client, pose(5.0))
    rig.planner.until(1)
    rig.planners.pop(PLANNER).close()
    rig.state(State.MOVING, "may still be moving")
    with FaultProxy(rig.hubs.port) as link:
        slow = SlowPlanner(behind(rig, link), PLANNER)
        rig.planners[PLANNER] = rig.planner = slow
        assert slow.requested.wait(20), "the gateway did not send the goal again"
        link.freeze()
        rig.state(State.MOVING, f"{PLANNER} is not available; waiting for it; the robot may still be moving")
        slow.accepts.set()
        link.thaw()
        link.cut()
        until(lambda: rig.gateway.link.reachable, "the planner is back", 30)


def test_a_planner_that_disappears_before_its_answer_may_have_accepted_the_goal(rig: Rig) -> None:
    close_planner(rig)
    with FaultProxy(rig.hubs.port) as link:
        slow = SlowPlanner(behind(rig, link), PLANNER)
        rig.planners[PLANNER] = rig.planner = slow
        until(lambda: rig.gateway.link.reachable, "the planner is reachable", 30)
        ClientGoal(rig.client, pose(5.0))
        assert slow.requested.wait(20), "the gateway did not send the goal"
        link.freeze()
        rig.state(State.MOVING, f"{PLANNER} is not available; waiting for it; the robot may still be moving")
        slow.accepts.set()
        link.thaw()
        link.cut()
        until(lambda: rig.gateway.link.reachable, "the planner is back", 30)


def test_a_stop_right_after_a_start_waits_for_the_planners_goal_list(
    rig: Rig, odometry: Odometry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if the modules were killed and restarted while a goal of the planner's own client continues."""
    rig.planner.cancels = ignore_cancel
    ClientGoal(rig.client, pose(5.0), f"/planner/{PLANNER}/navigate_to_pose")
    goal = rig.planner.until(1)
    rig.state(State.MOVING, "its own client")
    answers: list[str] = []

    def starting(module: GatewayModule, host: Host, section: Section) -> None:
        """Start the gateway and stop the robot in one step of the module's thread, before any message arrives."""
        start(module, host, section)
        module.gateway.stop()
        module.gateway.when_confirmed(answers.append)

    start = GatewayModule.start
    monkeypatch.setattr(GatewayModule, "start", starting)
    restart(rig)
    until(lambda: answers, "the stop is answered", 20)
    assert "the robot may still be moving" in answers.pop()
    rig.planner.on(goal.canceled)
    rig.state(State.IDLE)
    odometry.speed = 0.0
    monkeypatch.setattr(gateway_module, "ANSWER_SECONDS", 60.0)  # the start counts, too
    restart(rig)
    until(lambda: answers, "the stop is answered", 20)
    assert answers == [""], "nothing drives, so the stop is confirmed"


def test_a_restart_of_the_gateway_does_not_let_a_stopped_yarp_client_drive(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(background, "_END_SECONDS", 60.0)  # the file that outlasts the restart is written there
    drive = YarpVelocity(0.1)
    with ServiceClient(INavigation2DMsgs, "/navigationServer/rpc", naming=rig.names, timeout=20) as client:
        # a velocity that waits for long is refused
        until(lambda: client.remote.apply_velocity_command_RPC(*drive, 0.2), "the client drives", 20)
        loop, halt = rig.module._host.loop, rig.module._commander.stop_client
        loop.call(lambda: (rig.module._commander.note(drive, 1.0), halt()))
    refusals: list[str] = []

    def starting(module: GatewayModule, host: Host, section: Section) -> None:
        """Start the gateway and command a velocity before the client could have paused."""
        start(module, host, section)
        try:
            module._commander.command(drive, 0.2)
        except RequestError as err:
            refusals.append(str(err))

    start = GatewayModule.start
    monkeypatch.setattr(GatewayModule, "start", starting)
    restart(rig)
    until(lambda: refusals, "the velocity is refused", 20)
    assert "the robot was stopped; first send no velocity" in refusals[0]
    monkeypatch.setattr(GatewayModule, "start", start)
    until(lambda: rig.gateway.link.reachable, "the planner is reachable", 20)


def restart(rig: Rig) -> None:
    running = rig.worker.running("gateway")
    running.stop()
    running.start()


def test_a_planner_without_messages_is_reported_as_not_answering(rig: Rig) -> None:
    ClientGoal(rig.client, pose(5.0))
    goal = rig.planner.until(1)
    rig.state(State.MOVING)
    assert rig.gateway.link.telemetry.silent == 0.0, (
        "a planner that has never published telemetry must not be regarded as silent"
    )
    rig.planner.on(lambda: goal.feedback({"current_pose": pose(0.5)}))
    status = rig.state(State.MOVING, "move_base does not answer: no status or feedback for 0.5 s")
    assert status["error_code"] == Fault.SILENT
    health = rig.module.health()
    assert (health.state, "does not answer" in health.text) == ("waiting", True)

    def answers() -> bool:
        rig.planner.on(lambda: goal.feedback({"current_pose": pose(0.6)}))
        return bool(rig.statuses[-1]["error_code"] == 0)

    until(answers, "the planner sends messages again", 20)


def test_the_distance_is_computed_if_the_planner_does_not_report_it(rig: Rig, odometry: Odometry) -> None:
    """MoveBaseFeedback only has a pose; a distance of zero would mean "arrived"."""
    far = odometry.x + 40.0
    client_goal = ClientGoal(rig.client, pose(far))
    goal = rig.planner.until(1)

    def next_feedback() -> dict[str, Any]:
        count = len(client_goal.feedback)
        rig.planner.on(lambda: goal.feedback({"current_pose": pose(odometry.x)}))
        until(lambda: len(client_goal.feedback) > count, "feedback arrives", 20)
        return client_goal.feedback[-1]

    until(
        lambda: 30.0 < next_feedback()["distance_remaining"] < 39.9,
        "the distance is that of a straight line to the goal, and decreases",
        20,
    )
    until(
        lambda: next_feedback()["estimated_time_remaining"]["sec"] > 60,
        "the remaining time is that of a drive at 0.3 m/s",
        20,
    )
    out = rig.far.advertise("/move_base/NavfnROS/plan", "nav_msgs/Path")
    corner = [pose(odometry.x), pose(odometry.x, 30.0), pose(far, 0.2)]  # ends at the goal however long that took

    def along_path() -> bool:
        rig.far.publish(out, {"header": {"frame_id": "map"}, "poses": corner})  # again until the gateway receives it
        return bool(next_feedback()["distance_remaining"] == pytest.approx(80.0, abs=5.0))

    until(along_path, "the distance is the length of the path", 20)


def test_the_distance_is_unset_if_it_is_unknown(rig: Rig) -> None:
    client_goal = ClientGoal(rig.client, pose(40.0, frame="dock"))
    goal = rig.planner.until(1)
    rig.planner.on(lambda: goal.feedback({"current_pose": pose(0.0)}))
    until(lambda: client_goal.feedback, "feedback arrives", 20)
    assert not client_goal.feedback[0]["distance_remaining"] < 1e9
    assert client_goal.feedback[0]["estimated_time_remaining"] == {"sec": 0, "nanosec": 0}


def test_velocities_of_a_planner_that_does_not_return_are_not_held_for_ever(
    rig: Rig, odometry: Odometry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Manual velocity commands from the planner's side must reach the base again."""
    holds = record(rig, "/navigation/hold", "std_msgs/msg/Bool")
    client_goal = ClientGoal(rig.client, pose(5.0))
    rig.planner.until(1)
    rig.planners.pop(PLANNER).close()
    try:
        rig.state(State.MOVING, f"{PLANNER} is not available")
        client_goal.cancel()
        until(lambda: holds[-1:] == [{"data": True}], "the planner's velocities are held", 20)
        odometry.speed = 0.0
        assert client_goal.end()[0] == "CANCELED"
        assert rig.gateway.held
        monkeypatch.setattr(stop, "HELD_SECONDS", 0.0)
        until(lambda: holds[-1] == {"data": False}, "the velocities are no longer held", 20)
        rig.state(State.IDLE, "the base stands")
    finally:
        rig.planner = rig.have(PLANNER)
