"""``midspan halt`` on a real hub: subscribers receive zero, goals are canceled, a base is queried."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.clock import SYSTEM
from bridge.hub.errors import HubError
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import GoalState
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.modules.action_server import Goal
from bridge.modules.host import ModuleNode
from bridge.modules.loop import EventLoop
from bridge.routing.edge import MadeBy
from tests.cli.conftest import Midspan, config_file
from tests.peers.daemon.workers import EngineWorker, FakeWorker
from tests.peers.hub.network import HubNetwork
from tests.support.faults import FaultProxy
from tests.support.wait import until

LOOKUP = "tf2_msgs/action/LookupTransform"
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"


class Robot:
    """A node that drives by ``/cmd_vel`` and pursues goals, and a client with two of them."""

    def __init__(self, network: HubNetwork, registry: Registry) -> None:
        self.loop = EventLoop("robot")
        self.node, far = (
            ModuleNode(Hub.open(network.settings(name)), registry, self.loop, SYSTEM) for name in ("robot", "client")
        )
        self._nodes = (self.node, far)
        self.heard: list[dict[str, Any]] = []
        self.obeys = True
        self.loop.start()
        self.node.subscription("/cmd_vel", TWIST, self.heard.append)
        server = self.node.action_server("/lookup", LOOKUP, lambda _goal: True, self.cancel)
        client = far.action_client("/lookup", LOOKUP)
        until(lambda: client.ready, "the action is there")
        self.sent = [client.send({}, lambda *_: None) for _ in range(2)]
        until(lambda: len(server.active) == 2, "both goals are pursued")

    def cancel(self, goal: Goal) -> bool:
        if self.obeys:
            self.loop.post(goal.canceled)
        return self.obeys

    def close(self) -> None:
        for node in self._nodes:
            node.close()
        self.loop.close()
        for node in self._nodes:
            node.hub.close()


@pytest.fixture
def robot(network: HubNetwork, registry: Registry) -> Iterator[Robot]:
    fake_robot = Robot(network, registry)
    yield fake_robot
    fake_robot.close()


def test_halt_stops_everything(midspan: Midspan, network: HubNetwork, robot: Robot, closing: list[Any]) -> None:
    halt_requests: list[Any] = []
    closing.append(
        FakeWorker(network, "base_control", halt=lambda params: halt_requests.append(params) or {"halted": True})
    )
    done = midspan("halt", "--seconds", "1")
    assert done.code == 0, done
    assert done.out.splitlines() == [
        "/cmd_vel: zero velocity, 1 listener on the hub",
        "base_control of robot1: stands still",
        "/lookup: 2 goals cancelled",
    ]
    assert halt_requests == [{}]
    until(lambda: [goal.status for goal in robot.sent] == [GoalState.CANCELED] * 2, "both goals were cancelled")
    assert len(robot.heard) > 3
    assert all(message["linear"]["x"] == message["angular"]["z"] == 0.0 for message in robot.heard)


def test_halt_reports_what_does_not_stop(
    midspan: Midspan, network: HubNetwork, robot: Robot, closing: list[Any]
) -> None:
    def fails(_params: dict[str, Any]) -> None:
        raise RuntimeError

    robot.obeys = False
    closing.append(FakeWorker(network, "base_control", halt=fails))
    done = midspan("halt", "--seconds", "0.5", "--json")
    assert done.code == 1
    assert done.json() == {
        "topics": {"/cmd_vel": 1},
        "goals": {"/lookup": 0},
        "bases": {"base_control of robot1": False},
        "errors": {"base_control of robot1": "RuntimeError"},
    }


def test_nothing_to_halt(midspan: Midspan) -> None:
    done = midspan("halt", "--seconds", "0.1")
    assert (done.code, "nothing to halt" in done.err) == (1, True)


def test_halt_sends_zeros_if_velocities_are_published(
    midspan: Midspan, network: HubNetwork, registry: Registry
) -> None:
    hub = Hub.open(network.settings("planner"))
    type_id = registry.ros2(TWIST).type_id
    publisher = hub.publisher("/far/cmd_vel", TWIST, type_id, Qos())
    received: list[Any] = []
    subscription = hub.subscription("/far/cmd_vel", TWIST, type_id, Qos(), received.append)
    publisher.put(from_json(registry, TWIST, {"linear": {"x": 1.0}}))
    assert midspan("halt", "--seconds", "0.3").code == 0
    until(lambda: any(to_json(registry, TWIST, s.data())["linear"]["x"] == 0.0 for s in received), "zero is heard")
    subscription.close()
    hub.close()


@pytest.mark.parametrize("form", [TWIST, TWIST_STAMPED])
def test_halt_reaches_a_base_on_a_side_that_no_program_of_the_hub_drives(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any], form: str
) -> None:
    """Its own side's planner drives it; BaseControl on the hub accepts both forms."""
    both = Hub.open(network.settings("base_control"))
    for name in (TWIST, TWIST_STAMPED):
        both.subscription("/cmd_vel", name, registry.ros2(name).type_id, Qos(), lambda _: None)
    worker = EngineWorker(network, registry)
    closing += [both, worker]
    received: list[bytes] = []
    worker.side.read_from("/cmd_vel", form, Qos(), MadeBy.NATIVE, "/base", lambda data, *_: received.append(data))
    until(lambda: both.graph.velocities(), "the base is announced")
    done = midspan("halt", "--seconds", "1")
    assert (done.code, done.out) == (0, "/cmd_vel: zero velocity, 3 listeners on the hub\n"), done
    twists = [to_json(registry, form, data) for data in received]
    assert twists
    assert all(twist.get("twist", twist)["linear"]["x"] == 0.0 for twist in twists)
    if form == TWIST_STAMPED:
        assert twists[-1]["header"]["frame_id"] == "base_link"
        assert twists[-1]["header"]["stamp"]["sec"]


def test_halt_reports_a_base_on_a_side_that_zero_does_not_reach(
    midspan: Midspan, network: HubNetwork, closing: list[Any]
) -> None:
    worker = FakeWorker(network, "ros2")
    closing.append(worker)
    worker.hub.graph.announce_velocity("/far/cmd_vel", TWIST_STAMPED)
    done = midspan("halt", "--seconds", "0.1")
    assert done.code == 1
    assert f"/far/cmd_vel: nodes of a side subscribe to {TWIST_STAMPED}, and zero does not reach them" in done.err


def test_halt_over_a_slow_network(midspan: Midspan, network: HubNetwork, registry: Registry) -> None:
    received: list[Any] = []
    with Hub.open(network.settings("robot")) as hub, FaultProxy(network.port) as slow:
        hub.subscription("/cmd_vel", TWIST, registry.ros2(TWIST).type_id, Qos(), received.append)
        until(lambda: midspan("topic", "list").out.split() == ["/cmd_vel"], "the router knows it")
        slow.delay = 0.15
        done = midspan("halt", "--seconds", "0.5", "--router", f"tcp/127.0.0.1:{slow.port}")
        assert (done.code, done.out) == (0, "/cmd_vel: zero velocity, 1 listener on the hub\n"), done
        until(lambda: received, "zero is heard")


def test_halt_does_not_report_a_stop_that_is_uncertain(
    midspan: Midspan, network: HubNetwork, closing: list[Any], tmp_path: Path
) -> None:
    def halt(_params: object) -> object:
        raise HubError("it may still be moving: the planner move_base is not there")

    file = config_file(tmp_path, network)
    file.write_text(json.dumps(yaml.safe_load(file.read_text()) | {"navigation": {"planner": "move_base"}}))
    done = midspan("halt", "--seconds", "0.2")
    assert done.code == 1
    assert "neither the gateway nor the planner move_base is on the hub" in done.err
    closing.append(FakeWorker(network, "gateway", halt=halt))
    done = midspan("halt", "--seconds", "0.2")
    assert done.code == 1
    assert "gateway of robot1: it may still be moving: the planner move_base is not there" in done.out
