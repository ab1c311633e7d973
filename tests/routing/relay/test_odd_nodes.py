"""Nodes with malformed, unusual or changing endpoints: each affects only itself, and never a side."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.messages.mapping import releases
from bridge.messages.registry import Registry
from tests.peers.zenoh.release_actions import hash_in
from tests.peers.zenoh.releases import HUMBLE, JAZZY, LYRICAL, Nodes, ReleasePublisher, ReleaseSubscription, Topic
from tests.routing.relay.conftest import Relays
from tests.routing.relay.test_services import CLEAR
from tests.routing.relay.test_topics import (
    CHATTER,
    FEEDBACK,
    STREAM,
    STRING,
    Topics,
    connect,
    put_texts,
    texts,
    until_topics,
)
from tests.support.wait import until


def test_a_malformed_hash_stops_no_other_node(relay: Relays, node: Nodes) -> None:
    worker, nodes = relay(), (node(HUMBLE), node(JAZZY))
    bad = Topic("/topic", STRING, "RIHS01_none", STREAM)
    ReleaseSubscription(nodes[1], bad)
    ReleasePublisher(nodes[1], bad)
    until(lambda: worker.hub.graph.publishers("/topic"), "the publisher with a malformed hash is seen")
    publisher, received = CHATTER.publisher(nodes[0]), CHATTER.subscription(nodes[1])
    connect(publisher, received)
    assert not worker.relay._failures


@pytest.mark.parametrize("kind", ["topic", "service"])
def test_a_type_that_cannot_be_compared_stops_no_other_node(
    relay: Relays, node: Nodes, kind: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    bad, registry = FEEDBACK if kind == "topic" else CLEAR, Registry()
    convert = releases.version_converter

    def fails_for_one(source: Any, target: Any, rules: Any) -> Any:
        if source.name.startswith(bad.removesuffix("Message")):
            raise RecursionError("the definition nests itself")
        return convert(source, target, rules)

    monkeypatch.setattr(releases, "version_converter", fails_for_one)
    worker, nodes = relay(), (node(LYRICAL), node(JAZZY))
    worker.hub.versions = registry.releases
    if kind == "topic":
        ReleasePublisher(nodes[0], Topic("/bad", bad, hash_in("lyrical", bad), STREAM))
        ReleaseSubscription(nodes[1], Topic("/bad", bad, hash_in("jazzy", bad), STREAM))
    else:
        nodes[1].announce(nodes[1].token("SS", Topic("/bad", bad, hash_in("jazzy", bad))))
    until(lambda: bad in caplog.text, "the failure is reported")
    nodes = node(HUMBLE), nodes[1]
    publisher, received = CHATTER.publisher(nodes[0]), CHATTER.subscription(nodes[1])
    connect(publisher, received)
    assert not [key for key in (*worker.relay.topics(), *worker.relay.services()) if key.topic == "/bad"]


def test_a_failed_comparison_of_the_graph_is_reported_and_repeated(
    relay: Relays, node: Nodes, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    worker, fails = relay(), True
    elect = worker.relay._election.elect

    def failing(sessions: Any) -> frozenset[str]:
        if fails and sessions:
            raise ValueError("a bad session")
        return elect(sessions)

    monkeypatch.setattr(worker.relay._election, "elect", failing)
    publisher, received = CHATTER.publisher(node(HUMBLE)), CHATTER.subscription(node(JAZZY))
    until(lambda: "a bad session" in caplog.text, "the failure is reported")
    fails = False
    connect(publisher, received)


def test_a_node_returns_with_another_version(relay: Relays, node: Nodes) -> None:
    worker, jazzy = relay(), node(JAZZY)
    received = CHATTER.subscription(jazzy)
    first = CHATTER.publisher(humble := node(HUMBLE))
    connect(first, received)
    humble.close()
    until_topics(worker, 0)
    same = CHATTER.publisher(again := node(JAZZY))
    connect(same, received)
    again.close()
    last = CHATTER.publisher(node(HUMBLE))
    connect(last, received)
    received.samples.clear()
    values = put_texts(last)
    until(lambda: values[-1] in texts(received), "all messages arrive")
    assert texts(received) == values


@pytest.mark.parametrize("name", ["/Ünï/café", "/a.b-c~d/e@f", "/x" * 100, "/topic/_action/feedback"])
def test_unusual_names_are_relayed(relay: Relays, node: Nodes, name: str) -> None:
    relay()
    topic = Topics(STRING, name=name)
    publisher, received = topic.publisher(node(HUMBLE)), topic.subscription(node(JAZZY))
    connect(publisher, received)
    assert {sample.gid for sample in received.samples} == {publisher.gid}


def test_a_burst_of_large_messages_arrives_in_order(relay: Relays, node: Nodes) -> None:
    worker = relay()
    publisher, received = CHATTER.publisher(node(LYRICAL)), CHATTER.subscription(node(HUMBLE))
    connect(publisher, received)
    large = "x" * 300_000
    values = [f"{number}{large}" for number in range(100)]
    for value in values:
        publisher.put(b"\0\1\0\0" + (len(value) + 1).to_bytes(4, "little") + value.encode() + b"\0")
    ends = 0

    def ended() -> bool:
        nonlocal ends
        ends += 1
        publisher.put(b"\0\1\0\0\2\0\0\0e\0")  # like any message, zenoh may drop it while its queue is full
        return "e" in texts(received)

    until(ended, "the burst arrives", every=0.1)
    found = [text for text in texts(received) if text != "e"]
    (counters,) = (topic.counters for topic in worker.relay.topics().values())
    assert found == [value for value in values if value in found]
    assert len(found) + sum(counters.drops.values()) <= len(values) + ends
