"""Velocities are published with the type that the base subscribes to, never with both types."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest

from bridge.client.velocity import VelocityForm, VelocityPublisher, subscribers
from bridge.clock import RunClock
from bridge.config.sections.section import Enabled
from bridge.hub.graph.tokens import Origin
from bridge.hub.node import Hub
from bridge.hub.wire.keys import ANY_HASH
from bridge.hub.wire.qos import Qos
from bridge.messages.velocities import TWIST, TWIST_STAMPED
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

CMD_VEL = "/cmd_vel"


class Robot:
    """Nodes and sides on a hub that subscribe to velocities, and a program that reads the graph."""

    def __init__(self, hubs: HubNetwork) -> None:
        self._hubs = hubs
        self._hub = Hub.open(hubs.settings("far"))
        self.graph = self._hub.graph
        self._sessions: list[Hub] = [self._hub]

    def node(self, name: str, *type_names: str) -> Hub:
        hub = Hub.open(self._hubs.settings(name))
        self._sessions.append(hub)
        for type_name in type_names:
            hub.subscription(CMD_VEL, type_name, ANY_HASH, Qos(), lambda _: None)
        return hub

    def side(self, name: str, type_name: str) -> Hub:
        hub = self.node(name)
        hub.set_origin(Origin(name, "network", "robot1"))
        hub.graph.announce_velocity(CMD_VEL, type_name)
        return hub

    def has(self, expected: dict[str, list[str]], endpoints: int = 0) -> Callable[[], bool]:
        """Return a function: whether exactly these subscribers, and this number of hub subscriptions, are known."""

        def known() -> bool:
            return len(self.graph.subscriptions(CMD_VEL)) == endpoints and subscribers(self.graph, CMD_VEL) == expected

        return known

    def close(self) -> None:
        for hub in reversed(self._sessions):
            hub.close()


@pytest.fixture
def robot() -> Iterator[Robot]:
    with HubNetwork() as hubs:
        robot_ = Robot(hubs)
        yield robot_
        robot_.close()


class Published(list[tuple[str, Mapping[str, Any]]]):
    """Records published messages with their types, and the types that have a publisher."""

    def __init__(self) -> None:
        self.open: list[str] = []
        self.reports: list[str] = []

    def open_as(self, type_name: str) -> Output:
        assert not self.open, "only one type has a publisher at a time"
        self.open.append(type_name)
        return Output(self, type_name)

    def publisher(self, robot: Robot, stamped: Enabled = "auto", clock: RunClock | None = None) -> VelocityPublisher:
        form = VelocityForm(CMD_VEL, stamped, "base_footprint")
        return VelocityPublisher(robot.graph, form, clock or RunClock(), self.open_as, self.reports.append)

    @property
    def forward(self) -> list[tuple[str, float]]:
        """The type and the speed of each message."""
        return [(type_name, message.get("twist", message)["linear"]["x"]) for type_name, message in self]


class Output:
    def __init__(self, published: Published, type_name: str) -> None:
        self._published, self._type_name = published, type_name

    def publish(self, message: Mapping[str, Any]) -> None:
        self._published.append((self._type_name, message))

    def close(self) -> None:
        self._published.open.remove(self._type_name)


def test_nodes_that_accept_one_form_and_sides_count_as_subscribers(robot: Robot) -> None:
    robot.node("base_control", TWIST, TWIST_STAMPED)
    robot.node("foxglove", TWIST)
    robot.node("midspan_cli_7", TWIST)
    robot.node("record_7", TWIST)  # midspan record
    until(robot.has({}, endpoints=5), "the subscribers are known")
    robot.node("base", TWIST_STAMPED)
    until(robot.has({TWIST_STAMPED: ["/base"]}, endpoints=6), "the subscribers are known")
    side = robot.side("ros2", TWIST)
    # the subscription of a route, which exists with or without a base
    side.subscription(CMD_VEL, TWIST_STAMPED, ANY_HASH, Qos(), lambda _: None)
    until(robot.has({TWIST: ["ros2"], TWIST_STAMPED: ["/base"]}, endpoints=7), "the subscribers are known")
    side.close()
    until(robot.has({TWIST_STAMPED: ["/base"]}, endpoints=6), "the subscribers are known")


def test_a_change_of_form_publishes_zero_in_the_old_form_first(robot: Robot) -> None:
    published = Published()
    publisher = published.publisher(robot)
    publisher.publish(0.1)
    side = robot.side("ros2", TWIST_STAMPED)
    until(robot.has({TWIST_STAMPED: ["ros2"]}), "the subscribers are known")
    publisher.publish(0.2, 0.0, 0.5)
    assert published.forward == [(TWIST, 0.1), (TWIST, 0.0), (TWIST_STAMPED, 0.2)]
    assert published[-1][1]["twist"] == {"linear": {"x": 0.2, "y": 0.0}, "angular": {"z": 0.5}}
    side.close()
    until(robot.has({}), "the subscribers are known")
    publisher.publish()
    assert published.forward[-1] == (TWIST_STAMPED, 0.0), "after a restart of the base, the type is kept"
    robot.node("base", TWIST)
    until(robot.has({TWIST: ["/base"]}, endpoints=1), "the subscribers are known")
    publisher.follow()
    assert (published.open, published.forward[-1]) == ([TWIST], (TWIST_STAMPED, 0.0))
    publisher.close()
    assert published.open == []


def test_a_publisher_that_was_not_used_publishes_no_zero(robot: Robot) -> None:
    published = Published()
    publisher = published.publisher(robot)
    robot.side("ros2", TWIST_STAMPED)
    until(robot.has({TWIST_STAMPED: ["ros2"]}), "the subscribers are known")
    publisher.follow()
    assert (published, published.open) == ([], [TWIST_STAMPED])


def test_subscribers_to_both_forms_are_reported_once_and_get_one_form(robot: Robot) -> None:
    robot.node("base", TWIST)
    robot.side("ros2", TWIST_STAMPED)
    until(robot.has({TWIST: ["/base"], TWIST_STAMPED: ["ros2"]}, endpoints=1), "the subscribers are known")
    published = Published()
    publisher = published.publisher(robot)
    publisher.publish(0.1)
    publisher.publish(0.2)
    assert published.forward == [(TWIST, 0.1), (TWIST, 0.2)]
    (report,) = published.reports
    assert f"{TWIST} (/base) and {TWIST_STAMPED} (ros2): only {TWIST} is published; navigation.stamped" in report


@pytest.mark.parametrize(("stamped", "type_name"), [(True, TWIST_STAMPED), (False, TWIST)])
def test_a_configured_form_does_not_follow_the_base(robot: Robot, stamped: Enabled, type_name: str) -> None:
    other = {TWIST: TWIST_STAMPED, TWIST_STAMPED: TWIST}[type_name]
    robot.side("ros2", other)
    until(robot.has({other: ["ros2"]}), "the subscribers are known")
    published = Published()
    published.publisher(robot, stamped).publish(0.1)
    assert (published.forward, published.reports) == ([(type_name, 0.1)], [])


def test_stamps_are_from_the_runs_clock(robot: Robot) -> None:
    clock = RunClock(simulated=True)
    clock.receive(bytes(4) + (12).to_bytes(4, "little") + (34).to_bytes(4, "little"))
    published = Published()
    published.publisher(robot, True, clock).publish(0.1)
    assert published[0][1]["header"] == {"stamp": {"sec": 12, "nanosec": 34}, "frame_id": "base_footprint"}
