"""Stops while the planner is unreachable, hangs, or has exited: replies and effects."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.config.sections.section import Section
from bridge.hub.errors import HubError
from bridge.hub.wire.keys import pack_attachment, topic_key
from bridge.messages.actions import STATUSES, GoalState, names
from bridge.messages.values import MessageWriter
from bridge.modules import clients
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from navigation.gateway import execution, goal_list, stop
from navigation.gateway.module import GatewayModule
from navigation.status import Fault, State
from tests.navigation.gateway.odometry import Odometry
from tests.navigation.gateway.rig import LATCHED, REGISTRY, Asked, Planner, Rig, pose
from tests.support.faults import FaultProxy
from tests.support.wait import until
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.inavigation2d import INavigation2DMsgs, NavigationStatusEnum

PLANNER = "move_base"


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with Rig(tmp_path_factory.mktemp("stop"), planner=PLANNER, silence=0.5) as made:
        made.planners.pop("robot_goto").close()
        yield made


@pytest.fixture
def odometry(running: Rig) -> Iterator[Odometry]:
    with Odometry(running.far) as made:
        yield made


@pytest.fixture
def rig(running: Rig, odometry: Odometry) -> Iterator[Rig]:
    """With a planner that is there, and a base that drives."""
    running.planner = running.have(PLANNER)
    odometry.speed = 0.3
    until(lambda: running.gateway.motion.stands() is False, "the base is seen to drive", 20)
    yield running
    odometry.speed = 0.0
    running.planner.cancels = running.planner.cancel
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(clients, "CANCEL_ALL_SECONDS", 0.0)  # what this stop means is not the next test's planner
        running.fresh()
    running.planners.pop(PLANNER).close()
    until(lambda: not running.gateway.link.reachable, "the planner has gone", 20)


def hears(rig: Rig, topic: str, kind: str) -> list[dict[str, Any]]:
    """What is published on the hub from now on; of a latched topic the last one as well."""
    heard: list[dict[str, Any]] = []
    rig.client.on(lambda: rig.client.node.subscription(topic, kind, heard.append, LATCHED))
    return heard


def unmoved(_goal: object) -> bool:
    """Takes a cancellation, and drives on: as move_base does that stands in SIGSTOP, or turns in a recovery."""
    return True


class FarPlanner:
    """A planner with a link that can be cut; to the gateway, this looks like a killed worker of the planner's side."""

    def __init__(self, rig: Rig, link: FaultProxy) -> None:
        rig.planners.pop(PLANNER).close()
        self.planner: Planner = rig.have(PLANNER, behind(rig, link))
        rig.planner = self.planner


def behind(rig: Rig, link: FaultProxy) -> Any:
    """A planner's session by that link."""
    far = {"router": f"tcp/127.0.0.1:{link.port}", "zenoh": {"mode": "client"}, "shared_memory": False}
    return rig.hubs.settings(PLANNER, **far)  # type: ignore[arg-type]


class SlowPlanner(Planner):
    """A planner that delays the acceptance of a goal."""

    def __init__(self, settings: Any, name: str) -> None:
        self.asked, self.takes = threading.Event(), threading.Event()
        super().__init__(settings, name)

    def _accept(self, goal: Goal) -> bool:
        self.asked.set()
        self.takes.wait(20)
        return super()._accept(goal)


def test_a_stop_out_of_the_planners_reach_says_so_and_is_done_once_it_is_back(rig: Rig, odometry: Odometry) -> None:
    holds, velocities = (
        hears(rig, "/navigation/hold", "std_msgs/msg/Bool"),
        hears(rig, "/cmd_vel", "geometry_msgs/msg/Twist"),
    )
    with FaultProxy(rig.hubs.port) as link:
        planner = FarPlanner(rig, link).planner
        asked = Asked(rig.client, pose(5.0))
        goal = planner.until(1)
        link.freeze()
        told = rig.state(State.MOVING, f"{PLANNER} is not available; waiting for it; the robot may still be moving")
        assert told["error_code"] == Fault.NO_NAVIGATOR
        answer = rig.ask("stop")
        assert not answer["success"]
        assert "the robot may still be moving: the planner move_base is not available" in answer["message"]
        assert rig.state(State.MOVING, "the robot may still be moving")["error_code"] == Fault.MAY_MOVE
        assert holds[-1] == {"data": True}
        assert velocities
        assert not any(v["linear"]["x"] or v["angular"]["z"] for v in velocities)
        assert rig.gateway.drive.goal.status is GoalState.CANCELING
        assert not asked.ended
        with pytest.raises(HubError, match="may still be moving"):
            rig.module.halt()
        assert goal.active
        link.thaw()
        link.cut()
        until(lambda: not goal.active, "the planner has ended the goal", 30)
        assert asked.end()[0] == "CANCELED"
        rig.state(State.IDLE, "it was stopped")
        assert len(planner.goals) == 1, "and the goal was not sent again before"
        until(lambda: holds[-1] == {"data": False}, "the base is free again", 20)
        assert odometry.speed, "what confirmed it was the planner"


def test_yarps_client_hears_no_ok_of_a_stop_that_is_not_confirmed(rig: Rig, odometry: Odometry) -> None:
    rig.planner.cancels = unmoved
    asked = Asked(rig.client, pose(5.0))
    goal = rig.planner.until(1)
    with ServiceClient(INavigation2DMsgs, "/navigationServer/rpc", naming=rig.names, timeout=20) as made:
        client = made.remote
        assert not client.stop_navigation_RPC()
        assert client.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_moving
        odometry.speed = 0.0
        status, why = asked.end()
        assert (status, "the base stands" in why) == ("CANCELED", True)
        rig.state(State.IDLE, "has not answered, and the base stands")
        last = [one for one in rig.statuses if one["error_code"] == Fault.MAY_MOVE][-1]
        assert "the base stands" not in last["reason"], "odometry from before the goal's end does not count"
        assert client.stop_navigation_RPC()
        assert client.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_idle
        rig.state(State.IDLE)  # the status topic has it, too
        odometry.speed = 0.3  # it moves on, as move_base does on SIGCONT during a recovery rotation
        assert rig.state(State.MOVING, "may still be moving")["error_code"] == Fault.MAY_MOVE
        assert client.get_navigation_status_RPC()[1] is NavigationStatusEnum.navigation_status_moving
        rig.planner.on(goal.canceled)
        rig.state(State.IDLE, "it was stopped")


def test_without_odometry_a_stop_that_nobody_confirms_ends_the_goal_as_aborted(
    rig: Rig, odometry: Odometry, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(execution, "GIVE_UP_SECONDS", 1.0)
    odometry.silent = True
    until(lambda: rig.gateway.motion.stands() is None, "the motion of the base is unknown", 20)
    rig.planner.cancels = unmoved
    asked = Asked(rig.client, pose(5.0))
    goal = rig.planner.until(1)
    asked.cancel()
    status, why = asked.end()
    assert (status, "the robot may still be moving" in why) == ("ABORTED", True)
    assert asked.result is not None
    assert asked.result["error_code"] == Fault.MAY_MOVE
    assert rig.state(State.MOVING, "may still be moving")["error_code"] == Fault.MAY_MOVE
    rig.planner.on(goal.canceled)
    rig.state(State.ABORTED, "may still be moving")
    assert odometry.speed


def test_a_pause_that_the_planner_does_not_answer_is_not_said_to_stand(rig: Rig, odometry: Odometry) -> None:
    rig.planner.cancels = unmoved
    Asked(rig.client, pose(5.0))
    rig.planner.until(1)
    paused = rig.ask("pause")
    assert not paused["success"]
    assert "the robot may still be moving: move_base has not released its goal" in paused["message"]
    assert rig.state(State.MOVING, "it was paused; the robot may still be moving")["error_code"] == Fault.MAY_MOVE
    odometry.speed = 0.0
    rig.state(State.PAUSED)


def test_goals_that_others_gave_are_stopped_once_the_planner_is_back(rig: Rig) -> None:
    with FaultProxy(rig.hubs.port) as link:
        planner = FarPlanner(rig, link).planner
        Asked(rig.client, pose(1.0), f"/planner/{PLANNER}/navigate_to_pose")
        goal = planner.until(1)
        rig.state(State.MOVING, "its own client")
        link.freeze()
        until(lambda: not rig.gateway.link.reachable, "the planner is out of reach", 30)
        assert not rig.ask("stop")["success"]
        rig.state(State.MOVING, "may still be moving")
        link.thaw()
        link.cut()
        until(lambda: not goal.active, "the planner has ended the goal", 30)


def test_a_planner_that_speaks_before_the_graph_tells_of_it_is_believed(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its list of goals may come ahead of its token, while a predecessor's publisher is still on the graph."""
    topic = names(f"/planner/{PLANNER}/navigate_to_pose").status
    (before,) = until(lambda: rig.client.node.hub.graph.publishers(topic), "the client knows of the planner's list")
    one = {"goal_info": {"goal_id": {"uuid": list(bytes(range(16)))}}, "status": GoalState.EXECUTING.value}
    payload = MessageWriter(REGISTRY.schema(STATUSES)).message({"status_list": [one]})
    attached = pack_attachment(1, time.time_ns(), bytes(range(16)))
    monkeypatch.setattr(goal_list, "EARLY_SECONDS", 60.0)  # a busy machine's looks may be seconds apart
    with rig.hubs.program() as session:
        session.put(topic_key(rig.hubs.domain, topic, before.type_name, before.type_hash), payload, attachment=attached)
        rig.state(State.MOVING, "its own client")
        count, looks, link = len(rig.statuses), [], rig.gateway.link
        look = link.refresh
        monkeypatch.setattr(link, "refresh", lambda motion: looks.append(look(motion)))
        until(lambda: len(looks) > 3, "the gateway has looked again")
        assert {told["state"] for told in rig.statuses[count - 1 :]} == {State.MOVING.value}
        monkeypatch.setattr(goal_list, "EARLY_SECONDS", 0.0)
        unknown = rig.state(State.MOVING, "has not reported its goals; the robot may still be moving")
        assert unknown["error_code"] == Fault.MAY_MOVE, "a list that is missing is not an empty one"
        rig.planner.on(rig.planner.server.publish_status)
        rig.state(State.ABORTED, "has gone")


def test_a_goal_that_others_gave_goes_on_while_the_planner_is_out_of_reach(rig: Rig, odometry: Odometry) -> None:
    """The worker of the planner's side is killed: its client's goal goes on, and the robot with it."""
    with FaultProxy(rig.hubs.port) as link:
        planner = FarPlanner(rig, link).planner
        Asked(rig.client, pose(1.0))
        planner.reach(planner.until(1))  # a stop that was asked for before does not concern what comes now
        Asked(rig.client, pose(1.0), f"/planner/{PLANNER}/navigate_to_pose")
        goal = planner.until(2)
        rig.state(State.MOVING, "its own client")
        link.freeze()
        told = rig.state(State.MOVING, f"the planner {PLANNER} is not available; the robot may still be moving")
        assert told["error_code"] == Fault.MAY_MOVE
        link.thaw()
        link.cut()
        until(lambda: rig.statuses[-1]["error_code"] == 0, "it is back, and drives on", 30)
        assert rig.statuses[-1]["state"] == State.MOVING
        link.freeze()
        rig.state(State.MOVING, "may still be moving")
        odometry.speed = 0.0
        rig.state(State.ABORTED, f"the planner {PLANNER} has gone")
        link.thaw()
        link.cut()
        until(lambda: rig.gateway.link.reachable, "it is back", 30)
        planner.on(goal.canceled)
        until(lambda: not goal.active, "it has ended", 20)


def test_a_robot_that_drove_may_still_be_moving_also_after_the_goal_was_sent_again(rig: Rig) -> None:
    Asked(rig.client, pose(5.0))
    rig.planner.until(1)
    rig.planners.pop(PLANNER).close()
    rig.state(State.MOVING, "may still be moving")
    with FaultProxy(rig.hubs.port) as link:
        slow = SlowPlanner(behind(rig, link), PLANNER)
        rig.planners[PLANNER] = rig.planner = slow
        assert slow.asked.wait(20), "the goal is not sent again"
        link.freeze()
        rig.state(State.MOVING, f"{PLANNER} is not available; waiting for it; the robot may still be moving")
        slow.takes.set()
        link.thaw()
        link.cut()
        until(lambda: rig.gateway.link.reachable, "it is back", 30)


def test_a_planner_that_goes_before_it_has_answered_may_have_taken_the_goal(rig: Rig) -> None:
    rig.planners.pop(PLANNER).close()
    with FaultProxy(rig.hubs.port) as link:
        slow = SlowPlanner(behind(rig, link), PLANNER)
        rig.planners[PLANNER] = rig.planner = slow
        until(lambda: rig.gateway.link.reachable, "it is there", 30)
        Asked(rig.client, pose(5.0))
        assert slow.asked.wait(20), "the goal is not sent"
        link.freeze()
        rig.state(State.MOVING, f"{PLANNER} is not available; waiting for it; the robot may still be moving")
        slow.takes.set()
        link.thaw()
        link.cut()
        until(lambda: rig.gateway.link.reachable, "it is back", 30)


def test_a_stop_right_after_a_start_waits_for_what_the_planner_tells(
    rig: Rig, odometry: Odometry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The modules were killed and are back, while a goal of the planner's own client goes on."""
    rig.planner.cancels = unmoved
    Asked(rig.client, pose(5.0), f"/planner/{PLANNER}/navigate_to_pose")
    goal = rig.planner.until(1)
    rig.state(State.MOVING, "its own client")
    said: list[str] = []

    def starting(module: GatewayModule, host: Host, section: Section) -> None:
        """Stop before any message arrives: in one step of the module's thread."""
        start(module, host, section)
        module.gateway.stop()
        module.gateway.when_confirmed(said.append)

    start = GatewayModule.start
    monkeypatch.setattr(GatewayModule, "start", starting)
    restart(rig)
    until(lambda: said, "the stop is answered", 20)
    assert "the robot may still be moving" in said.pop()
    rig.planner.on(goal.canceled)
    rig.state(State.IDLE)
    odometry.speed = 0.0
    restart(rig)
    until(lambda: said, "the stop is answered", 20)
    assert said == [""], "nothing drives"


def restart(rig: Rig) -> None:
    running = rig.worker.running("gateway")
    running.stop()
    running.start()


def test_a_planner_that_tells_nothing_is_said_not_to_answer(rig: Rig) -> None:
    Asked(rig.client, pose(5.0))
    goal = rig.planner.until(1)
    rig.state(State.MOVING)
    assert rig.gateway.link.telemetry.silent == 0.0, "a planner without any telemetry so far may not publish it at all"
    rig.planner.on(lambda: goal.feedback({"current_pose": pose(0.5)}))
    told = rig.state(State.MOVING, "move_base does not answer: no status or feedback for 0.5 s")
    assert told["error_code"] == Fault.SILENT
    health = rig.module.health()
    assert (health.state, "does not answer" in health.text) == ("waiting", True)
    rig.planner.on(lambda: goal.feedback({"current_pose": pose(0.6)}))
    until(lambda: rig.statuses[-1]["error_code"] == 0, "it answers again", 20)


def test_how_far_it_is_where_the_planner_does_not_say_it(rig: Rig, odometry: Odometry) -> None:
    """MoveBaseFeedback has a pose and nothing else; its other fields would be zero: there."""
    asked = Asked(rig.client, pose(odometry.x + 40.0))
    goal = rig.planner.until(1)

    def fed() -> dict[str, Any]:
        count = len(asked.feedback)
        rig.planner.on(lambda: goal.feedback({"current_pose": pose(odometry.x)}))
        until(lambda: len(asked.feedback) > count, "feedback comes", 20)
        return asked.feedback[-1]

    until(lambda: 30.0 < fed()["distance_remaining"] < 39.9, "straight to the goal, and less and less", 20)
    until(lambda: fed()["estimated_time_remaining"]["sec"] > 60, "the time at 0.3 m/s", 20)
    out = rig.far.advertise("/move_base/NavfnROS/plan", "nav_msgs/Path")
    corner = [pose(odometry.x), pose(odometry.x, 30.0), pose(odometry.x + 40.0, 0.2)]
    rig.far.publish(out, {"header": {"frame_id": "map"}, "poses": corner})
    until(lambda: fed()["distance_remaining"] == pytest.approx(80.0, abs=5.0), "the path's length", 20)


def test_how_far_it_is_stays_unset_where_it_cannot_be_known(rig: Rig) -> None:
    asked = Asked(rig.client, pose(40.0, frame="dock"))
    goal = rig.planner.until(1)
    rig.planner.on(lambda: goal.feedback({"current_pose": pose(0.0)}))
    until(lambda: asked.feedback, "feedback comes", 20)
    assert not asked.feedback[0]["distance_remaining"] < 1e9
    assert asked.feedback[0]["estimated_time_remaining"] == {"sec": 0, "nanosec": 0}


def test_a_planner_that_does_not_come_back_is_not_held_for_ever(
    rig: Rig, odometry: Odometry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who drives by hand on its side is to reach the base again."""
    holds = hears(rig, "/navigation/hold", "std_msgs/msg/Bool")
    asked = Asked(rig.client, pose(5.0))
    rig.planner.until(1)
    rig.planners.pop(PLANNER).close()
    try:
        rig.state(State.MOVING, f"{PLANNER} is not available")
        asked.cancel()
        until(lambda: holds[-1:] == [{"data": True}], "its velocities are held", 20)
        odometry.speed = 0.0
        assert asked.end()[0] == "CANCELED"
        assert rig.gateway.held
        monkeypatch.setattr(stop, "HELD_SECONDS", 0.0)
        until(lambda: holds[-1] == {"data": False}, "the velocities are no longer held", 20)
        rig.state(State.IDLE, "the base stands")
    finally:
        rig.planner = rig.have(PLANNER)
