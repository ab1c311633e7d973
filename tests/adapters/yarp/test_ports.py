"""Ports and topics: rules, reconnection, content, loops, commands, late joiners."""

from __future__ import annotations

import itertools
import time
from typing import Any

import pytest

from bridge.adapters.yarp import topics
from bridge.hub.wire.qos import Qos
from tests.adapters.yarp.conftest import Place
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.ports import text_client
from yarp_compat.wire.profile import Profile

TWIST = "geometry_msgs/Twist"
SHORT = ["linear.x", "linear.y", "angular.z"]


def velocity(x: float) -> dict[str, Any]:
    return {"linear": {"x": x, "y": 0.5, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.25}}


def test_port_in_a_rule_is_a_topic_again_when_it_returns(place: Place) -> None:
    rule = {"port": "/joystick:o", "topic": "/joy", "type": "geometry_msgs/msg/Twist", "direction": "in",
            "fields": SHORT, "carrier": "fast_tcp"}  # fmt: skip
    bridge = place.bridge(rule)
    subscription = place.far.subscribe("/joy", TWIST)
    assert "/joystick:o" not in str(place.far.publishers("/joy"))
    for count in (1, 2):
        port = place.port("/joystick:o")
        until(lambda p=port: p.core.outputs(), "the bridge connects the port", 10)
        assert port.core.outputs()[0].carrier == "fast_tcp"
        expected = velocity(float(count))  # of the first port, several messages may have arrived
        until(
            lambda p=port, c=count, e=expected: p.write([c, 0.5, 0.25]) or e in place.far.wait(subscription, c, 0.2),
            "a message is bridged",
        )
        assert place.far.wait(subscription, count)[-1] == expected
        port.stop()
        place.far.until_unpublished("/joy")
    bridge.stop()


def test_topic_is_written_to_the_port_in_a_rule_again_when_it_returns(place: Place) -> None:
    rule = {"port": "/base/control:i", "topic": "/cmd_vel", "direction": "out", "profile": "yarp4",
            "fields": [3, "linear.x", "linear.y", "deg(angular.z)", 100.0]}  # fmt: skip
    place.bridge(rule)
    out = place.far.advertise("/cmd_vel", TWIST)
    for _ in range(2):
        port = place.port("/base/control:i", Profile.YARP4)
        until(lambda p=port: p.core.inputs(), "the bridge connects to the port", 10)
        place.far.publish(out, velocity(1.0))
        place.far.hub_publish_until(out, velocity(2.0), lambda p=port: p.bottles(1, 0.2))
        assert port.bottles()[-1][:3] in ([3, 1.0, 0.5], [3, 2.0, 0.5])
        assert port.bottles()[-1][3:] == [pytest.approx(14.3239449), 100.0]
        port.stop()


def test_one_topic_is_sent_in_two_contents_and_two_profiles(place: Place) -> None:
    """The topic's main port has the converter's layout; the rule's port has the rule's fields and profile."""
    place.bridge({"port": "/short", "topic": "/cmd_vel", "direction": "out", "fields": SHORT, "profile": "yarp4"})
    short, long = place.port("/short", Profile.YARP4), place.port("/long")
    out = place.far.advertise("/cmd_vel", TWIST)
    long.listen_to("/midspan/cmd_vel:o")
    until(lambda: short.core.inputs(), "the rule's port is connected")
    place.far.hub_publish_until(out, velocity(1.0), lambda: short.messages(1, 0.1) and long.messages(1, 0.1))
    assert short.bottles()[0] == [1.0, 0.5, 0.25]
    assert long.bottles()[0] == [[1.0, 0.5, 0.0], [0.0, 0.0, 0.25]]


def test_port_that_writes_to_a_topics_port_is_a_publisher(place: Place) -> None:
    place.bridge()
    out = place.far.advertise("/chat", "std_msgs/String")
    subscription = place.far.subscribe("/chat", "std_msgs/String")
    writer = place.port("/talker")
    writer.write_to("/midspan/chat:i")
    until(lambda: writer.write(["hello"]) or {"data": "hello"} in place.far.wait(subscription, 1, 0.2), "a message", 10)
    until(lambda: place.far.explain("/chat"), "explain reports the route", 10)
    writer.stop()
    place.far.drop(out)


def test_message_of_a_writer_that_leaves_at_once_is_bridged(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """``echo hello | yarp write ... /midspan/once:i`` registers, writes and leaves before the graph is updated."""
    monkeypatch.setattr(topics, "HOLD_SECONDS", 20.0)  # on a slow machine, an update of the graph may take long
    place.bridge({"topic": "/once", "type": "std_msgs/msg/String"})
    out = place.far.advertise("/dynamic", "std_msgs/String")
    until(lambda: place.names.client.query("/midspan/dynamic:i"), "the input port exists")
    place.far.until_published("/once")
    for number, topic in enumerate(("/once", "/dynamic")):
        subscription = place.far.subscribe(topic, "std_msgs/String")
        place.far.status()  # when the bridge answers, it also knows the subscription, which came earlier
        writer = place.port(f"/quick{number}")
        writer.write_to(f"/midspan{topic}:i")
        writer.write(["only"])
        writer.stop()
        assert place.far.wait(subscription, 1, 60) == [{"data": "only"}]
    place.far.drop(out)


def test_untyped_port_of_a_node_has_the_rules_type(place: Place) -> None:
    """C++ YARP's tools open ``/talk@/talker`` without a type."""
    place.bridge({"topic": "/talk", "type": "std_msgs/msg/String"})
    subscription = place.far.subscribe("/talk", "std_msgs/String")
    talker = place.port("/talk+@/talker")
    until(lambda: talker.core.outputs(), "the bridge connects the port")
    until(lambda: talker.write(["hello"]) or place.far.wait(subscription, 1, 0.2), "a message is bridged")
    out = place.far.advertise("/orders", "std_msgs/String")
    listener = place.port("/orders-@/listener")
    place.far.hub_publish_until(out, {"data": "go"}, lambda: listener.messages(1, 0.2))
    assert listener.bottles()[0] == ["go"]


def test_line_of_text_is_a_command(place: Place) -> None:
    """A client of the text carrier needs only a socket and two lines."""
    place.bridge({"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "fields": SHORT})
    subscription = place.far.subscribe("/cmd_vel", TWIST)
    place.far.until_published("/cmd_vel")
    query = place.names.client.query
    contact = until(
        lambda: (c := query("/midspan/cmd_vel:i")) and connections.responds(c) and c, "the input port listens"
    )
    until(
        lambda: (
            text_client.raw(contact, "someone", "d\r\n1.5 0.5 0.25\r\n", 40.0) and place.far.wait(subscription, 1, 0.3)
        ),
        "the command is bridged",
    )
    assert place.far.wait(subscription, 1)[0] == velocity(1.5)


def test_invalid_messages_are_counted_with_the_reason(place: Place) -> None:
    place.bridge({"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "fields": SHORT})
    subscription = place.far.subscribe("/cmd_vel", TWIST)
    place.far.until_published("/cmd_vel")
    writer = place.port("/writer")
    writer.write_to("/midspan/cmd_vel:i")
    until(lambda: writer.write([1, 0.5, 0.25]) or place.far.wait(subscription, 1, 0.2), "a valid message is bridged")
    for bad in ([1.0, 2.0], [1.0, "fast", 2.0], ["", [], {}], b"\xff" * 40):
        writer.write(bad)
    route = until(
        lambda: (
            (r := place.far.route("/cmd_vel", "in"))
            and r["drops"].get("bad") == 4
            and "not a Bottle" in r["error"]  # of the last one, which is set after it is counted
            and r
        ),
        "four messages are refused",
        10,
        every=0.1,
    )
    assert "/writer" in route["error"]
    until(
        lambda: writer.write([9, 0.5, 0.25]) or velocity(9.0) in place.far.wait(subscription, 2, 0.2),
        "the next valid message is bridged",  # one command would be dropped if this process stalled
    )


def test_output_connected_to_an_input_causes_no_loop(place: Place) -> None:
    place.bridge()
    out = place.far.advertise("/loop", "std_msgs/String")
    subscription = place.far.subscribe("/loop", "std_msgs/String")
    reader = place.port("/reader")
    reader.listen_to("/midspan/loop:o")
    until(lambda: place.names.client.query("/midspan/loop:i"), "the input port exists")
    until(lambda: _connect(place, "/midspan/loop:o", "/midspan/loop:i"), "the ports are connected")
    # the port may open before the bridge has subscribed on the hub
    place.far.hub_publish_until(out, {"data": "probe"}, lambda: reader.messages(1, 0.2))
    for number in range(5):
        place.far.publish(out, {"data": str(number)})
    until(lambda: ["4"] in reader.bottles(5, 0.2), "all messages arrive on YARP")
    received = [m for m in place.far.wait(subscription, 10_000, 0.5) if m["data"] != "probe"]
    assert len(received) <= 5  # at most the far end's own messages


def _connect(place: Place, source: str, target: str) -> bool:
    try:
        connections.connect(place.names.client, source, target)
    except OSError:
        return False
    return True


def test_late_joiner_on_yarp_receives_the_latched_message(place: Place) -> None:
    place.bridge()
    out = place.far.advertise("/map_name", "std_msgs/String", latched=True, depth=1)
    place.far.publish(out, {"data": "kitchen"})
    for name in ("/late1", "/late2"):
        reader = place.port(name)
        reader.listen_to("/midspan/map_name:o")
        assert reader.bottles(1, 20) == [["kitchen"]]
    place.far.drop(out)


def test_late_joiner_on_the_hub_receives_a_latched_rules_message(place: Place) -> None:
    place.bridge({"topic": "/mode", "type": "std_msgs/msg/String", "latched": True})
    writer = place.port("/writer")
    place.far.until_published("/mode")
    writer.write_to("/midspan/mode:i")
    writer.write(["manual"])

    def late() -> list[dict[str, Any]]:
        subscription = place.far.subscribe("/mode", "std_msgs/String", latched=True)
        messages = place.far.wait(subscription, 1, 0.3)
        place.far.drop(subscription)
        return messages

    assert until(late, "the latched message arrives") == [{"data": "manual"}]


def test_commands_are_neither_latched_nor_delivered_late(place: Place) -> None:
    place.bridge({"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist"})
    out = place.far.advertise("/cmd_vel", TWIST, latched=True, depth=1)
    early = place.port("/early")
    early.listen_to("/midspan/cmd_vel:o")
    speeds = itertools.count(1)

    def newest_arrives() -> bool:
        """Publish a command, and return whether it has arrived; then no earlier one is on its way to the late port."""
        speed = float(next(speeds))
        place.far.publish(out, velocity(speed))
        return any(bottle[0][0] == speed for bottle in early.bottles(int(speed), 0.2))

    until(newest_arrives, "a command arrives")
    late = place.port("/late")
    late.listen_to("/midspan/cmd_vel:o")
    assert late.messages(1, 1.0) == []
    subscription = place.far.subscribe("/cmd_vel", TWIST)
    writer = place.port("/writer")
    writer.write_to("/midspan/cmd_vel:i")
    now = time.time()
    until(
        lambda: writer.write([[1, 0, 0], [0, 0, 0]], f"1 {time.time()}") or place.far.wait(subscription, 1, 0.2),
        "a command is bridged",
    )
    writer.write([[7, 0, 0], [0, 0, 0]], f"2 {now - 5}")
    until(
        lambda: (place.far.route("/cmd_vel", "in") or {"drops": {}})["drops"].get("stale"),
        "the command is stale",
        every=0.1,
    )
    assert all(m["linear"]["x"] != 7.0 for m in place.far.wait(subscription, 2, 0.2))


def test_stalled_reader_does_not_delay_others(place: Place) -> None:
    place.bridge()
    out = place.far.advertise("/stream", "std_msgs/String")
    stuck, quick = place.port("/stuck"), place.port("/quick")
    release = []
    stuck.core.on_message = lambda _: until(lambda: release, "the reader is released", 60)
    stuck.listen_to("/midspan/stream:o")
    quick.listen_to("/midspan/stream:o")
    place.far.hub_publish_until(out, {"data": "probe"}, lambda: quick.messages(1, 0.2))
    for number in range(100):
        place.far.publish(out, {"data": str(number)})
    until(lambda: ["99"] in quick.bottles(100, 0.2), "the quick reader gets the last message", 10)
    release.append(True)


def test_rule_that_does_not_fit_the_type_is_explained(place: Place) -> None:
    place.bridge({"topic": "/wide", "fields": ["nothing"]})
    out = place.far.hub.publisher(
        "/wide", "std_msgs/msg/String", place.far.registry.ros2("std_msgs/msg/String").type_id, Qos()
    )
    line = until(lambda: [x for x in place.far.explain("/wide") if x["decision"] == "refused"], "a refusal", every=0.1)
    assert "has no field 'nothing'" in line[0]["why"]
    assert line[0]["cure"]
    out.close()


def test_text_reader_of_a_type_without_text_does_not_affect_others(place: Place) -> None:
    """A point cloud is not a Bottle: text carriers deliver nothing to readers, and other readers get all."""
    place.bridge(yarp={"as": "natural"})
    cloud = {"width": 1, "height": 1, "point_step": 16, "row_step": 16, "data": [0] * 16, "fields": [
        {"name": a, "offset": 4 * n, "datatype": 7, "count": 1} for n, a in enumerate("xyz")]}  # fmt: skip
    out = place.far.advertise("/cloud", "sensor_msgs/PointCloud2")
    text, binary = place.port("/text"), place.port("/binary")
    binary.listen_to("/midspan/cloud:o")
    until(lambda: _connect(place, "/midspan/cloud:o", "text://text"), "a reader connects by text")
    place.far.hub_publish_until(out, cloud, lambda: binary.messages(1, 0.2))
    assert text.messages(1, 0.3) == []
