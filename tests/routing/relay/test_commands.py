"""Velocities between nodes of several ROS 2 releases on one hub: the relay treats them as routes do."""

from __future__ import annotations

import struct
import time

import pytest

from bridge.config.sections.navigation import HOLD, HOLD_TYPE
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED, History, Qos
from bridge.messages.json import from_json
from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.release_actions import REGISTRY
from tests.peers.zenoh.releases import HUMBLE, JAZZY, Nodes, ReleasePublisher, ReleaseSubscription
from tests.routing.relay.conftest import Relay, Relays
from tests.routing.relay.test_topics import STRING, Topics, connect, put_texts, texts, until_topics
from tests.support.wait import until

TWIST = "geometry_msgs/msg/Twist"
VELOCITY = Topics(TWIST, Qos(depth=1), "/cmd_vel")


def put_until_received(publisher: ReleasePublisher, subscription: ReleaseSubscription) -> None:
    """Publish velocities until one of them is received."""
    before = publisher._sequence

    def arrived() -> bool:
        put_with_age(publisher, 0.0)
        return any(sample.sequence > before for sample in subscription.samples)

    until(arrived, "a command arrives", every=0.05)


def drops(relay: Relay, reason: str) -> int:
    """Return how many messages of the topics were dropped for a reason."""
    return sum(topic.counters.drops[reason] for topic in relay.relay.topics().values())


def test_commands_are_neither_cached_nor_relayed_late(relay: Relays, node: Nodes) -> None:
    relay()
    topic = Topics(TWIST, LATCHED, "/cmd_vel")
    publisher, received = topic.publisher(node(HUMBLE)), topic.subscription(node(JAZZY))

    put_until_received(publisher, received)
    put_with_age(publisher, 5.0)
    late = publisher._sequence
    put_until_received(publisher, received)
    assert late not in [sample.sequence for sample in received.samples]
    put_with_age(publisher, 5.0, 0.0)
    late = publisher._sequence
    until(lambda: late in [sample.sequence for sample in received.samples], "a late zero arrives: it stops the base")
    joiner, before = topic.subscription(node(JAZZY)), publisher._sequence
    put_until_received(publisher, joiner)
    assert min(sample.sequence for sample in joiner.samples) > before


def test_a_rate_drops_velocities_but_not_zero(relay: Relays, node: Nodes) -> None:
    worker = relay({"topic": "/cmd_vel", "rate": 0.001})
    publisher, received = VELOCITY.publisher(node(HUMBLE)), VELOCITY.subscription(node(JAZZY))
    until(lambda: (put_with_age(publisher, 0.0), drops(worker, "rate"))[1], "a velocity is dropped", every=0.05)

    def arrived() -> bool:
        put_with_age(publisher, 0.0, 0.0)
        return any(sample.sequence > moving for sample in received.samples)

    moving = publisher._sequence
    until(arrived, "zero arrives", every=0.05)


def put_with_age(publisher: ReleasePublisher, age: float, x: float = 0.25) -> None:
    """Publish a velocity whose source timestamp is a few seconds old."""
    publisher._sequence += 1
    data = publisher._sequence.to_bytes(8, "little") + (time.time_ns() - int(age * 1e9)).to_bytes(8, "little")
    velocity = b"\0\1\0\0" + struct.pack("<6d", x, 0.0, 0.0, 0.0, 0.0, 0.0)
    publisher._declared(publisher.key).put(velocity, attachment=data + b"\x10" + publisher.gid)


def test_velocities_pass_only_while_no_gateway_holds_them(relay: Relays, node: Nodes, network: HubNetwork) -> None:
    worker, nodes = relay(), (node(HUMBLE), node(JAZZY))
    other = Topics(TWIST, Qos(depth=1), "/cmd_vel_other")
    velocities, others = VELOCITY.publisher(nodes[0]), other.publisher(nodes[0])
    received, unheld = VELOCITY.subscription(nodes[1]), other.subscription(nodes[1])
    put_until_received(velocities, received)
    put_until_received(others, unheld)
    gateway = Hub.open(network.settings("gateway"))
    holding = gateway.publisher(HOLD, HOLD_TYPE, REGISTRY.ros2(HOLD_TYPE).type_id, LATCHED, priority="state")
    try:
        holding.put(from_json(REGISTRY, HOLD_TYPE, {"data": True}))
        until(lambda: worker.hold.held, "velocities are held")
        until(lambda: (put_with_age(velocities, 0.0), drops(worker, "held"))[1], "a velocity is dropped", every=0.05)
        last = velocities._sequence
        put_until_received(others, unheld)
        holding.put(from_json(REGISTRY, HOLD_TYPE, {"data": False}))
        until(lambda: not worker.hold.held, "velocities are no longer held")
        put_until_received(velocities, received)
        assert last not in [sample.sequence for sample in received.samples]
    finally:
        gateway.close()


def test_a_publisher_with_a_history_of_all_does_not_make_commands_wait(relay: Relays, node: Nodes) -> None:
    """A reliable publisher that keeps all messages waits for a congested link, so commands would arrive late."""
    worker, topic = relay(), Topics(TWIST, Qos(history=History.KEEP_ALL), "/cmd_vel")
    publisher, received = topic.publisher(node(HUMBLE)), topic.subscription(node(JAZZY))
    put_until_received(publisher, received)
    (relayed,) = worker.relay.topics().values()
    assert [end._sink._blocks for end in relayed._publishers.values()] == [False]


def test_a_rate_drops_no_message_of_the_class_state(relay: Relays, node: Nodes) -> None:
    worker = relay({"topic": "/topic", "rate": 1.0, "priority": "state"})
    topic = Topics(STRING)
    publisher, received = topic.publisher(node(HUMBLE)), topic.subscription(node(JAZZY))
    until_topics(worker, 1)
    connect(publisher, received)
    values = put_texts(publisher)
    until(lambda: values[-1] in texts(received), "all messages arrive")
    assert texts(received) == values


@pytest.mark.parametrize("durability", ["volatile", "transient_local"])
def test_a_rule_sets_whether_messages_are_latched(relay: Relays, node: Nodes, durability: str) -> None:
    worker = relay({"topic": "/topic", "qos": {"durability": durability}})
    topic = Topics(STRING, LATCHED if durability == "volatile" else Qos(depth=1))
    nodes = node(HUMBLE), node(JAZZY)
    publisher, received = topic.publisher(nodes[0]), Topics(STRING, LATCHED).subscription(nodes[1])
    until_topics(worker, 1)
    connect(publisher, received)
    (relayed,) = worker.relay.topics().values()
    assert all((gid == publisher.gid) is (durability != "volatile") for _, gid in relayed._publishers)


def test_a_rule_latches_no_command(relay: Relays, node: Nodes) -> None:
    worker = relay({"topic": "/topic", "priority": "command", "qos": {"durability": "transient_local"}})
    topic = Topics(STRING, LATCHED)
    publisher, received = topic.publisher(node(HUMBLE)), topic.subscription(node(JAZZY))
    until_topics(worker, 1)
    connect(publisher, received)
    (relayed,) = worker.relay.topics().values()
    assert [gid for _, gid in relayed._publishers] == [b""], "only latched publishers have their own"
