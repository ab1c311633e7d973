"""Velocities of a stopped planner do not enter the hub."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.config.sections.navigation import HOLD, HOLD_TYPE, NavigationSection
from bridge.config.sections.routing import RoutingSection
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from bridge.routing.engine import Engine
from bridge.routing.hold import Hold, held_topics
from tests.hub.test_links import cut
from tests.peers.fake import FakeEdge, FakeNetwork
from tests.peers.hub.quick import QuickHub
from tests.peers.zenoh.releases import JAZZY, ReleaseNode, ReleasePublisher, Topic
from tests.support.wait import until

TWIST = "geometry_msgs/msg/Twist"
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
REGISTRY = Registry()


@pytest.fixture
def hubs() -> Iterator[QuickHub]:
    with QuickHub() as network:
        yield network


class Gateway:
    """A gateway's publisher of holds."""

    def __init__(self, hubs: QuickHub) -> None:
        self.hub = Hub.open(hubs.settings("gateway"))
        self._out = self.hub.publisher(HOLD, HOLD_TYPE, REGISTRY.ros2(HOLD_TYPE).type_id, LATCHED, priority="state")

    def publish(self, held: bool) -> None:
        self._out.put(from_json(REGISTRY, HOLD_TYPE, {"data": held}))


def test_only_velocities_of_the_planners_side_are_held() -> None:
    section = NavigationSection.model_validate({"planner": "move_base", "velocity": "/robot/cmd_vel"})
    assert held_topics(section, "ros1") == {"/robot/cmd_vel"}
    assert not held_topics(section, "ros2")
    assert not held_topics(NavigationSection(planner="robot_goto"), "ros1")


def test_gateway_report_counts_before_the_graph_lists_the_gateway() -> None:
    looks, hears, present = list[Callable[[], None]](), list[Callable[[Any], None]](), list[Any]()
    graph = SimpleNamespace(watch=looks.append, publishers=lambda _topic: present)
    hub = SimpleNamespace(graph=graph, subscription=lambda *given: hears.append(given[-1]))
    hold = Hold(cast("Any", hub), {"/cmd_vel"})
    (look,), (hear,) = looks, hears
    assert not hold.held
    for gid, held in ((b"first", True), (b"second", False)):
        data = from_json(REGISTRY, HOLD_TYPE, {"data": held})
        hear(SimpleNamespace(gid=gid, data=lambda data=data: data))
    present.append(SimpleNamespace(gid=b"second", zid="2"))
    look()
    assert not hold.held
    present.append(SimpleNamespace(gid=b"first", zid="1"))
    look()
    assert hold.held
    present.pop()
    look()
    assert not hold.held


def test_hold_ends_when_the_link_to_a_gateway_is_restored(hubs: QuickHub) -> None:
    """The gateway publishes only changes, and the subscription received its last message before the link was lost."""
    gateway, hub = Gateway(hubs), Hub.open(hubs.settings("midspan_fake"))
    hold = Hold(hub, {"/cmd_vel"})
    lost = threading.Event()
    try:
        gateway.publish(held=False)
        until(lambda: hub.graph.publishers(HOLD) and not hold.held, "velocities are not held")
        hub.graph.watch(lambda: hub.graph.publishers(HOLD) or lost.set())
        cut(int(hubs.endpoint.rpartition(":")[2]))
        assert lost.wait(40.0), "the gateway has left the graph"
        until(lambda: hub.graph.publishers(HOLD) and not hold.held, "velocities are not held after its return")
        gateway.publish(held=True)
        until(lambda: hold.held, "velocities are held")
    finally:
        hold.close()
        for session in (hub, gateway.hub):
            session.close()


def test_velocities_enter_the_hub_only_while_no_gateway_holds_them(hubs: QuickHub) -> None:
    network, gateway = FakeNetwork(), Gateway(hubs)
    far, hub = Hub.open(hubs.settings("far")), Hub.open(hubs.settings("midspan_fake"))
    received: list[bytes] = []
    far.subscription("/cmd_vel", TWIST, "*", Qos(depth=1), lambda sample: received.append(sample.data()))
    until(lambda: hub.graph.publishers(HOLD), "the gateway is discovered")
    hold = Hold(hub, {"/cmd_vel"})
    assert hold.held, "a gateway that has not sent a message yet may want a hold"
    engine = Engine(FakeEdge(network, REGISTRY), hub, RoutingSection(), "test", pytest.fail, REGISTRY, hold)
    engine.start()
    try:
        drives = network.write_on("/cmd_vel", TWIST, Qos(depth=1), MadeBy.NATIVE, "/move_base")
        looks = network.write_on("/scan_vel", TWIST, Qos(depth=1), MadeBy.NATIVE, "/move_base")
        until(
            lambda: {"/cmd_vel", "/scan_vel"} <= {route.hub_topic for route in engine.routes()},
            "both topics are bridged",
        )
        before, during, after = (from_json(REGISTRY, TWIST, {"linear": {"x": x}}) for x in (0.4, 0.5, 0.6))

        def drop(velocity: bytes) -> int:
            network.write(drives, velocity)
            network.write(looks, velocity)
            return {route.topic: route for route in engine.status().routes}["/cmd_vel"].drops.get("held", 0)

        until(lambda: drop(before), "the velocity is dropped before the gateway's first message")
        gateway.publish(held=False)
        until(lambda: drop(before) and before in received, "the velocity is bridged")
        gateway.publish(held=True)
        until(lambda: hold.held, "velocities are held")
        count = drop(during)
        assert drop(during) == count + 1
        gateway.hub.close()  # a gateway that has left wants no hold; its goals are canceled
        until(lambda: not hold.held, "velocities are no longer held")
        until(lambda: drop(after) and after in received, "the velocity is bridged again")
        assert during not in received  # a velocity from before the hold may still have been on its way
    finally:
        engine.stop()
        hold.close()
        for session in (far, hub):
            session.close()


def test_velocities_of_a_planner_on_the_hub_leave_it_only_while_no_gateway_holds_them(hubs: QuickHub) -> None:
    network, gateway = FakeNetwork(), Gateway(hubs)
    hub, midspan = Hub.open(hubs.settings("midspan_fake")), Hub.open(hubs.settings("midspan_modules"))
    node = ReleaseNode(hubs.endpoint, hubs.domain, "planner", JAZZY)
    type_hash = REGISTRY.ros2(TWIST).type_id
    native = ReleasePublisher(node, Topic("/cmd_vel", TWIST, type_hash, Qos(depth=1)))
    zeros = midspan.publisher("/cmd_vel", TWIST, type_hash, Qos(depth=1), priority="command")
    received: list[bytes] = []
    network.read_from(
        "/cmd_vel", TWIST, Qos(depth=1), MadeBy.NATIVE, "/base", lambda data, _source, _time: received.append(data)
    )
    hold = Hold(hub, (), {"/cmd_vel"})
    engine = Engine(FakeEdge(network, REGISTRY), hub, RoutingSection(), "test", pytest.fail, REGISTRY, hold)
    engine.start()
    velocity, zero = (from_json(REGISTRY, TWIST, {"linear": {"x": x}}) for x in (0.4, 0.0))

    def arrives(payload: bytes, put: Callable[[bytes], Any]) -> None:
        received.clear()
        until(lambda: (put(payload), payload in received)[1], "it is bridged", every=0.05)

    def held() -> int:
        native.put(velocity)
        return {route.topic: route for route in engine.status().routes}["/cmd_vel"].drops.get("held", 0)

    try:
        gateway.publish(held=False)
        until(lambda: hub.graph.publishers(HOLD) and not hold.held, "the gateway is discovered")
        arrives(velocity, native.put)
        gateway.publish(held=True)
        until(lambda: hold.held, "velocities are held")
        until(held, "a velocity is dropped", every=0.05)
        arrives(zero, zeros.put)
        assert velocity not in received
        gateway.publish(held=False)
        until(lambda: not hold.held, "velocities are no longer held")
        arrives(velocity, native.put)
    finally:
        engine.stop()
        hold.close()
        for session in (hub, midspan, gateway.hub, node):
            session.close()
