"""Latched messages in both directions, per publisher."""

from __future__ import annotations

from collections.abc import Callable

from bridge.hub.wire.qos import Durability, Qos
from bridge.routing.edge import Kind
from tests.adapters.ros2.conftest import RunningEdge, string
from tests.peers.peer import Peer
from tests.support.wait import until

LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)


def test_a_late_subscription_receives_the_last_message_of_each_native_publisher(
    edge: RunningEdge, peer: Callable[..., Peer]
) -> None:
    natives = [peer(f"latched{number}") for number in range(3)]
    endpoints = [native.advertise("/l/in", "std_msgs/String", latched=True, depth=1) for native in natives]
    for number, (native, endpoint) in enumerate(zip(natives, endpoints, strict=True)):
        native.publish(endpoint, {"data": f"old {number}"})
        native.publish(endpoint, {"data": f"last {number}"})
    publishers = edge.until_seen("/l/in", Kind.PUBLISHER, 3)

    first = edge.subscribe("/l/in", "std_msgs/msg/String", LATCHED)
    until(lambda: len(first.messages) >= 3, "three retained messages arrive")
    assert first.texts() == ["last 0", "last 1", "last 2"]
    assert {source for _, source, _ in first.messages} == {e.id for e in publishers}

    natives[1].drop(endpoints[1])
    edge.until_seen("/l/in", Kind.PUBLISHER, 2)
    second = edge.subscribe("/l/in", "std_msgs/msg/String", LATCHED)
    until(lambda: len(second.messages) >= 2, "two retained messages arrive")
    assert second.texts() == ["last 0", "last 2"]


def test_a_publisher_that_starts_after_the_subscription_is_received_from_its_first_message(
    edge: RunningEdge, peer: Callable[..., Peer]
) -> None:
    inbox = edge.subscribe("/l/first", "std_msgs/msg/String", LATCHED)
    native = peer()
    native.publish(native.advertise("/l/first", "std_msgs/String", latched=True, depth=1), {"data": "only"})
    until(lambda: inbox.messages, "the only message arrives")
    assert inbox.texts() == ["only"]


def test_a_late_native_subscriber_receives_the_last_message_of_each_source(
    edge: RunningEdge, peer: Callable[..., Peer]
) -> None:
    publisher = edge.edge.advertise("/l/out", edge.type("std_msgs/msg/String"), LATCHED)
    for number in range(3):
        for data in (f"old {number}", f"last {number}"):
            publisher.send(string(data), f"source{number}")
    native = peer()
    first = native.subscribe("/l/out", "std_msgs/String", latched=True, depth=10)
    assert sorted(m["data"] for m in native.wait(first, 3)) == ["last 0", "last 1", "last 2"]

    publisher.drop_source("source1")
    until(lambda: native.graph()["publishers"]["/l/out"] == ["midspan"] * 2, "one writer leaves")
    second = native.subscribe("/l/out", "std_msgs/String", latched=True, depth=10)
    assert sorted(m["data"] for m in native.wait(second, 2)) == ["last 0", "last 2"]


def test_topic_stays_advertised_when_all_sources_are_forgotten(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    publisher = edge.edge.advertise("/l/empty", edge.type("std_msgs/msg/String"), LATCHED)
    publisher.send(string("gone"), "source")
    publisher.drop_source("source")
    publisher.drop_source("never seen")
    native = peer()
    subscription = native.subscribe("/l/empty", "std_msgs/String", latched=True)
    edge.until_seen("/l/empty", Kind.SUBSCRIPTION)
    until(lambda: native.graph()["publishers"].get("/l/empty") == ["midspan"], "the spare writer is listed")
    publisher.send(string("new"), "other")
    assert [m["data"] for m in native.wait(subscription, 1)] == ["new"]
