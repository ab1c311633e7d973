"""Hub topics as channels: announced, subscribed while they are watched, and forwarded unchanged."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import websockets
import zenoh

from bridge.client.topics import HubTopic, SubscribedTopic, TopicKey
from bridge.foxglove.channels import MOST_EARLY, Channels, TopicChannel
from bridge.hub.endpoints.subscription import HubSample
from tests.foxglove.conftest import Desk
from tests.peers.hub.endpoints import LATCHED, STREAM, endpoint
from tests.support.wait import until


def cdr(text: str) -> bytes:
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


def test_topics_are_announced_with_their_definition_and_withdrawn(desk: Desk) -> None:
    with desk.app() as app:
        end = desk.far.advertise("/odom", "nav_msgs/Odometry")
        channel = app.channel("/odom")
        assert channel["schemaName"] == "nav_msgs/msg/Odometry"
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        assert "MSG: geometry_msgs/PoseWithCovariance" in channel["schema"]
        assert channel["metadata"] == {
            "side": "zenoh", "latched": "false", "hash": desk.far.registry.ros2("nav_msgs/msg/Odometry").type_id,
        }  # fmt: skip
        desk.far.drop(end)
        app.until(lambda: "/odom" not in app.channels, "the channel is withdrawn")
        assert desk.status()["channels"] == 0


def test_bytes_arrive_unchanged_with_their_time(desk: Desk) -> None:
    publisher = desk.publisher("/said", "std_msgs/String")
    with desk.app() as app:
        app.subscribe("/said")
        app.until(publisher.matched, "the server subscribes")
        publisher.put(cdr("one"), 1_234)
        publisher.put(cdr("two") + b"\0\0\0", 5_678)  # with trailing padding, as some writers add it
        assert app.received("/said", 2) == [(1_234, cdr("one")), (5_678, cdr("two") + b"\0\0\0")]
        assert [app.decoded("/said", at).data for at in (0, 1)] == ["one", "two"]


def test_only_watched_topics_are_subscribed(desk: Desk) -> None:
    publisher = desk.publisher("/said", "std_msgs/String")
    with desk.app() as app, desk.app() as other:
        app.channel("/said")
        assert not publisher.matched()
        assert desk.status()["topics"] == []
        first, second = app.subscribe("/said"), other.subscribe("/said")
        for entry in (app, other):
            entry.sync()
        app.until(publisher.matched, "the topic is subscribed")
        publisher.put(cdr("x"))
        app.received("/said")
        other.received("/said")
        (topic,) = desk.status()["topics"]
        assert (topic["topic"], topic["messages"], topic["bytes"]) == ("/said", 1, len(cdr("x")))
        app.unsubscribe(first)
        publisher.put(cdr("y"))
        assert len(other.received("/said", 2)) == 2
        assert publisher.matched(), "the other client still watches"
        other.unsubscribe(second)
        until(lambda: not publisher.matched(), "the topic is unsubscribed")
        app.subscribe("/said")
        app.until(publisher.matched, "the topic is subscribed again")
    until(lambda: not publisher.matched(), "the subscription ends with its client")


def test_a_late_client_receives_latched_messages(desk: Desk) -> None:
    end = desk.far.advertise("/map_name", "std_msgs/String", latched=True)
    desk.far.publish(end, {"data": "kitchen"})
    with desk.app() as app:
        app.subscribe("/map_name")
        assert app.received("/map_name")[0][1] == cdr("kitchen")
        with desk.app() as late:
            late.subscribe("/map_name")
            assert late.received("/map_name")[0][1] == cdr("kitchen")
        desk.far.publish(end, {"data": "hall"})
        app.until(lambda: app.messages["/map_name"][-1][1] == cdr("hall"), "the new message has arrived")
        with desk.app() as late:
            late.subscribe("/map_name")
            assert late.received("/map_name")[0][1] == cdr("hall")


class RecordingChannel:
    """A stand-in for the SDK's channel that records messages; it calls ``before`` once, before the next message."""

    def __init__(self) -> None:
        self.logged: list[bytes] = []
        self.before: Callable[[], None] | None = None

    def log(self, data: bytes, _at: int | None) -> None:
        before, self.before = self.before, None
        if before is not None:
            before()
        self.logged.append(data)


def sample(gid: bytes, data: bytes) -> HubSample:
    return HubSample(zenoh.ZBytes(data), 1, 1, gid, "1")


def test_a_latched_message_is_cached_before_the_graph_lists_its_publisher() -> None:
    key, recorded = TopicKey("/map", "nav_msgs/msg/OccupancyGrid", "*"), RecordingChannel()
    gids = [bytes([number]) * 16 for number in range(MOST_EARLY + 2)]
    ends = [endpoint("/map", gid, LATCHED if gid != gids[-2] else STREAM) for gid in gids]
    channel = TopicChannel(HubTopic(key, (ends[0],)), recorded)
    channel.follow(HubTopic(key, (ends[0],)))
    for gid in gids[1:]:
        channel.on_sample(sample(gid, gid[:1]))
    recorded.logged.clear()
    channel.follow(HubTopic(key, tuple(ends)))
    channel.resend_latched()
    # the first message was evicted, and the last but one was not cached, because its publisher is not latched
    assert recorded.logged == [gid[:1] for gid in gids[2:] if gid != gids[-2]]


def test_the_second_type_of_a_topic_is_refused_and_reported(desk: Desk) -> None:
    desk.far.advertise("/both", "std_msgs/String")
    with desk.app() as app:
        assert app.channel("/both")["schemaName"] == "std_msgs/msg/String"
        desk.far.advertise("/both", "std_msgs/Int8")
        refused = until(lambda: desk.status()["refused"], "the second type is refused")
        assert [(entry["topic"], entry["type"]) for entry in refused] == [("/both", "std_msgs/msg/Int8")]
        assert "offered with the type std_msgs/msg/String" in refused[0]["reason"]


def test_a_client_that_never_reads_does_not_delay_others_and_has_a_bounded_backlog(desk: Desk) -> None:
    publisher = desk.publisher("/blob", "std_msgs/String")
    with desk.app() as app, desk.app(max_queue=1, close_timeout=0.1) as deaf:
        app.subscribe("/blob")
        app.until(publisher.matched, "the topic is subscribed")
        deaf.subscribe("/blob")
        payload = cdr("x" * 100_000)
        for sent in range(1, 601):  # 60 MB; unread messages are dropped
            publisher.put(payload)
            app.received("/blob", sent)
        assert len(app.messages["/blob"]) == 600

        def figures() -> list[int]:
            return [client["bytes"] for client in desk.status()["clients"]]

        until(lambda: figures()[0] > 60e6, "the last bytes are counted, which is after they are sent")
        assert 100e3 < figures()[1] < 30e6


FRAMES: tuple[str | bytes, ...] = (
    "no JSON", "{}", '{"op": "no such"}', '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
    '{"op": "subscribe"}', "[" * 100_000, '{"op": "unsubscribe", "subscriptionIds": [-1]}', b"", b"\x01", b"\x02\x01",
    b"\xff" * 20, b"\x01" + bytes(4), b"\x02" + b"\xff" * 12, '{"op": "fetchAsset", "uri": "x", "requestId": 1}',
    '{"op": "advertise", "channels": [{"id": 1}]}', '{"op": "setParameters", "parameters": 3}',
)  # fmt: skip


def test_invalid_frames_of_a_client_affect_no_other(desk: Desk) -> None:
    publisher = desk.publisher("/said", "std_msgs/String")
    with desk.app() as app, desk.app() as bad:
        app.subscribe("/said")
        app.until(publisher.matched, "the topic is subscribed")
        bad.channel("/said")
        for frame in FRAMES:
            bad.socket.send(frame)
        bad.subscribe("/said")
        bad.until(lambda: sum(entry["op"] == "status" for entry in bad.texts) > 8, "the client receives the errors")
        bad.sync()  # its subscription follows frames of which some cause no error
        publisher.put(cdr("well"))
        assert app.received("/said")[0][1] == bad.received("/said")[0][1] == cdr("well")
        # the client is disconnected while it sends, or afterwards
        with contextlib.suppress(websockets.ConnectionClosed):
            bad.socket.send(b"\x01" + bytes(20 << 20))
        with pytest.raises(websockets.ConnectionClosed):
            bad.read_until_cut()
        publisher.put(cdr("again"))
        assert app.received("/said", 2)[1][1] == cdr("again")


def test_a_late_client_receives_the_newest_latched_message_last() -> None:
    """A message that arrives while older messages are sent again is sent after these."""
    end, recorded = endpoint("/map", b"1" * 16, LATCHED), RecordingChannel()
    topic = HubTopic(TopicKey("/map", end.type_name, "*"), (end,))
    channel = TopicChannel(topic, recorded)
    channel.follow(topic)
    channel.on_sample(sample(end.gid, b"old"))
    publishing = threading.Thread(target=channel.on_sample, args=(sample(end.gid, b"new"),))

    def publish() -> None:
        publishing.start()
        publishing.join(0.3)  # the thread ends only if it does not have to wait for the older message

    recorded.before = publish
    channel.resend_latched()
    publishing.join()
    assert recorded.logged[-1] == b"new"


class ListedTopics:
    """Stands in for the hub's topics, with given keys; ``refreshed`` counts the refreshes."""

    def __init__(self, *keys: TopicKey, definition: str | None) -> None:
        self.refreshed = 0
        self._topics = {key: HubTopic(key, (endpoint(key.topic, b"1" * 16),)) for key in keys}
        self._definition = definition
        self.definitions = self

    def refresh(self) -> dict[TopicKey, HubTopic]:
        self.refreshed += 1
        return self._topics

    def find(self, _type_name: str, _type_hash: str) -> str | None:
        return self._definition

    def subscribed(self) -> list[SubscribedTopic]:
        return []


def channels_of(topics: ListedTopics) -> Channels:
    server: Any = SimpleNamespace(channel=lambda *_arguments: RecordingChannel())
    listed: Any = topics
    return Channels(server, listed)


def test_a_second_version_of_a_type_is_refused_with_its_reason() -> None:
    """Topics are not listed again each second, because nothing can change unless the graph changes."""
    name = "std_msgs/msg/String"
    topics = ListedTopics(TopicKey("/a", name, "1"), TopicKey("/a", name, "2"), definition="string data")
    channels = channels_of(topics)
    channels.refresh()
    channels.tick()
    (refused,) = channels.refused()
    reason = f"its name is offered with the type {name} in another version (1); the app allows one per name"
    assert (refused.reason, topics.refreshed) == (reason, 1)


def test_topics_without_definition_are_tried_again() -> None:
    topics = ListedTopics(TopicKey("/a", "std_msgs/msg/String", "1"), definition=None)
    channels = channels_of(topics)
    channels.refresh()
    channels.tick()
    (refused,) = channels.refused()
    assert refused.reason == "its definition is unknown, and is requested from the workers"
    assert topics.refreshed == 2
