"""Bytes in both directions between the edge and real rclpy programs."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.routing.edge import Kind
from tests.adapters.ros2.conftest import RunningEdge, string, text
from tests.adapters.ros2.graph.test_graph import marked_profile
from tests.peers.peer import Peer
from tests.support.wait import until

MARKER = {
    "ns": "a",
    "id": 7,
    "text": "hello",
    "points": [{"x": 1.0, "y": 2.0, "z": 3.0}],
    "scale": {"x": 0.5, "y": 0.0, "z": 0.25},
}


def test_messages_of_a_native_publisher_are_received(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    native = peer()
    publisher = native.advertise("/m/in", "std_msgs/String")
    inbox = edge.subscribe("/m/in", "std_msgs/msg/String")
    (endpoint,) = edge.until_seen("/m/in", Kind.PUBLISHER)

    def delivered() -> bool:
        native.publish(publisher, {"data": "grüß"})
        return bool(inbox.messages)

    until(delivered, "a message from the native publisher arrives")
    payload, source, time_ns = inbox.messages[0]
    assert text(payload) == "grüß"
    assert source == endpoint.id
    assert time_ns is not None


def test_a_type_crosses_without_its_message_package(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    """Type support is created from name and hash, so no package is needed here."""
    native = peer()
    publisher = native.advertise("/m/relay_in", "visualization_msgs/Marker")
    subscription = native.subscribe("/m/relay_out", "visualization_msgs/Marker")
    inbox = edge.subscribe("/m/relay_in", "visualization_msgs/msg/Marker")
    ours = edge.edge.advertise("/m/relay_out", edge.type("visualization_msgs/msg/Marker"), Qos())
    convert = edge.conversion("visualization_msgs/msg/Marker").convert
    assert convert is not None

    def received() -> list[dict[str, Any]]:
        native.publish(publisher, MARKER)
        for payload, _, _ in inbox.messages:
            ours.send(convert(payload), "hub")
        return native.wait(subscription, 1, 0.1)

    message = until(received, "the native subscription receives the edge's message")[0]
    assert {key: message[key] for key in MARKER} == MARKER
    assert "visualization_msgs" not in sys.modules


def timer_switches() -> int:
    """Return how often Fast DDS's timer threads of this process have slept."""
    total = 0
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # another thread has ended meanwhile
            if (task / "comm").read_text().startswith("dds.ev"):
                _, _, after = (task / "status").read_text().partition("\nvoluntary_ctxt_switches:")
                total += int(after.split()[0])
    return total


def test_messages_do_not_wake_the_timer_thread(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    native = peer()
    subscription = native.subscribe("/m/timers", "std_msgs/String")
    ours = edge.edge.advertise("/m/timers", edge.type("std_msgs/msg/String"), Qos())

    def received() -> bool:
        ours.send(string("first"), "hub")
        return bool(native.wait(subscription, 1, 0.1))

    until(received, "the native subscription receives a message")
    count, before, begun = len(native.wait(subscription, 1)), timer_switches(), time.monotonic()
    for number in range(count + 1, count + 201):
        ours.send(string("next"), "hub")
        native.wait(subscription, number)  # one at a time
    heartbeats = 5 * (time.monotonic() - begun)  # and other periodic events, which do not depend on the messages
    assert timer_switches() - before < 100 + heartbeats  # without the profile at least one per message


@pytest.mark.parametrize("size", [1_000_000, 6_000_000])
def test_large_messages_are_bridged_in_both_directions(edge: RunningEdge, peer: Callable[..., Peer], size: int) -> None:
    native = peer()
    subscription = native.subscribe("/m/large_out", "std_msgs/String")
    publisher = native.advertise("/m/large_in", "std_msgs/String")
    inbox = edge.subscribe("/m/large_in", "std_msgs/msg/String")
    ours = edge.edge.advertise("/m/large_out", edge.type("std_msgs/msg/String"), Qos())
    payload = string("x" * size)

    def both() -> bool:
        native.publish(publisher, {"data": "y" * size})
        ours.send(payload, "hub")
        return bool(inbox.messages) and bool(native.wait(subscription, 1, 0.5))

    until(both, "large messages cross in both directions")
    assert len(inbox.messages[0][0]) == size + 9
    assert native.wait(subscription, 1)[0]["data"] == "x" * size


def test_best_effort_and_reliable_publishers_of_one_topic_are_both_received(
    edge: RunningEdge, peer: Callable[..., Peer]
) -> None:
    native = peer()
    sensor = native.advertise("/m/mixed", "std_msgs/String", best_effort=True)
    edge.until_seen("/m/mixed", Kind.PUBLISHER)
    inbox = edge.subscribe("/m/mixed", "std_msgs/msg/String", Qos(Reliability.BEST_EFFORT))
    reliable = native.advertise("/m/mixed", "std_msgs/String")
    latched = native.advertise("/m/mixed", "std_msgs/String", latched=True)
    edge.until_seen("/m/mixed", Kind.PUBLISHER, 3)

    def all_heard() -> bool:
        for number, endpoint in enumerate((sensor, reliable, latched)):
            native.publish(endpoint, {"data": str(number)})
        return len({source for _, source, _ in inbox.messages}) == 3

    until(all_heard, "messages of all three publishers arrive")


def test_no_message_arrives_twice_if_publishers_have_different_qos(
    edge: RunningEdge, peer: Callable[..., Peer]
) -> None:
    native = peer()
    publishers = [
        native.advertise("/m/once", "std_msgs/String", **qos)
        for qos in ({"best_effort": True}, {}, {"latched": True, "depth": 30})
    ]
    edge.until_seen("/m/once", Kind.PUBLISHER, 3)
    inbox = edge.subscribe("/m/once", "std_msgs/msg/String", Qos(durability=Durability.TRANSIENT_LOCAL))

    def warm() -> bool:
        for endpoint in publishers:
            native.publish(endpoint, {"data": "warm"})
        return len({source for _, source, _ in inbox.messages}) == 3

    until(warm, "messages of all three publishers arrive")
    expected = []
    # One at a time: on a busy machine, best effort or a history of ten may lose messages of a burst.
    for number in range(20):
        for endpoint in publishers:
            expected.append(f"{endpoint}-{number}")
            native.publish(endpoint, {"data": expected[-1]})
            until(lambda: expected[-1] in inbox.texts(), "the message arrives")
    assert [t for t in inbox.texts() if t != "warm"] == sorted(expected)


def test_messages_of_another_midspan_are_not_delivered(
    edge: RunningEdge, peer: Callable[..., Peer], tmp_path: Path
) -> None:
    profile, _ = marked_profile(tmp_path)
    other = peer("innocent_name", FASTRTPS_DEFAULT_PROFILES_FILE=str(profile))
    native = peer("midspan_native")
    endpoints = [(p, p.advertise("/m/guard", "std_msgs/String", latched=True)) for p in (other, native)]
    guard = edge.edge.advertise(
        "/m/guard", edge.type("std_msgs/msg/String"), Qos(durability=Durability.TRANSIENT_LOCAL)
    )
    inbox = edge.subscribe("/m/guard", "std_msgs/msg/String", Qos(durability=Durability.TRANSIENT_LOCAL))
    edge.until_seen("/m/guard", Kind.PUBLISHER, 2)

    def native_heard() -> bool:
        guard.send(string("own"), "hub")
        for program, endpoint in endpoints:
            program.publish(endpoint, {"data": "other" if program is other else "native"})
        return len(inbox.messages) >= 3

    until(native_heard, "three native messages arrive")
    texts = {text(payload) for payload, _, _ in inbox.messages}
    assert texts == {"native"}


def test_malformed_bytes_are_refused_before_publishing(edge: RunningEdge) -> None:
    convert = edge.conversion("geometry_msgs/msg/Twist").convert
    assert convert is not None
    for junk in (b"", b"\0\1\0\0", b"\0\1\0\0" + bytes(44)):
        with pytest.raises(ConversionError):
            convert(junk)


def test_a_different_type_hash_is_reported(edge: RunningEdge) -> None:
    with pytest.raises(MessageTypeError, match="RIHS01_0000") as caught:
        edge.edge.from_hub("std_msgs/msg/String", "RIHS01_" + "0" * 64)
    assert caught.value.cure


def test_a_subscription_with_incompatible_qos_is_reported(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    native = peer("late_map_user")
    native.subscribe("/m/deaf", "std_msgs/String", latched=True)
    native.subscribe("/m/hears", "std_msgs/String")
    edge.edge.advertise("/m/deaf", edge.type("std_msgs/msg/String"), Qos(Reliability.BEST_EFFORT))
    edge.edge.advertise("/m/hears", edge.type("std_msgs/msg/String"), Qos())
    edge.until_seen("/m/deaf", Kind.SUBSCRIPTION)
    edge.until_seen("/m/hears", Kind.SUBSCRIPTION)
    (warning,) = edge.edge.warnings()
    assert "/m/deaf" in warning
    assert "/late_map_user" in warning
    assert "best effort" in warning
    assert "volatile" in warning


def test_a_closed_subscription_stops_delivering(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    native = peer()
    publisher = native.advertise("/m/closed", "std_msgs/String")
    closed: list[bytes] = []
    subscription = edge.edge.subscribe(
        "/m/closed", edge.type("std_msgs/msg/String"), Qos(), lambda payload, _s, _t: closed.append(payload)
    )
    inbox = edge.subscribe("/m/closed", "std_msgs/msg/String")
    edge.until_seen("/m/closed", Kind.PUBLISHER)

    def delivered() -> bool:
        native.publish(publisher, {"data": "a"})
        return bool(closed) and bool(inbox.messages)

    until(delivered, "both subscriptions deliver messages")
    subscription.close()
    subscription.close()
    others = len(inbox.messages)

    def more() -> bool:
        native.publish(publisher, {"data": "b"})
        return len(inbox.messages) > others + 3

    until(more, "the other subscription still delivers messages")
    assert {text(payload) for payload in closed} == {"a"}, "a delivery may have been in progress"


def test_an_invalid_topic_name_is_refused_with_a_clear_error(edge: RunningEdge) -> None:
    with pytest.raises(MessageTypeError, match="ROS 2 does not accept /m/1x as std_msgs/msg/String"):
        edge.edge.advertise("/m/1x", edge.type("std_msgs/msg/String"), Qos())


def test_a_second_type_of_one_topic_is_refused_with_a_clear_error(edge: RunningEdge) -> None:
    edge.subscribe("/m/two", "std_msgs/msg/String")
    for second in (
        lambda: edge.subscribe("/m/two", "std_msgs/msg/Int32"),
        lambda: edge.edge.advertise("/m/two", edge.type("std_msgs/msg/Int32"), Qos()),
    ):
        with pytest.raises(
            MessageTypeError, match="/m/two is already bridged to ROS 2 as std_msgs/msg/String"
        ) as refused:
            second()
        assert "type: std_msgs/msg/Int32" in refused.value.cure
    edge.edge.advertise("/m/two", edge.type("std_msgs/msg/String"), Qos()).close()
