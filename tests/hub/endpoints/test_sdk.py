"""zenoh-ros2-sdk, an independent program in a separate process, exchanges messages with the hub in both directions."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos, Reliability
from tests.peers.hub.endpoints import LATCHED, STREAM, matched
from tests.peers.hub.network import HubNetwork
from tests.peers.peer import Peer
from tests.support.wait import until

STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def cdr(text: str) -> bytes:
    """Return a std_msgs/String in CDR."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


@pytest.fixture
def sdk(network: HubNetwork) -> Iterator[Peer]:
    with network.sdk_peer() as peer:
        yield peer


@pytest.fixture
def hub(network: HubNetwork) -> Iterator[Hub]:
    with Hub.open(network.settings("midspan_test", namespace="/robot")) as hub:
        yield hub


def test_sdk_node_discovers_our_endpoints(hub: Hub, sdk: Peer):
    hub.publisher(
        "/robot/chatter", STRING, STRING_HASH, Qos(Reliability.BEST_EFFORT, Durability.TRANSIENT_LOCAL, depth=3)
    )
    hub.subscription("/robot/chatter", STRING, STRING_HASH, STREAM, lambda _sample: None)

    def seen_by_sdk() -> dict[str, Any] | None:  # the SDK queries the network each time, and ignores late replies
        info: dict[str, Any] | None = sdk.ask("topic_info", topic="/robot/chatter")["info"]
        return info if info and len(info["publishers"]) == len(info["subscribers"]) == 1 else None

    info = until(seen_by_sdk, "the SDK sees both endpoints")
    assert info["topic_types"] == [STRING]
    for seen, qos in ((info["publishers"], "2:1:,3:,:,:,,"), (info["subscribers"], "::,10:,:,:,,")):
        (endpoint,) = seen
        assert (endpoint["node_name"].strip("/"), endpoint["node_namespace"]) == ("midspan_test", "/robot")
        assert (endpoint["topic_type"], endpoint["type_hash"], endpoint["qos"]) == (STRING, STRING_HASH, qos)


def test_we_discover_endpoints_of_an_sdk_node(hub: Hub, sdk: Peer):
    publisher = sdk.advertise("/chatter", "std_msgs/String", latched=True, depth=5)
    sdk.subscribe("/map", "nav_msgs/OccupancyGrid", best_effort=True)
    until(lambda: len(hub.graph.endpoints()) == 2, "both endpoints are seen")
    (talker,), (listener,) = hub.graph.publishers(), hub.graph.subscriptions()
    assert (talker.topic, talker.type_name, talker.type_hash) == ("/chatter", STRING, STRING_HASH)
    assert (talker.node, talker.namespace, talker.origin, talker.pending) == ("sdk_talker", "/", None, False)
    assert talker.qos == Qos(durability=Durability.TRANSIENT_LOCAL, depth=5)
    assert (listener.topic, listener.type_name, listener.node) == ("/map", "nav_msgs/msg/OccupancyGrid", "sdk_listener")
    assert listener.qos.reliability is Reliability.BEST_EFFORT
    sdk.drop(publisher)
    until(lambda: not hub.graph.publishers(), "the publisher is removed from the graph")


def test_sdk_subscriber_receives_our_messages(hub: Hub, sdk: Peer):
    listener = sdk.subscribe("/chatter", "std_msgs/String")
    publisher = hub.publisher("/chatter", STRING, STRING_HASH, STREAM)
    matched(publisher)
    for number in range(5):
        publisher.put(cdr(f"hello {number} ä"))
    messages = sdk.wait(listener, 5)
    assert [m["data"] for m in messages] == [f"hello {n} ä" for n in range(5)]


def test_we_receive_messages_of_an_sdk_publisher(hub: Hub, sdk: Peer):
    samples: list[HubSample] = []
    hub.subscription("/chatter", STRING, STRING_HASH, STREAM, samples.append)
    talker = sdk.advertise("/chatter", "std_msgs/String")
    until(lambda: hub.graph.publishers("/chatter"), "the publisher is seen")
    before = time.time_ns()
    # the SDK does not report matches, so the first message is repeated until it is received
    until(lambda: sdk.publish(talker, {"data": "first"}) or samples, "the first message arrives")
    sdk.publish(talker, {"data": "second"})
    until(lambda: samples[-1].data() == cdr("second"), "the second message arrives")
    assert {sample.data() for sample in samples} == {cdr("first"), cdr("second")}
    assert [b.sequence - a.sequence for a, b in itertools.pairwise(samples)] == [1] * (len(samples) - 1)
    assert before <= samples[0].source_time_ns <= time.time_ns()
    assert len({sample.gid for sample in samples}) == 1
    assert {sample.zid for sample in samples} == {""}


def test_sdk_subscriber_receives_our_latched_messages(hub: Hub, sdk: Peer, network: HubNetwork):
    """One message per session: the SDK's query lets zenoh keep only the newest reply of a session for each key."""
    with Hub.open(network.settings("other")) as other:
        for session, text in ((hub, "one"), (other, "two")):
            publisher = session.publisher("/map", STRING, STRING_HASH, LATCHED)
            publisher.put(cdr("old"))
            publisher.put(cdr(text))
        until(lambda: len(sdk.graph()["publishers"].get("/map", ())) == 2, "the SDK sees both publishers")

        def asked() -> list[str]:
            """Return what a new subscriber receives with its only query of the caches that the router has announced."""
            listener = sdk.subscribe("/map", "std_msgs/String", latched=True)
            return sorted(m["data"] for m in sdk.wait(listener, 2, 2.0))

        first = until(asked, "the SDK receives from a cache")
        assert set(first) <= {"one", "two"}, "only the newest messages arrive"
        until(lambda: asked() == ["one", "two"], "both caches reply")


def test_only_subscriptions_to_any_hash_receive_another_hash(hub: Hub, sdk: Peer):
    same: list[HubSample] = []
    every: list[HubSample] = []
    hub.subscription("/chatter", STRING, STRING_HASH, STREAM, same.append)
    hub.subscription("/chatter", STRING, "*", STREAM, every.append)
    talker = sdk.advertise("/chatter", "std_msgs/String", hash="RIHS01_" + "0" * 63 + "1")
    until(lambda: sdk.publish(talker, {"data": "x"}) or every, "a message arrives")
    assert same == []
    (publisher,) = until(lambda: hub.graph.publishers("/chatter"), "the publisher is seen")
    assert publisher.type_hash.endswith("1")
