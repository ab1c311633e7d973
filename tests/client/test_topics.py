"""`HubTopics` lists all topics with their publishers, and delivers the messages of chosen topics unchanged."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.client.topics import HubTopic, HubTopics, SubscribedTopic, TopicFollower, TopicKey
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.graph.tokens import Origin
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.registry import Registry
from tests.peers.hub.quick import QuickHub
from tests.support.wait import until

STRING = "std_msgs/msg/String"
OWN_TYPE = "robot_msgs/msg/Mood"


@pytest.fixture(scope="module")
def hubs() -> Iterator[QuickHub]:
    network = QuickHub()
    yield network
    network.stop_router()


@pytest.fixture
def near(hubs: QuickHub) -> Iterator[Hub]:
    with Hub.open(hubs.settings("near")) as hub:
        yield hub


@pytest.fixture
def far(hubs: QuickHub) -> Iterator[Hub]:
    with Hub.open(hubs.settings("far")) as hub:
        yield hub


@pytest.fixture
def changed() -> Event:
    return Event()


@pytest.fixture
def topics(near: Hub, changed: Event) -> Iterator[HubTopics]:
    hub_topics = HubTopics(near, Registry(), changed.set)
    yield hub_topics
    hub_topics.close()


def text(words: str) -> bytes:
    data = words.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


def string_key(topic: str) -> TopicKey:
    return TopicKey(topic, STRING, Registry().ros2(STRING).type_id)


def wait_for(topics: HubTopics, key: TopicKey, publishers: int = 1) -> HubTopic:
    def here() -> HubTopic | None:
        topic = topics.refresh().get(key)
        return topic if topic is not None and len(topic.publishers) == publishers else None

    return until(here, f"{key.topic} has {publishers} publishers")


def test_topics_appear_with_their_sides_and_disappear(far: Hub, topics: HubTopics, changed: Event) -> None:
    key = string_key("/appears")  # only here, as a router may still list the publishers of the previous test
    far.set_origin(Origin("yarp", "here", "robot1"))
    publisher = far.publisher(*key, Qos())
    topic = wait_for(topics, key)
    assert topic.sides == ("yarp",)
    assert not topic.latched
    until(changed.is_set, "the change is reported")
    publisher.close()
    until(lambda: key not in topics.refresh(), "the topic is removed")


def test_messages_arrive_unchanged(far: Hub, topics: HubTopics) -> None:
    key = string_key("/said")
    publisher = far.publisher(*key, Qos())
    received: list[HubSample] = []
    end = topics.subscribe(wait_for(topics, key), received.append)
    until(publisher.matched, "the publisher has a subscriber")
    publisher.put(text("one"), 1_000)
    publisher.put(text("two"), 2_000)
    until(lambda: len(received) == 2, "both messages have arrived")
    assert [(item.sequence, item.source_time_ns, item.data()) for item in received] == [
        (1, 1_000, text("one")), (2, 2_000, text("two")),
    ]  # fmt: skip
    assert {item.gid for item in received} == {publisher.gid}
    assert (end.lost, end.refused, end.trouble) == (0, 0, "")
    topics.unsubscribe(key)
    until(lambda: not publisher.matched(), "the publisher has no subscriber")


def test_latched_message_arrives_once_beside_a_volatile_publisher(far: Hub, topics: HubTopics) -> None:
    key = string_key("/both")
    plain = far.publisher(*key, Qos())
    received: list[bytes] = []
    topics.subscribe(wait_for(topics, key), lambda sample: received.append(sample.data()))
    until(plain.matched, "the publisher has a subscriber")
    plain.put(text("plain"))
    until(lambda: received == [text("plain")], "the volatile message arrives")
    kept = far.publisher(*key, LATCHED)
    kept.put(text("kept"))  # both subscriptions receive it, the first one live, the second from the cache
    wait_for(topics, key, 2)
    until(lambda: text("kept") in received, "the latched message arrives")
    plain.put(text("last"))
    until(lambda: text("last") in received, "the last message arrives")
    assert received == [text("plain"), text("kept"), text("last")]


def test_invalid_zenoh_key_is_reported_not_raised(far: Hub, topics: HubTopics) -> None:
    key = string_key("/said")
    far.publisher(*key, Qos())
    topic = wait_for(topics, key)
    bad = HubTopic(key._replace(type_hash="md5"), topic.publishers)
    assert "RIHS01" in topics.subscribe(bad, lambda _: None).trouble


def test_definitions_are_installed_or_from_a_worker(far: Hub, topics: HubTopics) -> None:
    key = string_key("/said")
    result = topics.definitions.find(*key[1:])
    assert result is not None
    assert "string data" in result
    elsewhere = Registry()
    elsewhere.learn_ros2(OWN_TYPE, "std_msgs/Header header\nfloat32 joy\n")
    kind = elsewhere.ros2(OWN_TYPE)
    reported = {"name": OWN_TYPE, "hash": kind.type_id, "definition": kind.definition}
    far.serve("type", lambda _: reported)
    told_here = until(
        lambda: topics.definitions.find(OWN_TYPE, kind.type_id, 2.0), "the worker sends the definition", every=0.1
    )
    assert "float32 joy" in told_here
    assert "MSG: std_msgs/Header" in told_here
    assert topics.definitions.find(OWN_TYPE, "RIHS01_" + "0" * 64, 2.0) is None


def test_a_follower_counts_the_lost_messages_of_closed_subscriptions() -> None:
    """`midspan topic hz` needs them, because it prints its last figures after it has unsubscribed."""
    subscription = SimpleNamespace(lost=3, refused=0, close=lambda: None)
    hub: Any = SimpleNamespace(subscription=lambda *_, exact: subscription)  # noqa: ARG005
    follower = TopicFollower(hub, lambda _key, _sample: None)
    follower.topic(string_key("/scan")).subscribe(Qos())
    assert follower.lost == 3
    follower.close()
    assert not follower
    assert follower.lost == 3


def test_stored_messages_that_follow_newer_ones_arrive_once() -> None:
    """A latched publisher has sent 3, 4 and 7 when its stored messages arrive."""
    received: list[int] = []
    hub: Any = SimpleNamespace()
    subscribed: Any = SubscribedTopic(hub, string_key("/both"), lambda sample: received.append(sample.sequence))
    for number in (3, 4, 7, 1, 2, 3, 4, 5, 6, 7, 8):
        subscribed._on_possible_duplicate(SimpleNamespace(gid=b"publisher", sequence=number))
    assert received == [3, 4, 7, 1, 2, 5, 6, 8]


def test_the_memory_of_received_messages_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.client.topics._MAX_RANGES", 3)
    received: list[int] = []
    hub: Any = SimpleNamespace()
    subscribed: Any = SubscribedTopic(hub, string_key("/both"), lambda sample: received.append(sample.sequence))
    for number in (2, 4, 6, 8, 3, 5, 9):  # the gap between the two oldest ranges is closed
        subscribed._on_possible_duplicate(SimpleNamespace(gid=b"publisher", sequence=number))
    assert received == [2, 4, 6, 8, 5, 9]
    assert subscribed._seen == {b"publisher": [[2, 6], [8, 9]]}
