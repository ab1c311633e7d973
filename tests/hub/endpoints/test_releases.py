"""Topics and services between the hub and rmw_zenoh nodes of each ROS 2 release."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from threading import Lock

import pytest
import zenoh

from bridge.hub.endpoints.calls import Done, nothing
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.node import Hub
from bridge.hub.wire.buffers import BUFFER_TYPES
from bridge.hub.wire.keys import ANY_HASH, NO_HASH
from bridge.hub.wire.qos import Qos
from bridge.messages.definitions.schema import Shape
from bridge.messages.registry import Registry
from tests.peers.hub.endpoints import HASH, LATCHED, STREAM, TYPE, Subscriber, advertise, matched
from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.releases import (
    CPU_GROUP,
    HUMBLE,
    JAZZY,
    LYRICAL,
    RELEASES,
    Nodes,
    Release,
    ReleaseClient,
    ReleasePublisher,
    ReleaseServer,
    ReleaseSubscription,
    Topic,
)
from tests.support.wait import until

SERVICE = Topic("/do", "std_srvs/srv/SetBool", HASH)
ACTION_PART = Topic("/turn/_action/send_goal", "example_interfaces/action/Fibonacci_SendGoal", HASH)
CHATTER = Topic("/chatter", TYPE, HASH, STREAM)
MAP = Topic("/map", TYPE, HASH, LATCHED)
EACH_RELEASE = pytest.mark.parametrize("release", RELEASES, ids=lambda release: release.name)


@pytest.fixture
def hub(network: HubNetwork) -> Iterator[Hub]:
    with Hub.open(network.settings("midspan")) as hub:
        yield hub


def numbered(count: int) -> list[str]:
    return [str(number) for number in range(count)]


def put_all(publisher: HubPublisher | ReleasePublisher, texts: list[str]) -> None:
    for text in texts:
        publisher.put(text.encode())


def arrives(publisher: ReleasePublisher, received: Subscriber) -> None:
    """Publish until the subscription receives a message, then clear its messages."""

    def put() -> bool:
        publisher.put(b"first")
        return bool(received.samples)

    until(put, "the subscription is matched", every=0.05)
    received.samples.clear()


# topics


@EACH_RELEASE
def test_a_subscription_of_each_release_receives_each_message_once(hub: Hub, node: Nodes, release: Release) -> None:
    received = ReleaseSubscription(node(release), CHATTER)
    publisher = advertise(hub, "/chatter", priority="command")
    matched(publisher)
    put_all(publisher, numbered(20))
    until(lambda: len(received.samples) >= 20, "all messages arrive")
    assert received.texts() == numbered(20)
    assert [sample.sequence for sample in received.samples] == list(range(1, 21))
    assert {sample.gid for sample in received.samples} == {publisher.gid}


@EACH_RELEASE
def test_a_publisher_of_each_release_is_received_once(hub: Hub, node: Nodes, release: Release) -> None:
    received = Subscriber(hub, "/chatter")
    publisher = ReleasePublisher(node(release), CHATTER)
    arrives(publisher, received)
    put_all(publisher, numbered(20))
    until(lambda: "19" in received.texts(), "the last message arrives")
    assert [text for text in received.texts() if text != "first"] == numbered(20)
    assert (received.subscription.lost, received.subscription.refused) == (0, 0)
    assert {sample.gid for sample in received.samples} == {publisher.gid}


@EACH_RELEASE
def test_latched_messages_reach_late_subscriptions_of_each_release(hub: Hub, node: Nodes, release: Release) -> None:
    advertise(hub, "/map", replace(LATCHED, depth=2), "1", "2", "3")
    received = ReleaseSubscription(node(release), replace(MAP, qos=replace(LATCHED, depth=5)))
    until(lambda: len(received.samples) >= 2, "both messages arrive")
    assert received.texts() == ["2", "3"]
    assert [sample.sequence for sample in received.samples] == [2, 3]


@EACH_RELEASE
def test_latched_messages_of_each_release_reach_a_late_subscription(hub: Hub, node: Nodes, release: Release) -> None:
    publisher, early = ReleasePublisher(node(release), MAP), Subscriber(hub, "/map", LATCHED)
    until(lambda: hub.graph.publishers("/map"), "the sessions are linked")
    put_all(publisher, ["1", "2"])
    until(lambda: "2" in early.texts(), "all messages have arrived")
    received = Subscriber(hub, "/map", LATCHED)
    received.expect("2")
    publisher.put(b"3")
    received.expect("2", "3")


def test_subscriptions_of_two_releases_and_of_any_hash_receive_each_message_once(
    hub: Hub, node: Nodes, network: HubNetwork
) -> None:
    humble, jazzy = ReleaseSubscription(node(HUMBLE), CHATTER), ReleaseSubscription(node(JAZZY), CHATTER)
    with Hub.open(network.settings("other")) as other:
        same, all_hashes = Subscriber(other, "/chatter"), Subscriber(other, "/chatter", type_hash=ANY_HASH)
        publisher = advertise(hub, "/chatter")
        until(lambda: len(hub.graph.subscriptions("/chatter")) == 4, "all subscriptions are seen")
        last: list[ReleaseSubscription | Subscriber] = [humble, jazzy, same, all_hashes]

        def put() -> bool:
            publisher.put(b"first")
            return all(received.samples for received in last)

        until(put, "all subscriptions are matched", every=0.05)
        put_all(publisher, numbered(20))
        for received in last:
            until(lambda received=received: "19" in received.texts(), "the last message arrives")
            assert [text for text in received.texts() if text != "first"] == numbered(20)
            numbers = [sample.sequence for sample in received.samples]
            assert len(set(numbers)) == len(numbers)


def test_a_key_without_a_hash_exists_only_while_a_hashless_subscription_does(hub: Hub, node: Nodes) -> None:
    publisher = advertise(hub, "/chatter")
    assert not publisher.matched()
    received = ReleaseSubscription(node(HUMBLE), CHATTER)
    matched(publisher)
    publisher.put(b"1")
    until(lambda: received.texts() == ["1"], "the message arrives")
    received.close()
    until(lambda: not publisher.matched(), "no subscription is left")
    assert publisher.pass_over()
    again = ReleaseSubscription(node(HUMBLE), CHATTER)
    matched(publisher)
    publisher.put(b"3")
    until(lambda: again.texts() == ["3"], "the message arrives")
    assert again.samples[0].sequence == 3


def test_a_volatile_subscription_without_a_hash_receives_no_cached_message(hub: Hub, node: Nodes) -> None:
    publisher = advertise(hub, "/map", LATCHED, "cached")
    received = ReleaseSubscription(node(HUMBLE), replace(MAP, qos=STREAM))
    matched(publisher)
    publisher.put(b"live")
    until(lambda: received.texts(), "the message arrives")
    assert received.texts() == ["live"]


def test_a_closed_publisher_leaves_no_key_behind(hub: Hub, node: Nodes) -> None:
    publisher = advertise(hub, "/map", LATCHED, "old")
    peer = node(HUMBLE)
    first = ReleaseSubscription(peer, MAP)
    until(lambda: first.texts() == ["old"], "the message arrives")
    publisher.close()
    late = ReleaseSubscription(node(HUMBLE), MAP)
    new = advertise(hub, "/map", LATCHED, "new")
    until(lambda: "new" in late.texts(), "the new message arrives")
    assert late.texts() == ["new"]
    assert {sample.gid for sample in late.samples} == {new.gid}


# the graph


def test_an_endpoint_without_a_hash_gets_the_hash_that_others_announce(hub: Hub, node: Nodes) -> None:
    humble = ReleasePublisher(node(HUMBLE), CHATTER)
    (endpoint,) = until(lambda: hub.graph.publishers("/chatter"), "the publisher is seen")
    assert (endpoint.type_hash, endpoint.gid) == (NO_HASH, humble.gid)
    jazzy = ReleasePublisher(node(JAZZY), CHATTER)
    until(lambda: len(hub.graph.publishers("/chatter")) == 2, "both publishers are seen")
    assert {end.type_hash for end in hub.graph.publishers("/chatter")} == {HASH}
    jazzy.close()
    until(lambda: len(hub.graph.publishers("/chatter")) == 1, "one publisher is left")
    assert hub.graph.publishers("/chatter")[0].type_hash == NO_HASH


def test_endpoints_of_the_hub_without_a_hash_match_nodes_of_humble(hub: Hub, node: Nodes) -> None:
    """Routes create such endpoints for topics and services that only nodes of Humble announce."""
    peer = node(HUMBLE)
    received = Subscriber(hub, "/chatter", type_hash=NO_HASH)
    publisher = ReleasePublisher(peer, CHATTER)
    arrives(publisher, received)
    publisher.put(b"1")
    until(lambda: "1" in received.texts(), "the message arrives")
    ReleaseServer(peer, SERVICE, lambda request: b"re " + request)
    client = hub.client(SERVICE.name, SERVICE.type_name, NO_HASH)
    assert answered(client, b"go") == b"re go"


# services and the services of actions


def answered(client, request: bytes) -> object:
    replies: list[object] = []
    until(lambda: client.ready, "the server is seen")
    client.call(request, replies.append)
    return until(lambda: replies, "the call ends")[0]


@EACH_RELEASE
@pytest.mark.parametrize("service", [SERVICE, ACTION_PART], ids=["service", "action"])
def test_a_client_of_each_release_is_answered(hub: Hub, node: Nodes, release: Release, service: Topic) -> None:
    """The first call must not be lost, although the server has not yet discovered the client."""

    def answer(request: bytes, done: Done) -> Callable[[], None]:
        done(b"re " + request)
        return nothing

    hub.server(service.name, service.type_name, service.type_hash, answer)
    peer = node(release)
    query = f"@ros2_lv/**/SS/**/{service.name.replace('/', '%')}/**"
    until(lambda: [*peer.session.liveliness().get(query)], "the server is seen")
    client = ReleaseClient(peer, service)
    assert client.call(b"1") == [b"re 1"]
    assert client.call(b"2") == [b"re 2"]


@EACH_RELEASE
@pytest.mark.parametrize("service", [SERVICE, ACTION_PART], ids=["service", "action"])
def test_a_server_of_each_release_is_called_once(hub: Hub, node: Nodes, release: Release, service: Topic) -> None:
    client = hub.client(service.name, service.type_name, service.type_hash)
    server = ReleaseServer(node(release), service, lambda request: b"re " + request)
    assert answered(client, b"go") == b"re go"
    assert server.requests == [b"go"]
    server.close()
    until(lambda: not client.ready, "the server has left")


def test_a_client_calls_the_server_with_its_own_hash(hub: Hub, node: Nodes) -> None:
    client = hub.client(SERVICE.name, SERVICE.type_name, HASH)
    humble = ReleaseServer(node(HUMBLE), SERVICE, lambda _: b"humble")
    assert answered(client, b"1") == b"humble"
    jazzy = ReleaseServer(node(JAZZY), SERVICE, lambda _: b"jazzy")
    until(lambda: answered(client, b"2") == b"jazzy", "the other server is called")
    jazzy.close()
    until(lambda: len(hub.graph.servers(SERVICE.name)) == 1, "the server has left")
    until(lambda: answered(client, b"3") == b"humble", "the client has seen that the server left")
    assert humble.requests.count(b"3") == 1


def test_a_pending_call_of_a_server_without_a_hash_ends_when_the_server_leaves(hub: Hub, node: Nodes) -> None:
    peer = node(HUMBLE)
    client = hub.client(SERVICE.name, SERVICE.type_name, HASH)
    server = ReleaseServer(peer, SERVICE, lambda _: until(lambda: False, "never", 0.01) or b"")
    until(lambda: client.ready, "the server is seen")
    ended: list[object] = []
    client.call(b"go", ended.append)
    until(lambda: server.requests, "the server is called")
    with closing(peer):
        pass
    until(lambda: ended, "the call ends")
    assert "left before it answered" in str(ended[0])


# Lyrical's buffers


IMAGE = Topic("/image", "sensor_msgs/msg/Image", HASH, STREAM, array=True)
OWN_IMAGE = Topic("/own", "own_msgs/msg/Pixels", HASH, STREAM, array=True)


class Images(Subscriber):
    """Collects the messages of a subscription to a topic with buffers."""

    def __init__(self, hub: Hub, topic: Topic, qos: Qos = STREAM, type_hash: str = HASH) -> None:
        self.samples = []
        self._lock = Lock()
        self.subscription = hub.subscription(topic.name, topic.type_name, type_hash, qos, self._add)


def group_of(publisher: ReleasePublisher) -> str:
    return f"{publisher.key}/{CPU_GROUP}"


@pytest.mark.parametrize("type_hash", [HASH, ANY_HASH], ids=["its hash", "any hash"])
@pytest.mark.parametrize("topic", [IMAGE, OWN_IMAGE], ids=["standard type", "other type"])
@pytest.mark.parametrize("first", ["publisher", "subscription"])
def test_a_publisher_with_buffers_serves_the_hub_in_the_cpu_group(
    hub: Hub, node: Nodes, topic: Topic, first: str, type_hash: str
) -> None:
    """With rmw_zenoh_cpp 0.10.5 (Lyrical), subscriptions that announce no backend receive nothing.

    The GID of the group's key is derived from the whole token, with the backends.
    """
    peer = node(LYRICAL)
    received = Images(hub, topic, type_hash=type_hash) if first == "subscription" else None
    publisher = ReleasePublisher(peer, topic)
    until(lambda: hub.graph.publishers(topic.name), "the publisher is seen")
    received = received or Images(hub, topic, type_hash=type_hash)
    until(lambda: group_of(publisher) in publisher.discovered(), "the publisher has discovered the group")
    arrives(publisher, received)
    put_all(publisher, numbered(20))
    until(lambda: "19" in received.texts(), "the last message arrives")
    assert [text for text in received.texts() if text != "first"] == numbered(20)
    assert {sample.gid for sample in received.samples} == {publisher.gid}
    assert (received.subscription.lost, received.subscription.refused) == (0, 0)
    known = topic is IMAGE or first == "publisher"
    if known:  # a subscription that announces the group late may already be counted as one without a group
        assert publisher.put(b"once more") == [group_of(publisher)]


def test_the_hub_does_not_cost_a_publisher_with_buffers_a_message_for_each_subscription(
    hub: Hub, node: Nodes, network: HubNetwork
) -> None:
    """The CPU subscriptions of Lyrical and of Midspan share one message."""
    peer = node(LYRICAL)
    publisher = ReleasePublisher(peer, IMAGE)
    lyrical = ReleaseSubscription(node(LYRICAL), IMAGE)
    with Hub.open(network.settings("other")) as other:
        received = [Images(hub, IMAGE), Images(other, IMAGE)]
        until(lambda: len(publisher.discovered()) == 3, "all subscriptions are discovered")
        assert publisher.put(b"1") == [group_of(publisher)]
        for subscription in (lyrical, *received):
            until(lambda s=subscription: s.texts() == ["1"], "the message arrives")


def test_numbers_used_on_other_keys_do_not_count_as_losses(hub: Hub, node: Nodes) -> None:
    """The publisher also numbers its messages on the separate key of a Jazzy subscription."""
    publisher = ReleasePublisher(node(LYRICAL), IMAGE)
    received = Images(hub, IMAGE)
    ReleaseSubscription(node(JAZZY), IMAGE)
    until(lambda: len(publisher.discovered()) == 2, "both subscriptions are discovered")
    arrives(publisher, received)
    put_all(publisher, numbered(5))
    until(lambda: "4" in received.texts(), "the last message arrives")
    numbers = [sample.sequence for sample in received.samples]
    assert numbers == list(range(numbers[0], numbers[-1] + 1, 2))
    assert received.subscription.lost == 0


def test_serialized_messages_on_the_key_and_messages_of_the_group_arrive_in_order(hub: Hub, node: Nodes) -> None:
    publisher = ReleasePublisher(node(LYRICAL), IMAGE)
    received = Images(hub, IMAGE)
    until(publisher.discovered, "the subscription is discovered")
    arrives(publisher, received)
    for number in range(0, 20, 2):
        publisher.put(str(number).encode())
        publisher.put_serialized(str(number + 1).encode())
    until(lambda: "19" in received.texts(), "the last message arrives")
    assert [text for text in received.texts() if text != "first"] == numbered(20)


@EACH_RELEASE
def test_images_of_the_hub_reach_each_release_once(hub: Hub, node: Nodes, release: Release) -> None:
    received = ReleaseSubscription(node(release), IMAGE)
    publisher = hub.publisher(IMAGE.name, IMAGE.type_name, HASH, STREAM)
    matched(publisher)
    put_all(publisher, numbered(20))
    until(lambda: len(received.samples) >= 20, "all messages arrive")
    assert received.texts() == numbered(20)


@EACH_RELEASE
def test_images_of_each_release_reach_the_hub_once(hub: Hub, node: Nodes, release: Release) -> None:
    received = Images(hub, IMAGE)
    publisher = ReleasePublisher(node(release), IMAGE)
    arrives(publisher, received)
    put_all(publisher, numbered(20))
    until(lambda: "19" in received.texts(), "the last message arrives")
    assert [text for text in received.texts() if text != "first"] == numbered(20)


def test_only_subscriptions_in_the_group_announce_it(hub: Hub, node: Nodes) -> None:
    peer = node(JAZZY)
    tokens: set[str] = set()

    def on_token(sample: zenoh.Sample) -> None:
        (tokens.discard if sample.kind == zenoh.SampleKind.DELETE else tokens.add)(str(sample.key_expr))

    handler = zenoh.handlers.Callback(on_token, indirect=False)
    watch = peer.session.liveliness().declare_subscriber(f"@ros2_lv/*/{hub.zid}/*/*/MS/**", handler, history=True)
    image, chatter = Images(hub, IMAGE), Subscriber(hub, "/chatter")
    hub.publisher(IMAGE.name, IMAGE.type_name, HASH, STREAM)
    until(lambda: len(tokens) == 2, "both endpoints are announced")
    assert {token.split("/")[9]: token.split("/")[13:] for token in tokens} == {
        "%image": ["backends:cpu:"], "%chatter": [],
    }  # fmt: skip
    image.subscription.close()
    chatter.subscription.close()
    until(lambda: not tokens, "both endpoints are withdrawn")
    watch.undeclare()


def test_standard_types_with_buffers_have_a_sequence_of_bytes() -> None:
    registry = Registry()
    for type_name in BUFFER_TYPES:
        definitions = registry.schema(type_name).types.values()
        fields = [field.type for definition in definitions for field in definition.fields]
        assert any(field.base == "uint8" and field.shape is Shape.SEQUENCE and not field.length for field in fields)
    assert not {"sensor_msgs/msg/LaserScan", "nav_msgs/msg/OccupancyGrid", "std_msgs/msg/ByteMultiArray"} & BUFFER_TYPES
