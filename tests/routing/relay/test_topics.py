"""Topics between nodes of several ROS 2 releases on one hub, which Midspan relays."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.wire.keys import ANY_HASH
from bridge.hub.wire.qos import LATCHED, Qos
from tests.peers.hub.endpoints import Subscriber
from tests.peers.zenoh.release_actions import ReleaseTypes, hash_in
from tests.peers.zenoh.releases import (
    CPU_GROUP,
    HUMBLE,
    JAZZY,
    KILTED,
    LYRICAL,
    Nodes,
    Received,
    Release,
    ReleaseNode,
    ReleasePublisher,
    ReleaseSubscription,
    Topic,
)
from tests.routing.relay.conftest import Relay, Relays
from tests.support.wait import until

STRING, IMAGE = "std_msgs/msg/String", "sensor_msgs/msg/Image"
FEEDBACK = "nav2_msgs/action/NavigateToPose_FeedbackMessage"
STREAM = Qos(depth=100)
COUNT = 20
_PROBE = "probe"


class Topics:
    """One topic of a type, published and received by nodes of several releases."""

    def __init__(self, type_name: str, qos: Qos = STREAM, name: str = "/topic") -> None:
        self.type_name, self.qos, self.name = type_name, qos, name

    def publisher(self, node: ReleaseNode) -> ReleasePublisher:
        return ReleasePublisher(node, self._topic(node))

    def subscription(self, node: ReleaseNode) -> ReleaseSubscription:
        return ReleaseSubscription(node, self._topic(node))

    def _topic(self, node: ReleaseNode) -> Topic:
        return ReleaseTypes(node).topic(self.name, self.type_name, self.qos)


CHATTER = Topics(STRING)


def text(value: str) -> bytes:
    """Return a std_msgs/String, whose version is the same in all releases."""
    data = value.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


def texts(subscription: ReleaseSubscription) -> list[str]:
    """Return the texts received so far, without those of `connect`."""
    found = [sample.payload[8:-1].decode() for sample in subscription.samples]
    return [value for value in found if value != _PROBE]


def is_probe(sample: Received) -> bool:
    """Return whether a message is one of those of `connect`."""
    return sample.payload == text(_PROBE)


def connect(publisher: ReleasePublisher | HubPublisher, *subscriptions: ReleaseSubscription | Subscriber) -> None:
    """Publish until each subscription receives."""

    def received() -> bool:
        publisher.put(text(_PROBE))
        return all(any(sample.gid == publisher.gid for sample in s.samples) for s in subscriptions)

    until(received, "the messages are relayed", every=0.05)


def put_texts(publisher: ReleasePublisher, prefix: str = "") -> list[str]:
    values = [f"{prefix}{number}" for number in range(COUNT)]
    for value in values:
        publisher.put(text(value))
    return values


def until_topics(relay: Relay, count: int) -> None:
    until(lambda: len(relay.relay.topics()) == count, f"{count} keys are relayed")


@pytest.mark.parametrize(("sender", "receiver"), [(HUMBLE, JAZZY), (JAZZY, HUMBLE), (LYRICAL, HUMBLE)])
def test_messages_reach_another_release_once_and_unchanged(
    relay: Relays, node: Nodes, sender: Release, receiver: Release
) -> None:
    relay()
    publisher, same = CHATTER.publisher(node(sender)), CHATTER.subscription(node(sender))
    other = CHATTER.subscription(node(receiver))
    connect(publisher, same, other)
    values = put_texts(publisher)
    for subscription in (same, other):
        until(lambda s=subscription: values[-1] in texts(s), "all messages arrive")
        assert texts(subscription) == values
    direct, relayed = (  # not the first ones, because the other subscription may be connected later
        {(sample.sequence, sample.gid, sample.payload) for sample in subscription.samples if not is_probe(sample)}
        for subscription in (same, other)
    )
    assert relayed == direct


@pytest.mark.parametrize(("sender", "receiver"), [(JAZZY, LYRICAL), (LYRICAL, JAZZY), (HUMBLE, LYRICAL)])
def test_messages_are_converted_directly_to_the_other_version(
    relay: Relays, node: Nodes, sender: Release, receiver: Release
) -> None:
    relay()
    topic, nodes = Topics(FEEDBACK), (node(sender), node(receiver))
    publisher, received = topic.publisher(nodes[0]), topic.subscription(nodes[1])
    cdr = ReleaseTypes(nodes[0]).encode(FEEDBACK, {"feedback": {"distance_remaining": 2.5, "number_of_recoveries": 3}})

    def arrived() -> bool:
        publisher.put(cdr)
        return bool(received.samples)

    until(arrived, "a message arrives")
    feedback = ReleaseTypes(nodes[1]).decode(FEEDBACK, received.samples[0].payload)["feedback"]
    assert (feedback["distance_remaining"], feedback["number_of_recoveries"]) == (2.5, 3)


def test_buffers_of_lyrical_reach_humble(relay: Relays, node: Nodes) -> None:
    """Lyrical publishes images for the CPU on a key of their own."""
    worker = relay()
    topic = Topic("/image", IMAGE, hash_in("lyrical", IMAGE), STREAM, array=True)
    publisher, received = ReleasePublisher(node(LYRICAL), topic), ReleaseSubscription(node(HUMBLE), topic)
    until_topics(worker, 1)
    until(lambda: any(key.endswith(CPU_GROUP) for key in publisher.discovered()), "the relay is discovered")

    def arrived() -> bool:
        publisher.put(b"\0\1\0\0image")
        return bool(received.samples)

    until(arrived, "an image arrives")
    assert received.samples[0].payload == b"\0\1\0\0image"
    numbers = [sample.sequence for sample in received.samples]
    assert len(numbers) == len(set(numbers))


def test_buffers_of_lyrical_reach_jazzy_unless_they_would_reach_lyrical_twice(relay: Relays, node: Nodes) -> None:
    worker, lyrical = relay(), node(LYRICAL)
    topic = Topic("/image", IMAGE, hash_in("lyrical", IMAGE), STREAM, array=True)
    publisher, received = ReleasePublisher(lyrical, topic), ReleaseSubscription(node(JAZZY), topic)
    ReleasePublisher(node(JAZZY), topic)
    until_topics(worker, 1)

    def put(end: ReleaseSubscription, payload: bytes) -> None:
        until(lambda: (publisher.put(payload), end.samples)[1], "an image arrives", every=0.05)

    put(received, b"\0\1\0\0image")
    direct = b"\0\1\0\0direct"  # the relay and the publisher's own session reach the subscription separately

    def arrives_directly() -> bool:
        publisher.put_serialized(direct)
        return any(sample.payload == direct for sample in received.samples)

    until(arrives_directly, "a serialized image arrives", every=0.05)
    for number in range(COUNT):
        publisher.put_serialized(b"\0\1\0\0serialized") if number % 2 else publisher.put(b"\0\1\0\0buffer")
    publisher.put(b"\0\1\0\0last")

    def counts() -> list[int]:
        payloads = [sample.payload[4:] for sample in received.samples]
        return [payloads.count(kind) for kind in (b"serialized", b"buffer", b"last")]

    # serialized images arrive directly, and may overtake the relayed ones, or be overtaken
    until(lambda: sum(counts()) > COUNT, "all images arrive")
    assert counts() == [COUNT // 2, COUNT // 2, 1]
    same = ReleaseSubscription(node(LYRICAL), topic)
    until_topics(worker, 0)
    put(same, b"\0\1\0\0same")
    numbers = [sample.sequence for sample in same.samples]
    assert len(numbers) == len(set(numbers))


def test_both_directions_of_a_topic_are_relayed_without_a_loop(relay: Relays, node: Nodes) -> None:
    worker = relay()
    nodes = node(HUMBLE), node(JAZZY)
    publishers = [CHATTER.publisher(n) for n in nodes]
    subscriptions = [CHATTER.subscription(n) for n in nodes]
    until_topics(worker, 2)
    for publisher in publishers:
        connect(publisher, *subscriptions)
    sent = put_texts(publishers[0], "humble ") + put_texts(publishers[1], "jazzy ")
    for subscription in subscriptions:
        until(lambda s=subscription: len(texts(s)) >= len(sent), "all messages arrive")
    for publisher in publishers:
        connect(publisher, *subscriptions)
    for subscription in subscriptions:
        assert sorted(texts(subscription)) == sorted(sent)


def test_midspan_itself_receives_and_publishes_each_message_once(relay: Relays, node: Nodes) -> None:
    worker, other = relay(), relay()
    nodes = node(HUMBLE), node(JAZZY)
    native, received = CHATTER.publisher(nodes[0]), [CHATTER.subscription(n) for n in nodes]
    type_hash = hash_in("jazzy", STRING)
    ours = [Subscriber(other.hub, "/topic", STREAM, hash_) for hash_ in (type_hash, ANY_HASH)]
    published = worker.hub.publisher("/topic", STRING, type_hash, STREAM)
    until_topics(worker, 1)
    for publisher in (native, published):
        connect(publisher, *received, *ours)
    values = put_texts(native, "native ")
    for number in range(COUNT):
        published.put(text(f"midspan {number}"))
    values += [f"midspan {number}" for number in range(COUNT)]
    until(lambda: all(len(texts(s)) >= len(values) for s in received), "all messages arrive")
    connect(native, *received)
    for subscription in received:
        assert sorted(texts(subscription)) == sorted(values)
    for subscriber in ours:

        def found(subscriber: Subscriber = subscriber) -> list[str]:
            arrived = [sample.data()[8:-1].decode() for sample in list(subscriber.samples)]
            return sorted(value for value in arrived if value != _PROBE)

        until(lambda found=found: len(found()) >= len(values), "Midspan receives all messages")
        assert found() == sorted(values)


def test_one_of_several_workers_relays_and_another_takes_over(relay: Relays, node: Nodes) -> None:
    first, second = relay(), relay()
    publisher, received = CHATTER.publisher(node(HUMBLE)), CHATTER.subscription(node(JAZZY))
    until_topics(first, 1)
    connect(publisher, received)
    values = put_texts(publisher)
    until(lambda: values[-1] in texts(received), "all messages arrive")
    assert texts(received) == values
    assert not second.relay.topics()
    first.close()
    until_topics(second, 1)
    received.samples.clear()
    connect(publisher, received)
    values = put_texts(publisher, "later ")
    until(lambda: values[-1] in texts(received), "all messages arrive")
    assert texts(received) == values


def test_latched_messages_reach_late_joiners_until_their_publisher_leaves(relay: Relays, node: Nodes) -> None:
    worker, topic = relay(), Topics(STRING, LATCHED)
    publisher = topic.publisher(node(HUMBLE))
    publisher.put(text("map"))
    jazzy = node(JAZZY)
    first = topic.subscription(jazzy)
    until(lambda: texts(first) == ["map"], "the first subscription gets the message")
    second = topic.subscription(node(KILTED))
    until(lambda: texts(second) == ["map"], "a late joiner gets the message")
    publisher.put(text("map 2"))
    for subscription in (first, second):
        until(lambda s=subscription: texts(s) == ["map", "map 2"], "both get the new message")
    publisher.close()
    until_topics(worker, 0)
    other = topic.publisher(node(HUMBLE))
    third = topic.subscription(jazzy)
    other.put(text("other"))
    until(lambda: texts(third), "the other publisher's message arrives")
    assert texts(third) == ["other"]


def test_the_latched_messages_of_a_publisher_that_returns_reach_late_joiners(relay: Relays, node: Nodes) -> None:
    """The relay keeps its subscription for the other publisher, and has received the message before."""
    worker, topic, humble, jazzy = relay(), Topics(STRING, LATCHED), node(HUMBLE), node(JAZZY)
    publisher, other = topic.publisher(humble), topic.publisher(humble)
    publisher.put(text("map"))
    other.put(text("other"))
    first = topic.subscription(jazzy)
    until(lambda: sorted(texts(first)) == ["map", "other"], "both messages are relayed")

    def publishers() -> int:
        (relayed,) = worker.relay.topics().values()
        return len(relayed.pair.publishers)

    publisher.vanish()
    until(lambda: publishers() == 1, "the relay drops the publisher")
    publisher.appear()
    until(lambda: publishers() == 2, "the relay has the publisher again")
    late = topic.subscription(node(KILTED))
    until(lambda: sorted(texts(late)) == ["map", "other"], "both messages reach a late joiner")


def test_latched_messages_reach_the_first_subscription_of_a_third_version_only_there(
    relay: Relays, node: Nodes
) -> None:
    worker, topic = relay(), Topics(FEEDBACK, replace(LATCHED, depth=3))
    nodes = [node(release) for release in (HUMBLE, JAZZY, LYRICAL)]
    publisher = topic.publisher(nodes[0])
    cdr = ReleaseTypes(nodes[0]).encode(FEEDBACK, {"feedback": {"number_of_recoveries": 3}})
    for _ in range(5):
        publisher.put(cdr)
    first = topic.subscription(nodes[1])  # after the messages, of which the relay could otherwise receive all five
    until(lambda: len(first.samples) == 3, "the first version is relayed")
    third = topic.subscription(nodes[2])
    until(lambda: len(worker.relay.topics()) == 1 and len(third.samples) == 3, "the third receives")
    publisher.put(cdr)
    for subscription in (first, third):
        until(lambda s=subscription: len(s.samples) >= 4, "a new message arrives")
        assert [sample.sequence for sample in subscription.samples] == [3, 4, 5, 6]


@pytest.mark.parametrize(("sender", "receiver"), [(HUMBLE, JAZZY), (JAZZY, HUMBLE)])
def test_a_history_arrives_in_order_before_new_messages(
    relay: Relays, node: Nodes, sender: Release, receiver: Release
) -> None:
    topic = Topics(STRING, replace(LATCHED, depth=10))
    publisher, received = topic.publisher(node(sender)), topic.subscription(node(receiver))
    values = put_texts(publisher)
    relay()
    until(lambda: len(texts(received)) >= 10, "the history arrives")
    values += put_texts(publisher, "later ")
    until(lambda: values[-1] in texts(received), "the new messages arrive")
    assert texts(received) == values[COUNT - 10 :]


def test_a_rule_turns_the_relay_off(relay: Relays, node: Nodes) -> None:
    worker = relay({"topic": "/topic", "from": "zenoh", "to": "zenoh", "deny": True})
    CHATTER.publisher(node(HUMBLE))
    CHATTER.subscription(jazzy := node(JAZZY))
    allowed = Topics(STRING, name="/allowed")
    allowed.publisher(jazzy)
    allowed.subscription(node(HUMBLE))
    until_topics(worker, 1)
    assert [key.topic for key in worker.relay.topics()] == ["/allowed"]
