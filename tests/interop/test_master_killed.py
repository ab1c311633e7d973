"""roscore is killed while move_base drives: with move_base's rospy stand-in, the whole daemon, and a hub program."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.client.actions import ActionClient, SentGoal
from bridge.hub.wire.qos import LATCHED
from bridge.messages.actions import STATUSES, GoalState, names
from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.node import HubNode
from tests.peers.peer import Peer
from tests.peers.ros1.network import ROS1_PYTHON
from tests.support.process import Process
from tests.support.wait import until

ACTION, TYPE, TWIST = "/move_base", "nav2_msgs/action/NavigateToPose", "geometry_msgs/msg/Twist"
STAND_IN = Path(__file__).parents[1] / "peers" / "ros1" / "move_base.py"
SECONDS = 40.0
FAR = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 800.0}, "orientation": {"w": 1.0}}}


class HubProgram(HubNode):
    """A program on the hub that receives the planner's status and sends goals."""

    def __init__(self, place: Deployment) -> None:
        super().__init__(place.settings("program", "p"))
        self.lists: list[dict[bytes, GoalState]] = []
        self.moving: list[float] = []
        self.ended: list[tuple[GoalState, Any, str]] = []
        self.client = ActionClient(self.node, ACTION, TYPE)
        self.node.subscription(names(ACTION).status, STATUSES, self._listed, LATCHED)
        self.node.subscription("/cmd_vel", TWIST, lambda message: self.moving.append(message["linear"]["x"]))

    def _listed(self, message: dict[str, Any]) -> None:
        self.lists.append({
            bytes(entry["goal_info"]["goal_id"]["uuid"]): GoalState(entry["status"])
            for entry in message["status_list"]
        })  # fmt: skip

    def send(self) -> SentGoal:
        return self.on(lambda: self.client.send({"pose": FAR}, lambda g, r, why: self.ended.append((g.status, r, why))))

    def active(self) -> list[bytes]:
        """Return the unfinished goals in the newest status list."""
        return [goal for goal, state in self.lists[-1].items() if not state.ended] if self.lists else []

    def drives_on(self, goal: bytes) -> None:
        """Check that the list still contains the goal, and that commands continue."""
        lists, commands = len(self.lists), len(self.moving)
        until(lambda: len(self.lists) >= lists + 3, "the list is still published", SECONDS)
        until(lambda: len(self.moving) >= commands + 10, "the commands continue", SECONDS)
        assert all(listed.get(goal) is GoalState.EXECUTING for listed in self.lists[lists:])

    @property
    def is_on_hub(self) -> bool:
        graph = self.hub.graph
        return any(graph.servers(name) for name in names(ACTION)[:3]) or bool(graph.publishers(names(ACTION).status))


@pytest.fixture
def program(running: Deployment) -> HubProgram:
    return running.keep(HubProgram(running))


@pytest.fixture
def stand_in(running: Deployment, program: HubProgram) -> Iterator[Process]:
    with Process([ROS1_PYTHON, STAND_IN, "0.5", "5.0"], running.master.env) as process:
        until(lambda: program.client.ready, "the planner is on the hub", SECONDS)
        until(lambda: program.lists and not any(program.lists), "the planner's first list is empty", SECONDS)
        yield process


def native_goal(running: Deployment) -> tuple[Peer, int]:
    """Return a ROS 1 client and its goal, which is being executed."""
    peer = running.ros1("native")
    sent = peer.ask("send_goal", action=ACTION, type="move_base_msgs/MoveBase", goal={"target_pose": FAR})["id"]
    assert peer.ask("goal", id=sent, until={"accepted": True})["accepted"]
    return peer, sent


def without_a_master(running: Deployment) -> None:
    running.master.kill()
    until(
        lambda: "no ROS 1 master" in str(running.worker("ros1").get("warnings")),
        "the master's loss is noticed",
        SECONDS,
    )


def test_the_goal_of_a_ros_1_client_continues_and_is_canceled(
    running: Deployment, program: HubProgram, stand_in: Process
) -> None:
    peer, sent = native_goal(running)
    (goal,) = until(program.active, "the goal is listed", SECONDS)
    program.drives_on(goal)
    without_a_master(running)
    program.drives_on(goal)
    running.master.start()
    until(
        lambda: running.worker("ros1").get("network") == running.master.call("getParam", "/run_id"),
        "the worker joins the new master",
        SECONDS,
    )
    program.drives_on(goal)
    assert all(state is GoalState.EXECUTING for listed in program.lists[1:] for state in listed.values())
    program.on(lambda: program.client.cancel(goal))
    assert peer.ask("goal", id=sent, until={"ends": 1})["status"] == 5, "PREEMPTED, as reported by its client"
    canceled = lambda: any(listed.get(goal) is GoalState.CANCELED for listed in program.lists)  # noqa: E731
    until(canceled, "the list reports the cancellation", SECONDS)
    until(lambda: program.moving[-1] == 0.0, "the base stands", SECONDS)
    assert stand_in.popen.poll() is None


def test_the_goal_of_a_hub_client_continues_and_a_killed_planner_is_lost(
    running: Deployment, program: HubProgram, stand_in: Process
) -> None:
    sent = program.send()
    until(lambda: program.active() == [sent.id], "the goal is listed", SECONDS)
    without_a_master(running)
    program.drives_on(sent.id)
    program.on(sent.cancel)
    until(lambda: program.ended, "the goal ends", SECONDS)
    assert program.ended.pop()[0] is GoalState.CANCELED
    sent = program.send()
    until(lambda: program.active() == [sent.id], "another goal is listed, still without a master", SECONDS)
    program.drives_on(sent.id)
    stand_in.signal(signal.SIGKILL)
    until(lambda: program.ended, "the client's goal ends", SECONDS)
    ((_, result, reason),) = program.ended
    assert (sent.accepted, result) == (True, None), "the planner sent no result"
    # zenoh may deliver the loss of the action's services before the reply that names the cause
    lost, left = "lost sight of the goal: its action server /move_base left", "left before it answered"
    assert reason == lost or reason.endswith(left)
    until(lambda: not program.is_on_hub, "the planner leaves the hub", SECONDS)
    assert program.lists[-1][sent.id] is GoalState.EXECUTING, "no list contains the goal's end"
