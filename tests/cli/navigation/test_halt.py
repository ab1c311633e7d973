"""``midspan halt`` on a real hub: subscribers receive zero velocities, goals are canceled, bases are asked to halt."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote

import pytest
import yaml

from bridge.client.halt import ZeroVelocities
from bridge.client.session import Client
from bridge.clock import SYSTEM
from bridge.hub.control import WorkerAnswer
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.errors import HubError
from bridge.hub.graph.tokens import Origin
from bridge.hub.node import Hub
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
    """A node that subscribes to ``/cmd_vel`` and executes goals, and a client with two goals."""

    def __init__(self, network: HubNetwork, registry: Registry) -> None:
        self.loop = EventLoop("robot")
        self.node, far = (
            ModuleNode(Hub.open(network.settings(name)), registry, self.loop, SYSTEM) for name in ("robot", "client")
        )
        self._nodes = (self.node, far)
        self.received: list[dict[str, Any]] = []
        self.obeys = True
        self.loop.start()
        self.node.subscription("/cmd_vel", TWIST, self.received.append)
        server = self.node.action_server("/lookup", LOOKUP, lambda _goal: True, self.cancel)
        client = far.action_client("/lookup", LOOKUP)
        until(lambda: client.ready, "the action is available")
        self.sent = [client.send({}, lambda *_: None) for _ in range(2)]
        until(lambda: len(server.active) == 2, "both goals are executing")

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


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait longer for the replies of action servers: on a busy machine, one may take more than 1 s."""
    monkeypatch.setattr("bridge.client.halt._REPLY_SECONDS", 40.0)


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
        "/cmd_vel: zero velocity, 1 subscriber on the hub",
        "base_control of robot1: stands still",
        "/lookup: 2 goals canceled",
    ]
    assert halt_requests == [{}]
    until(lambda: [goal.status for goal in robot.sent] == [GoalState.CANCELED] * 2, "both goals were canceled")
    until(lambda: len(robot.received) > 3, "zero velocities arrive")
    assert all(message["linear"]["x"] == message["angular"]["z"] == 0.0 for message in robot.received)


@pytest.mark.parametrize("text", ["logg: {level: info}\n", "routing: {rules: [\n", "zenoh: {zenoh: /no/such/file}\n"])
def test_halt_does_not_depend_on_what_was_written_into_the_file_since(
    midspan: Midspan, robot: Robot, text: str
) -> None:
    """The daemon keeps its valid configuration."""
    midspan.config.write_text(yaml.safe_dump(yaml.safe_load(midspan.config.read_text())) + text)
    done = midspan("halt", "--seconds", "0.1")
    assert done.code == 0, done
    assert "/lookup: 2 goals canceled" in done.out
    assert done.err.endswith("; the rest of the file is used\n")
    assert midspan("nav", "status").code == 1, "only commands that stop the robot do so"


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
        "errors": {
            "base_control of robot1": "RuntimeError",
            "/lookup": "its server rejected the request, so its goals continue",
        },
    }


def test_a_short_halt_waits_for_the_replies_of_action_servers(midspan: Midspan, robot: Robot) -> None:
    done = midspan("halt", "--seconds", "0.01")
    assert done.code == 0, done
    assert "/lookup: 2 goals canceled" in done.out


def test_zero_is_repeated_although_the_command_was_starved(
    midspan: Midspan, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    put, starved = ZeroVelocities.put, [0.0]

    def put_and_starve(zeros: ZeroVelocities) -> None:
        put(zeros)
        starved[0] = 10.0

    monkeypatch.setattr(ZeroVelocities, "put", put_and_starve)
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + starved[0])
    monkeypatch.setattr("bridge.client.halt.time", clock)
    midspan("halt", "--seconds", "1")
    until(lambda: len(robot.received) >= 5, "zero is repeated")


def test_halt_fails_without_velocity_topics(midspan: Midspan) -> None:
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
    until(
        lambda: any(to_json(registry, TWIST, s.data())["linear"]["x"] == 0.0 for s in received),
        "a zero velocity arrives",
    )
    subscription.close()
    hub.close()


@pytest.mark.parametrize("form", [TWIST, TWIST_STAMPED])
def test_halt_reaches_a_base_on_a_side_that_no_program_of_the_hub_drives(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any], form: str
) -> None:
    """Only the planner on the same side drives this base; BaseControl on the hub accepts both types."""
    both = Hub.open(network.settings("base_control"))
    for name in (TWIST, TWIST_STAMPED):
        both.subscription("/cmd_vel", name, registry.ros2(name).type_id, Qos(), lambda _: None)
    worker = EngineWorker(network, registry)
    closing += [both, worker]
    received: list[bytes] = []
    worker.side.read_from("/cmd_vel", form, Qos(), MadeBy.NATIVE, "/base", lambda data, *_: received.append(data))
    until(lambda: both.graph.velocities(), "the base is announced")

    def is_reached() -> bool:
        """Return whether zero has reached the base; on a busy machine, its route may be created after the halt."""
        done = midspan("halt", "--seconds", "1")
        assert done.code == 0, done
        return done.out == "/cmd_vel: zero velocity, 3 subscribers on the hub\n" and bool(received)

    until(is_reached, "the base gets a zero velocity")
    twists = [to_json(registry, form, data) for data in received]
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


@pytest.fixture
def program(network: HubNetwork) -> Iterator[Any]:
    """A zenoh program that declares tokens on the hub."""
    with network.program() as session:
        yield session.liveliness()


def test_invalid_data_on_the_hub_does_not_prevent_the_halt(
    midspan: Midspan, network: HubNetwork, registry: Registry, robot: Robot, program: Any, closing: list[Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """The invalid data is a rule whose topic has wildcards, and tokens that any guest of the hub may declare."""
    monkeypatch.setattr("bridge.client.halt.WAIT_SECONDS", 1.0)
    halts: list[Any] = []
    closing.append(FakeWorker(network, "base_control", halt=lambda params: halts.append(params) or {"halted": True}))
    worker = EngineWorker(network, registry, rules=[{"topic": "/*/cmd_vel", "rename": "/cmd_vel"}])
    closing.append(worker)
    received: list[bytes] = []
    worker.side.read_from("/cmd_vel", TWIST, Qos(), MadeBy.NATIVE, "/base", lambda data, *_: received.append(data))
    domain = network.domain
    twist, cancel = "geometry_msgs::msg::dds_::Twist_", "action_msgs::srv::dds_::CancelGoal_"
    tokens = [
        f"@midspan/{domain}/velocity/z/%2F%2A%2Fcmd_vel/{quote(TWIST, safe='')}",
        f"@midspan/{domain}/velocity/z/nonsense/{quote(TWIST_STAMPED, safe='')}",
        f"@midspan/{domain}/velocity/z/%2Fcmd_vel/nonsense",
        f"@ros2_lv/{domain}/z/0/1/MP/%/%/n/%a b/{twist}/{registry.ros2(TWIST).type_id}/::,7:,:,:,,",
        f"@ros2_lv/{domain}/z/0/2/MP/%/%/n/%a/{twist}/nonsense/::,7:,:,:,,",
        f"@ros2_lv/{domain}/z/0/3/SS/%/%/n/%a%_action%cancel_goal/{cancel}/nonsense/::,7:,:,:,,",
    ]
    declared = [program.declare_token(token) for token in tokens]
    graph = robot.node.hub.graph
    until(lambda: graph.servers("/a/_action/cancel_goal") and graph.velocities(), "the tokens are known")
    done = midspan("halt", "--seconds", "1")
    assert (done.code, halts) == (1, [{}])
    assert "/a: not canceled: the server of /a/_action/cancel_goal does not accept calls" in done.out
    assert "/lookup: 2 goals canceled" in done.out
    assert "base_control of robot1: stands still" in done.out
    assert f"/a: zero could not be published as {TWIST} (type hash 'nonsense' is not" in done.err
    assert [line for line in done.err.splitlines() if "a b" in line or "*" in line] == []
    until(lambda: [goal.status for goal in robot.sent] == [GoalState.CANCELED] * 2, "both goals were canceled")
    until(lambda: robot.received, "the robot gets a zero velocity")

    def is_reached() -> bool:
        """Return whether zero has reached the side; on a busy machine, its route may be created after the halt."""
        if not received:
            midspan("halt", "--seconds", "1")
        return bool(received)

    until(is_reached, "the side gets a zero velocity")
    assert {to_json(registry, TWIST, data)["linear"]["x"] for data in received} == {0.0}
    for token in declared:
        token.undeclare()


def test_zero_does_not_wait_for_an_action_server_that_is_unreachable(
    midspan: Midspan, network: HubNetwork, registry: Registry, robot: Robot, program: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr("bridge.client.halt.WAIT_SECONDS", 1.0, raising=False)
    type_hash = registry.service_ros2("action_msgs/srv/CancelGoal").type_id
    cancel = f"%a%_action%cancel_goal/action_msgs::srv::dds_::CancelGoal_/{type_hash}"
    token = program.declare_token(f"@ros2_lv/{network.domain}/z/0/3/SS/%/%/n/{cancel}/::,7:,:,:,,")
    until(lambda: robot.node.hub.graph.servers("/a/_action/cancel_goal"), "the server is announced")
    done = midspan("halt", "--seconds", "0.05")
    assert done.code == 1
    assert "/a: not canceled" in done.out
    until(lambda: len(robot.received) > 5, "zero velocities that were repeated meanwhile arrive")
    token.undeclare()


def test_zero_is_sent_in_each_form_that_has_a_subscriber(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    """A monitor subscribes to Twist, and a worker that announces no velocities to TwistStamped, for its base."""
    worker = FakeWorker(network, "ros2")
    closing.append(worker)
    worker.hub.set_origin(Origin("ros2", "network", "robot1"))
    received: list[HubSample] = []
    monitor = Hub.open(network.settings("monitor"))
    closing.append(monitor)
    monitor.subscription("/cmd_vel", TWIST, registry.ros2(TWIST).type_id, Qos(), lambda _: None)
    stamped = registry.ros2(TWIST_STAMPED).type_id
    worker.hub.subscription("/cmd_vel", TWIST_STAMPED, stamped, Qos(), received.append)
    until(
        lambda: monitor.graph.origins() and len(monitor.graph.subscriptions("/cmd_vel")) == 2,
        "both subscribers are known",
    )
    assert midspan("halt", "--seconds", "0.5").code == 0
    twists = until(
        lambda: [to_json(registry, TWIST_STAMPED, s.data()) for s in received], "the base gets a zero velocity"
    )
    assert {twist["twist"]["linear"]["x"] for twist in twists} == {0.0}


def test_a_base_that_appears_during_the_halt_gets_zero(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    late = Hub.open(network.settings("late"))
    closing.append(late)
    received: list[HubSample] = []
    type_id = registry.ros2(TWIST).type_id

    def halts(_params: dict[str, Any]) -> dict[str, Any]:
        late.subscription("/late/cmd_vel", TWIST, type_id, Qos(), received.append)
        return {"halted": True}

    closing.append(FakeWorker(network, "base_control", halt=halts))
    done = midspan("halt", "--seconds", "3")
    assert "/late/cmd_vel: zero velocity, 1 subscriber" in done.out
    until(lambda: received, "the base gets a zero velocity")


def test_a_module_that_does_not_answer_is_reported(
    midspan: Midspan, network: HubNetwork, closing: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bridge.client.halt._ANSWER_SECONDS", 5.0)  # the other module may answer late
    released = threading.Event()
    closing.append(FakeWorker(network, "base_control", halt=lambda _params: released.wait(30)))
    closing.append(FakeWorker(network, "robot_goto", halt={"halted": True}))
    done = midspan("halt", "--seconds", "0.1")
    released.set()
    assert (done.code, done.out) == (1, "robot_goto of robot1: stands still\n")
    assert "a module has not answered within 5 s: its base may still be moving" in done.err


def test_bases_that_cannot_be_asked_are_reported(
    midspan: Midspan, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    ask = Client.ask

    def fails(client: Client, verb: str, *args: Any, **more: Any) -> Any:
        if verb == "halt":
            raise HubError("no answer can be read")
        return ask(client, verb, *args, **more)

    monkeypatch.setattr(Client, "ask", fails)
    done = midspan("halt", "--seconds", "0.5")
    assert done.code == 1
    assert "bases could not be asked to halt and may still be moving: no answer can be read" in done.err
    assert "/lookup: 2 goals canceled" in done.out
    until(lambda: robot.received, "a zero velocity arrives")


@pytest.mark.parametrize("errors", [("it moves", ""), ("", "it moves")])
def test_of_two_bases_with_the_same_name_the_moving_base_is_reported(
    midspan: Midspan, monkeypatch: pytest.MonkeyPatch, errors: tuple[str, str]
) -> None:
    def answers(_client: Client, verb: str, *_args: Any, **_more: Any) -> list[WorkerAnswer]:
        halted = {"halted": True}
        return [WorkerAnswer("robot1", "base_control", halted, error) for error in errors] if verb == "halt" else []

    monkeypatch.setattr(Client, "ask", answers)
    done = midspan("halt", "--seconds", "0.1")
    assert (done.code, done.out) == (1, "base_control of robot1: it moves\n")


@pytest.mark.parametrize("value", [None, {}, {"halted": False}, "halted"])
def test_an_answer_that_does_not_confirm_the_halt_is_not_a_success(
    midspan: Midspan, monkeypatch: pytest.MonkeyPatch, value: object
) -> None:
    def answers(_client: Client, verb: str, *_args: Any, **_more: Any) -> list[WorkerAnswer]:
        return [WorkerAnswer("robot1", "base_control", value)] if verb == "halt" else []

    monkeypatch.setattr(Client, "ask", answers)
    done = midspan("halt", "--seconds", "0.1")
    assert (done.code, done.out) == (
        1, f"base_control of robot1: its answer does not confirm the halt: {value!r}\n"
    )  # fmt: skip


def test_halt_reaches_subscribers_over_a_slow_network(
    midspan: Midspan, network: HubNetwork, registry: Registry
) -> None:
    received: list[Any] = []
    with Hub.open(network.settings("robot")) as hub, FaultProxy(network.port) as slow:
        hub.subscription("/cmd_vel", TWIST, registry.ros2(TWIST).type_id, Qos(), received.append)
        until(lambda: midspan("topic", "list").out.split() == ["/cmd_vel"], "the router knows the topic")
        slow.delay = 0.15
        done = midspan("halt", "--seconds", "0.5", "--router", f"tcp/127.0.0.1:{slow.port}")
        assert (done.code, done.out) == (0, "/cmd_vel: zero velocity, 1 subscriber on the hub\n"), done
        until(lambda: received, "a zero velocity arrives")


def test_halt_does_not_report_a_stop_that_is_uncertain(
    midspan: Midspan, network: HubNetwork, closing: list[Any], tmp_path: Path
) -> None:
    def halt(_params: object) -> object:
        raise HubError("it may still be moving: the planner move_base is not available")

    file = config_file(tmp_path, network)
    file.write_text(json.dumps(yaml.safe_load(file.read_text()) | {"navigation": {"planner": "move_base"}}))
    done = midspan("halt", "--seconds", "0.2")
    assert done.code == 1
    assert "neither the gateway nor the planner move_base is on the hub" in done.err
    closing.append(FakeWorker(network, "gateway", halt=halt))
    done = midspan("halt", "--seconds", "0.2")
    assert done.code == 1
    assert "gateway of robot1: it may still be moving: the planner move_base is not available" in done.out
