"""The latched state: which publishers' messages are stored, and for how long."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.client.topics import TopicKey
from bridge.record import latched
from bridge.record.arrivals import RecordedMessage, TopicCounts
from bridge.record.latched import LatchedState
from tests.peers.hub.endpoints import LATCHED, STREAM, TYPE, endpoint

GID = b"g" * 16


class Graph:
    """The publishers in the hub's graph."""

    def __init__(self) -> None:
        self.ends: list[Any] = []

    def endpoint(self, gid: bytes) -> Any:
        return next((end for end in self.ends if end.gid == gid), None)

    def zid_of(self, gid: bytes) -> str:
        return "a" if any(end.gid == gid for end in self.ends) else ""

    def publishers(self) -> list[Any]:
        return self.ends


@pytest.fixture
def graph() -> Graph:
    return Graph()


@pytest.fixture
def state(graph: Graph) -> LatchedState:
    return LatchedState(graph)  # type: ignore[arg-type]


def message(number: int, gid: bytes = GID) -> RecordedMessage:
    counts = TopicCounts("/map", TopicKey("/map", TYPE, "*"))
    return RecordedMessage(counts, gid, None, number, number, number, 0, b"data")


def stored(state: LatchedState) -> list[int]:
    return [message_.sequence for message_ in state.all()]


def test_a_message_may_arrive_before_its_publisher_is_in_the_graph(graph: Graph, state: LatchedState) -> None:
    state.add(message(1))
    graph.ends.append(endpoint("/map", GID, LATCHED))
    assert stored(state) == [1]
    state.add(message(2))
    assert stored(state) == [2]
    graph.ends.clear()
    assert stored(state) == []


def test_messages_of_a_publisher_that_returns_are_kept(
    graph: Graph, state: LatchedState, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While a link is lost, the graph lacks its publishers; the hub does not deliver their messages again."""
    other = b"h" * 16
    ends = [endpoint("/map", GID, LATCHED), endpoint("/map", other, LATCHED)]
    graph.ends = ends
    state.add(message(1))
    state.add(message(2, other))
    graph.ends = []
    assert stored(state) == []
    graph.ends = ends
    assert stored(state) == [1, 2]
    monkeypatch.setattr(latched, "MAX_DEPARTED", 1)
    graph.ends = []
    assert stored(state) == []
    graph.ends = ends
    assert stored(state) == [2]


def test_the_graph_is_not_searched_for_each_message_of_an_unknown_publisher(
    graph: Graph, state: LatchedState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(latched, "MAX_UNKNOWN", 1)
    searched: list[bytes] = []
    monkeypatch.setattr(graph, "endpoint", searched.append)
    for number in range(3):
        state.add(message(number))
        state.add(message(number, b"h" * 16))
    assert searched == []
    assert stored(state) == []


def test_messages_of_a_volatile_publisher_are_dropped_once_it_is_known(graph: Graph, state: LatchedState) -> None:
    state.add(message(1))
    state.add(message(2))
    graph.ends.append(endpoint("/map", GID, STREAM))
    assert stored(state) == []
    state.add(message(3))
    assert stored(state) == []


def test_messages_of_unknown_publishers_are_limited(
    graph: Graph, state: LatchedState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(latched, "MAX_UNKNOWN", 2)
    gids = [bytes([number]) * 16 for number in range(4)]
    for number, gid in enumerate(gids):
        state.add(message(number, gid))
    known = b"k" * 16
    graph.ends.append(endpoint("/map", known, LATCHED))
    state.add(message(9, known))  # unknown publishers do not displace the message
    graph.ends += [endpoint("/map", gid, LATCHED) for gid in gids]
    assert stored(state) == [0, 1, 9]
