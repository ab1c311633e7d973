"""What is latched now: of which publishers it is kept, and for how long."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.modules.hub_topics import TopicKey
from bridge.record import latched
from bridge.record.arrivals import RecordedMessage, TopicCounts
from bridge.record.latched import LatchedState
from tests.hub.parts import LATCHED, STREAM, TYPE, endpoint

GID = b"g" * 16


class Graph:
    """The publishers that the hub tells of."""

    def __init__(self) -> None:
        self.ends: list[Any] = []

    def endpoint(self, gid: bytes) -> Any:
        return next((end for end in self.ends if end.gid == gid), None)

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
    return RecordedMessage(counts, gid, None, number, number, number, b"data")


def kept(state: LatchedState) -> list[int]:
    return [each.sequence for each in state.all()]


def test_a_message_may_come_before_the_graph_tells_of_its_publisher(graph: Graph, state: LatchedState) -> None:
    state.saw(message(1))
    graph.ends.append(endpoint("/map", GID, LATCHED))
    assert kept(state) == [1]
    state.saw(message(2))
    assert kept(state) == [2]
    graph.ends.clear()
    assert kept(state) == []


def test_of_a_publisher_that_turns_out_to_keep_nothing_nothing_is_kept(graph: Graph, state: LatchedState) -> None:
    state.saw(message(1))
    state.saw(message(2))
    graph.ends.append(endpoint("/map", GID, STREAM))
    assert kept(state) == []
    state.saw(message(3))
    assert kept(state) == []


def test_of_publishers_that_nobody_knows_few_messages_wait(
    graph: Graph, state: LatchedState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(latched, "MOST_UNKNOWN", 2)
    gids = [bytes([number]) * 16 for number in range(4)]
    for number, gid in enumerate(gids):
        state.saw(message(number, gid))
    known = b"k" * 16
    graph.ends.append(endpoint("/map", known, LATCHED))
    state.saw(message(9, known))  # those that nobody knows take no room from it
    graph.ends += [endpoint("/map", gid, LATCHED) for gid in gids]
    assert kept(state) == [0, 1, 9]
