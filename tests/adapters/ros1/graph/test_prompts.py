"""Subscribers that missed a publication are prompted to connect."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any
from xmlrpc.client import ServerProxy

import pytest

from bridge.adapters.ros1.graph import prompts as prompts_module
from bridge.adapters.ros1.graph.presence import NodeEntry
from bridge.adapters.ros1.graph.prompts import FIRST, LONGEST, Prompts
from bridge.adapters.ros1.graph.registrations import NodeRegistrations
from bridge.adapters.ros1.graph.state import MasterState, Registration
from bridge.adapters.ros1.peer_pool import PeerPool
from bridge.adapters.ros1.topics.book import TopicBook
from bridge.messages.transcode.conversion import SideType
from tests.peers.ros1.fake_node import FakeNode
from tests.peers.ros1.network import needs_ros1
from tests.support.wait import until

ENTRY = NodeEntry("me", "robot", "/midspan", "http://m:1/", 1)
OTHER = NodeEntry("you", "robot2", "/midspan_robot2", "http://o:1/", 2)
SCAN = Registration("/midspan", "/scan", "http://m:1/")
RVIZ = Registration("/rviz", "/scan", "http://r:1/")


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> Iterator[PeerPool]:
    """A pool whose calls do not expire on a busy machine: the next call is due only as the test's clock advances."""
    monkeypatch.setattr(prompts_module, "_SECONDS", 60.0)
    pool = PeerPool()
    yield pool
    pool.stop()


@pytest.fixture
def node() -> Iterator[FakeNode]:
    node = FakeNode()
    yield node
    node.close()


def answered(prompts: Prompts, links: frozenset[Registration], now: float) -> set[str]:
    """Return the topics of the nodes that answer a call at this time."""
    assert prompts.topics(links, now) == set()
    return until(lambda: prompts.topics(links, now), "the node has answered")


def test_pauses_between_the_prompts_of_a_subscriber_double(pool: PeerPool, node: FakeNode) -> None:
    prompts, links = Prompts(pool, lambda: "/midspan", lambda: None), frozenset({Registration("/a", "/t", node.api)})
    now, pause, pauses = 0.0, FIRST, 0
    assert prompts.topics(links, now) == set()
    while pause < LONGEST:
        assert prompts.topics(links, now + 0.99 * pause) == set()
        assert len(node.calls) == pauses, "the node is not called before the end of the pause"
        now += pause
        assert answered(prompts, links, now) == {"/t"}
        pause, pauses = min(2 * pause, LONGEST), pauses + 1
    assert node.calls == [("getPid",)] * pauses
    assert prompts.topics(frozenset(), now) == set()
    assert prompts.topics(links, now + LONGEST) == set()
    assert answered(prompts, links, now + LONGEST + FIRST) == {"/t"}, "a connection in between resets the pause"


def test_silent_and_dead_nodes_are_not_prompted_and_do_not_delay_others(pool: PeerPool, node: FakeNode) -> None:
    """The master would call them without a deadline, on one of a few threads."""
    silent = FakeNode()
    silent.answers.clear()
    prompts = Prompts(pool, lambda: "/midspan", lambda: None)
    nodes = {"/silent": silent.api, "/dead": "http://127.0.0.1:9/", "/alive": node.api}
    links = frozenset(Registration(name, f"/t{name}", api) for name, api in nodes.items())
    try:
        prompts.topics(links, 0.0)
        assert answered(prompts, links, FIRST) == {"/t/alive"}
    finally:
        silent.close()


def test_a_subscriber_that_connects_while_its_node_is_called_is_not_prompted(pool: PeerPool, node: FakeNode) -> None:
    replies: list[bool] = []
    prompts = Prompts(pool, lambda: "/midspan", lambda: replies.append(True))
    links = frozenset({Registration("/a", "/t", node.api)})
    prompts.topics(links, 0.0)
    prompts.topics(links, FIRST)
    until(lambda: replies, "the node has answered")
    assert prompts.topics(frozenset(), FIRST) == set()
    assert prompts.topics(links, FIRST) == set()


def test_only_nodes_that_could_connect_are_prompted() -> None:
    """Midspan's nodes do not connect to each other's topics."""
    listed: list[frozenset[Registration]] = []

    def unconnected(subscribers: frozenset[Registration]) -> frozenset[Registration]:
        listed.append(subscribers)
        return subscribers

    node: Any = SimpleNamespace(
        name=ENTRY.node, uri=ENTRY.uri, publications=lambda: {"/scan": "sensor_msgs/LaserScan"}, services=dict,
        subscriptions=dict, take_removed=set, unconnected=unconnected,
    )  # fmt: skip
    prompts: Any = SimpleNamespace(topics=lambda links, _now: {link.topic for link in links})
    registrations = NodeRegistrations(node, lambda _: False, prompts)
    subscribers = {
        RVIZ, RVIZ._replace(topic="/other"), RVIZ._replace(node="/new", uri=""), SCAN,
        SCAN._replace(node=OTHER.node, uri=OTHER.uri),
    }  # fmt: skip
    presence = {entry.key: entry.as_dict() for entry in (ENTRY, OTHER)}
    state = MasterState("one#1", "one", frozenset({SCAN}), frozenset(subscribers), presence=presence)
    register = ("registerPublisher", ("/midspan", "/scan", "sensor_msgs/LaserScan", "http://m:1/"))
    assert [c for c in registrations.corrections(state, ENTRY) if "Publisher" in c[0]] == [register]
    assert listed == [{RVIZ}]


def test_a_subscriber_with_another_type_is_not_prompted_until_the_publication_ends() -> None:
    unused: Any = None
    book = TopicBook(unused, lambda: "/midspan", "", lambda: None, lambda: None)
    publication = book.publish("/scan", SideType("sensor_msgs/LaserScan", "90c7", ""), latched=False)
    assert book.unconnected(frozenset({RVIZ})) == {RVIZ}
    assert book.admit(unused, {"topic": "/scan", "callerid": "/rviz", "md5sum": "992c", "type": "std_msgs/String"})
    assert book.unconnected(frozenset({RVIZ})) == set()
    book.unpublish(publication, latched=False)
    assert book.rejected() == {}


@needs_ros1
def test_a_subscriber_that_notices_the_end_of_its_connection_late_receives_messages(master, edge):
    """While a callback keeps rospy from reading the end of a connection, it ignores the publisher's return."""
    first = edge.ask("advertise", topic="/late", type="std_msgs/String")["id"]
    with master.peer("late") as peer:
        inbox = peer.subscribe("/late", "std_msgs/String")
        edge.until_connected(first)
        peer.ask("stall", id=inbox)
        edge.send(first, "before")
        assert [m["data"] for m in peer.wait(inbox, 1)] == ["before"]
        before = peer.ask("attempts", topic="/late")["count"]
        edge.drop(first)
        second = edge.ask("advertise", topic="/late", type="std_msgs/String")["id"]
        until(lambda: peer.ask("attempts", topic="/late")["count"] > before, "the publisher's return is ignored")
        peer.ask("resume", id=inbox)
        edge.until_connected(second)
        edge.send(second, "after")
        assert [m["data"] for m in peer.wait(inbox, 2)] == ["before", "after"]


@needs_ros1
def test_a_prompt_does_not_disconnect_other_subscribers(master, edge):
    """``rosout`` of roscore, a roscpp program, would disconnect from a publisher that unregisters."""
    publisher = edge.ask("advertise", topic="/rosout", type="rosgraph_msgs/Log")["id"]
    edge.until_connected(publisher)

    def connections() -> list[Any]:
        node: Any
        with ServerProxy(master.call("lookupNode", "/midspan")) as node:
            _, _, infos = node.getBusInfo("/test")
        return [info for info in infos if info[4] == "/rosout"]

    before = connections()
    with contextlib.closing(FakeNode()) as missing, ServerProxy(master.uri) as proxy:
        _, _, publishers = proxy.registerSubscriber("/missing", "/rosout", "rosgraph_msgs/Log", missing.api)
        updates = until(lambda: [c for c in missing.calls if c[0] == "publisherUpdate"], "the subscriber is prompted")
        assert updates[0] == ("publisherUpdate", "/rosout", publishers)
        assert connections() == before
        proxy.unregisterSubscriber("/missing", "/rosout", missing.api)
    edge.drop(publisher)
