"""Endpoints of other releases, in which types have different fields: Nav2's actions, messages and services."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bridge.client.errors import ClientError
from bridge.hub.endpoints.calls import CallError, Done, nothing
from bridge.hub.wire.keys import ANY_HASH, pack_attachment
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter
from tests.messages.fleet import RULES, WHEEL, write_package, write_versions
from tests.peers.hub.network import HubNetwork
from tests.peers.hub.node import HubNode
from tests.peers.zenoh.release_actions import (
    REGISTRY,
    SUCCEEDED,
    ReleaseActionClient,
    ReleaseActionServer,
    ReleaseTypes,
    hash_in,
)
from tests.peers.zenoh.releases import (
    CPU_GROUP,
    HUMBLE,
    JAZZY,
    KILTED,
    LYRICAL,
    Nodes,
    Release,
    ReleaseClient,
    ReleasePublisher,
    ReleaseServer,
    ReleaseSubscription,
    Topic,
)
from tests.support.wait import until

OTHERS = pytest.mark.parametrize("release", [HUMBLE, KILTED, LYRICAL], ids=lambda release: release.name)
TO_POSE, THROUGH_POSES = "nav2_msgs/action/NavigateToPose", "nav2_msgs/action/NavigateThroughPoses"
POSES = [{"header": {"frame_id": "map"}, "pose": {"position": {"x": x}}} for x in (1.0, 2.0)]
FEEDBACK = {"distance_remaining": 2.5, "number_of_recoveries": 3}
ID = bytes(range(16))


@pytest.fixture
def own(network: HubNetwork) -> Iterator[HubNode]:
    with HubNode(network.settings("midspan")) as node:
        yield node


def result_of(release: Release, **fields: Any) -> dict[str, Any]:
    return fields if release is not HUMBLE else {}


@OTHERS
def test_navigate_to_pose_of_another_release_can_be_called(own: HubNode, node: Nodes, release: Release) -> None:
    result = result_of(release, error_code=7, error_msg="seven")
    server = ReleaseActionServer(node(release), "/navigate", TO_POSE, FEEDBACK, result)
    client = own.on(lambda: own.node.action_client("/navigate", TO_POSE))
    until(lambda: client.ready, "the server is ready")
    ends: list[Any] = []
    feedback: list[dict[str, Any]] = []
    own.on(lambda: own.node.subscription("/navigate/_action/feedback", f"{TO_POSE}_FeedbackMessage", feedback.append))
    sent = own.on(lambda: client.send({"pose": POSES[0]}, lambda *end: ends.append(end), goal_id=ID))
    until(lambda: ends, "the goal ends")
    assert sent.status == SUCCEEDED
    assert (ends[0][1]["error_code"], ends[0][1]["error_msg"]) == ((7, "seven") if result else (0, ""))
    assert server.goals[-1]["goal"]["pose"]["pose"]["position"]["x"] == 1.0
    until(lambda: feedback, "feedback arrives")
    assert (bytes(feedback[-1]["goal_id"]["uuid"]), feedback[-1]["feedback"]["distance_remaining"]) == (ID, 2.5)
    assert set(feedback[-1]["feedback"]) == {
        "current_pose", "navigation_time", "estimated_time_remaining", "number_of_recoveries", "distance_remaining",
    }  # fmt: skip
    own.on(lambda: client.cancel(ID))
    until(lambda: server.canceled, "the cancel request arrives")
    server.close()
    until(lambda: not client.ready, "the server has left")


@OTHERS
def test_navigate_through_poses_of_another_release_can_be_called(own: HubNode, node: Nodes, release: Release) -> None:
    server = ReleaseActionServer(node(release), "/navigate", THROUGH_POSES, FEEDBACK, {})
    client = own.on(lambda: own.node.action_client("/navigate", THROUGH_POSES))
    until(lambda: client.ready, "the server is ready")
    ends: list[Any] = []
    own.on(lambda: client.send({"poses": POSES}, lambda *end: ends.append(end)))
    until(lambda: ends, "the goal ends")
    poses = server.goals[-1]["goal"]["poses"]
    poses = poses if release is HUMBLE else poses["goals"]
    assert [pose["pose"]["position"]["x"] for pose in poses] == [1.0, 2.0]
    assert [pose["header"]["frame_id"] for pose in poses] == ["map", "map"]
    server.close()


@OTHERS
def test_a_client_of_another_release_calls_an_action_of_the_hub(own: HubNode, node: Nodes, release: Release) -> None:
    goals: list[Any] = []

    def take(goal: Any) -> bool:
        goals.append(goal)
        goal.execute()
        return True

    own.on(lambda: own.node.action_server("/navigate", THROUGH_POSES, take))
    peer = node(release)
    query = "@ros2_lv/**/SS/**/%navigate%_action%get_result/**"
    until(lambda: [*peer.session.liveliness().get(query)], "the server is seen")
    client = ReleaseActionClient(peer, "/navigate", THROUGH_POSES)
    assert client.send(ID, {"poses": POSES if release is HUMBLE else {"goals": POSES}})["accepted"]
    until(lambda: goals, "the goal arrives")
    assert [pose["pose"]["position"]["x"] for pose in goals[0].goal["poses"]] == [1.0, 2.0]

    def reported() -> bool:
        own.on(lambda: goals[0].feedback(FEEDBACK))
        return bool(client.feedback())

    until(reported, "feedback arrives", every=0.05)
    assert client.feedback()[-1]["number_of_recoveries"] == 3
    own.on(lambda: goals[0].succeed({"error_msg": "done"}))
    result = client.result(ID)
    assert result["status"] == SUCCEEDED
    assert release is HUMBLE or result["result"]["error_msg"] == "done"
    assert release is HUMBLE or len(result["result"]["waypoint_statuses"]) == 0


TRACE = "lifecycle_msgs/msg/TransitionEvent"
STREAMS = [
    (HUMBLE, "sensor_msgs/msg/Range", {"range": 2.5, "max_range": 8.0}, {"range": 2.5, "variance": 0.0}),
    (LYRICAL, TRACE, {"goal_state": {"id": 3, "label": "active"}}, {"goal_state": {"id": 3, "label": "active"}}),
]


def within(part: dict[str, Any], message: dict[str, Any]) -> bool:
    return all(message[name] == value for name, value in part.items())


@pytest.mark.parametrize("qos", [Qos(depth=10), replace(LATCHED, depth=5)], ids=["volatile", "latched"])
@pytest.mark.parametrize(("release", "type_name", "there", "here"), STREAMS, ids=["humble", "lyrical"])
def test_topics_of_another_release_are_converted_in_both_directions(
    own: HubNode, node: Nodes, release: Release, type_name: str, there: Any, here: Any, qos: Qos
) -> None:
    peer = ReleaseTypes(node(release))
    received: list[dict[str, Any]] = []
    publisher = ReleasePublisher(peer.node, peer.topic("/in", type_name, qos))
    publisher.put(peer.encode(type_name, there))  # a late subscription receives the message if the topic is latched
    own.on(lambda: own.node.subscription("/in", type_name, received.append, qos))
    if qos.latched:
        until(lambda: received, "the cached message arrives")
        publisher.put(peer.encode(type_name, there))
        until(lambda: len(received) == 2, "the next message arrives")
    else:
        until(lambda: (publisher.put(peer.encode(type_name, there)), received)[1], "the message arrives", every=0.05)
    assert all(within(here, message) for message in received)
    out = own.on(lambda: own.node.publisher("/out", type_name, qos))
    out.publish(here)
    heard = ReleaseSubscription(peer.node, peer.topic("/out", type_name, qos))
    until(lambda: qos.latched or (out.publish(here), heard.samples)[1], "the subscription is matched", every=0.05)
    until(lambda: heard.samples, "the message arrives")
    messages = [peer.decode(type_name, sample.payload) for sample in heard.samples]
    common = {name: value for name, value in there.items() if name in here}
    assert all(within(common, message) for message in messages)
    numbers = [sample.sequence for sample in heard.samples]
    assert len(set(numbers)) == len(numbers)


def test_a_tool_receives_each_message_once_and_unconverted(network: HubNetwork, own: HubNode, node: Nodes) -> None:
    """A subscription to any hash also sees the key of the other release."""
    lyrical, type_hash = ReleaseTypes(node(LYRICAL)), REGISTRY.ros2(TRACE).type_id
    heard = ReleaseSubscription(lyrical.node, lyrical.topic("/out", TRACE))
    with HubNode(network.settings("tool")) as tool:
        payloads: list[bytes] = []
        tool.hub.subscription("/out", TRACE, ANY_HASH, Qos(depth=100), lambda sample: payloads.append(sample.data()))
        out = own.on(lambda: own.node.publisher("/out", TRACE))
        until(
            lambda: (out.publish({"timestamp": 1}), heard.samples and payloads)[1],
            "both subscriptions are matched",
            every=0.05,
        )
        # the tool drops a converted message even if it did not receive the original (here number 1000)
        (converted,) = out._publisher._more.values()
        converted.send(out.encoded({"timestamp": 5}), pack_attachment(1000, 1, out._publisher.gid))
        until(lambda: heard.samples[-1].sequence == 1000, "the other release receives the message")
        out.publish({"timestamp": 9})
        until(lambda: decoded(payloads[-1], type_hash) == 9, "the last message arrives")
        times = [decoded(payload, type_hash) for payload in payloads]
        assert set(times) == {1, 9}
        assert times.count(9) == 1


def decoded(payload: bytes, type_hash: str) -> int:
    return int(MessageReader(REGISTRY.schema(TRACE, type_hash), payload).message()["timestamp"])


def test_the_server_with_the_hubs_version_is_called_first(own: HubNode, node: Nodes) -> None:
    """A server with another version of the type is called only while no server has the hub's version."""
    clear = "nav2_msgs/srv/ClearEntireCostmap"
    lyrical, jazzy = ReleaseTypes(node(LYRICAL)), ReleaseTypes(node(JAZZY))
    requests: list[str] = []

    def serve(peer: ReleaseTypes, reply: dict[str, Any]) -> ReleaseServer:
        def answer(request: bytes) -> bytes:
            requests.append(peer.node.release.name)
            peer.decode(clear, request, "Request")
            return peer.encode(clear, reply, "Response")

        return ReleaseServer(peer.node, peer.topic("/clear", clear), answer)

    serve(lyrical, {"success": True})
    client = own.on(lambda: own.node.client("/clear", clear))
    until(lambda: client.ready, "a server is seen")
    assert client.ask({}, 20.0) == {"response": {}}
    other = serve(jazzy, {})
    until(lambda: len(own.hub.graph.servers("/clear")) == 2, "both servers are seen")
    until(lambda: (client.ask({}, 20.0), requests[-1] == "jazzy")[1], "the other server is called", every=0.05)
    other.close()
    until(lambda: len(own.hub.graph.servers("/clear")) == 1, "the server has left")

    def lyrical_called() -> bool:
        with suppress(ClientError):  # zenoh may still see the server that left
            assert client.ask({}, 20.0) == {"response": {}}
        return requests[-1] == "lyrical"

    until(lyrical_called, "the first server is called again", every=0.05)


def test_a_client_of_lyrical_gets_the_value_of_an_added_field(own: HubNode, node: Nodes) -> None:
    """With a value of zero, the reply would mean failure."""
    clear = "nav2_msgs/srv/ClearEntireCostmap"
    peer = ReleaseTypes(node(LYRICAL))

    def answer(request: bytes, done: Done) -> Callable[[], None]:
        done(b"\0\1\0\0\0" if request == b"\0\1\0\0\0" else CallError(f"{request!r}"))
        return nothing

    own.hub.server("/clear", clear, hash_in("jazzy", clear), answer)
    query = "@ros2_lv/**/SS/**/%clear/**"
    until(lambda: [*peer.node.session.liveliness().get(query)], "the server is seen")
    client = ReleaseClient(peer.node, peer.topic("/clear", clear))
    (reply,) = client.call(peer.encode(clear, {"plugins": ["obstacles"]}, "Request"))
    assert peer.decode(clear, reply, "Response") == {"success": True}


@pytest.mark.parametrize("qos", [Qos(depth=10), replace(LATCHED, depth=5)], ids=["volatile", "latched"])
def test_a_value_that_another_version_cannot_hold_is_logged_once(
    network: HubNetwork, node: Nodes, tmp_path: Path, caplog: pytest.LogCaptureFixture, qos: Qos
) -> None:
    write_versions(tmp_path)
    (tmp_path / "rules.yaml").write_text(json.dumps(RULES))
    registry = Registry([tmp_path / "old", tmp_path / "new"], [tmp_path / "rules.yaml"])
    newer = Topic("/wheel", WHEEL, list(registry.releases.hashes(WHEEL))[1], qos)
    with HubNode(network.settings("midspan"), registry) as own:
        publisher = own.on(lambda: own.node.publisher("/wheel", WHEEL, qos))
        received = ReleaseSubscription(node(KILTED), newer)
        until(
            lambda: (publisher.publish({"code": "1"}), received.samples)[1], "the other version is matched", every=0.05
        )
        for code in ("two", "three"):
            publisher.publish({"code": code})
        count = len(received.samples)
        until(lambda: (publisher.publish({"code": "4"}), len(received.samples) > count)[1], "later ones arrive")
    warnings = [record.getMessage() for record in caplog.records if "in another version of its type" in record.msg]
    assert len(warnings) == 1
    assert "code must be a text with a number, not 'two'" in warnings[0]


@pytest.mark.parametrize("first", ["publisher", "subscription"])
def test_buffers_of_another_version_of_a_type_are_received(
    network: HubNetwork, node: Nodes, tmp_path: Path, first: str
) -> None:
    """A publisher of Lyrical sends buffers only in the CPU group of its own hash."""
    pixels = "fleet_msgs/msg/Pixels"
    for folder, extra in (("old", ""), ("new", "int32 width\n")):
        write_package(tmp_path / folder / "fleet_msgs", {"msg/Pixels.msg": f"uint8[] data\n{extra}"})
    registry = Registry([tmp_path / "old", tmp_path / "new"])
    there = list(registry.releases.hashes(pixels))[1]
    payload = MessageWriter(registry.schema(pixels, there)).message({"data": [1, 2, 3], "width": 3})
    newer, received = Topic("/pixels", pixels, there, array=True), list[dict[str, Any]]()
    with HubNode(network.settings("midspan"), registry) as own:

        def subscribe() -> None:
            own.on(lambda: own.node.subscription("/pixels", pixels, received.append))

        if first == "subscription":
            subscribe()
        publisher = ReleasePublisher(node(LYRICAL), newer)
        if first == "publisher":
            until(lambda: own.hub.graph.publishers("/pixels"), "the publisher is discovered")
            subscribe()
            until(publisher.discovered, "the subscription is discovered")
            assert publisher.put(payload) == [f"{publisher.key}/{CPU_GROUP}"]
        until(lambda: (publisher.put(payload), received)[1], "the message arrives", every=0.05)
        assert bytes(received[0]["data"]) == b"\1\2\3"
        assert set(received[0]) == {"data"}
        publisher.close()
