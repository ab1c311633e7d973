"""Clients and servers on raw endpoints, in Cyclone DDS's form; the endpoints are stand-ins.

`tests.interop.test_two_dds` and the contract suite use real ones, if rmw_cyclonedds_cpp is installed.
"""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.graph.heartbeats import MATCH_SECONDS
from bridge.adapters.ros2.rcl import RequestId, Taken
from bridge.adapters.ros2.services import raw
from bridge.adapters.ros2.services.cyclone import HEADER, PATIENCE_SECONDS, unwrap, wrap
from bridge.adapters.ros2.services.raw import RawClient, RawServer
from bridge.hub.endpoints.calls import UnsentCallError
from bridge.messages.errors import MessageTypeError
from bridge.routing.edge import MadeBy, Obstacle
from tests.adapters.ros2.graph.test_vendors import CYCLONE, endpoint

REQUEST = b"\0\1\0\0\1"
ON_CYCLONE, ON_FAST, OF_MIDSPAN = (bytes.fromhex(f"{start:0<32}") for start in ("0110aa", "010faa", "0110bb"))
TAKER: Any = None


class Pair:
    """A reader and a writer; what they have matched is set by the test."""

    def __init__(self) -> None:
        self.received: deque[Taken] = deque()
        self.sent: list[bytes] = []
        self.readers: frozenset[bytes] = frozenset()
        self.writers = 0
        self.waker: rcl.Waker | None = None

    def wake(self, waker: rcl.Waker | None) -> None:
        self.waker = waker

    def take(self, taker: rcl.Taker) -> bytes | None:
        taken = self.take_with_gid(taker)
        return None if taken is None else taken.payload

    def take_with_gid(self, _taker: rcl.Taker) -> Taken | None:
        return self.received.popleft() if self.received else None

    def publish(self, payload: bytes) -> None:
        self.sent.append(payload)

    def matched(self) -> int:
        return self.writers

    def matched_readers(self) -> frozenset[bytes]:
        return self.readers

    def receive(self, payload: bytes, gid: bytes = ON_CYCLONE) -> None:
        self.received.append(Taken(payload, gid, 0, 0))


class Graph:
    """A graph in which each service has one server, on Cyclone DDS."""

    def __init__(self) -> None:
        self.snapshot = SimpleNamespace(obstacles={}, servers={"/lamp": frozenset({ON_CYCLONE})})
        self.present = [endpoint(CYCLONE)]
        self.reads = 0

    def servers(self, _service: str) -> list[Any]:
        self.reads += 1
        return self.present

    def obstacle(self, *_: object) -> Obstacle | None:
        return None


def context(graph: Graph) -> Any:
    marks = SimpleNamespace(made_by=lambda gid: MadeBy.MIDSPAN if gid == OF_MIDSPAN else MadeBy.NATIVE)
    return SimpleNamespace(graph=graph, participant=SimpleNamespace(marks=marks))


@pytest.fixture
def graph() -> Graph:
    return Graph()


@pytest.fixture
def pair() -> Pair:
    return Pair()


@pytest.fixture
def client(pair: Pair, graph: Graph) -> RawClient:
    return RawClient("/lamp", pair, context(graph), None)


def test_replies_are_assigned_by_their_headers(client: RawClient, pair: Pair) -> None:
    """DDS delivers each reply of a service to all of its clients."""
    numbers = [client.sender.send(REQUEST) for _ in range(2)]
    headers = []
    for number, sent in zip(numbers, pair.sent, strict=True):
        framed = unwrap(sent)
        assert framed is not None
        assert framed.payload == REQUEST
        assert HEADER.unpack(framed.header)[1] == number
        headers.append(framed.header)
    assert headers[0][:8] == headers[1][:8]
    pair.receive(wrap(headers[1], b"\0\1\0\0\2"))
    pair.receive(wrap(bytes(8) + headers[0][8:], b"\0\1\0\0\3"))  # to another client
    pair.receive(b"\0\1\0\0\4")
    pair.receive(wrap(headers[0], b"\0\1\0\0\5"))
    assert list(client.replies(TAKER, 10)) == [(numbers[1], b"\0\1\0\0\2"), (numbers[0], b"\0\1\0\0\5")]


def test_at_most_as_many_replies_as_requested_are_taken(client: RawClient, pair: Pair) -> None:
    client.sender.send(REQUEST)
    for _ in range(3):
        pair.receive(pair.sent[0])
    assert len(list(client.replies(TAKER, 2))) == 2
    assert len(list(client.replies(TAKER, 2))) == 1


def test_a_server_of_midspan_does_not_count(client: RawClient, pair: Pair) -> None:
    pair.readers, pair.writers = frozenset({OF_MIDSPAN}), 1
    assert not client.sender.has_server()
    pair.readers |= {ON_CYCLONE}
    assert client.sender.has_server()
    pair.writers = 0
    assert not client.sender.has_server()


def test_the_first_request_waits_until_the_servers_have_matched(
    client: RawClient, pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr(raw, "time", SimpleNamespace(monotonic=lambda: now))
    assert client.sender.wait(()) > 0
    pair.readers = frozenset({ON_CYCLONE})
    assert client.sender.wait(()) == pytest.approx(MATCH_SECONDS)
    now += MATCH_SECONDS + 0.01
    assert client.sender.wait(()) == 0.0
    second = ON_CYCLONE[:-1] + b"\2"
    pair.readers |= {second}
    assert client.sender.wait(()) > 0


def test_the_graph_is_read_after_a_change_only(client: RawClient, pair: Pair, graph: Graph) -> None:
    pair.readers = frozenset({ON_CYCLONE})
    assert client.sender.outdated
    for _ in range(3):
        assert client.sender.obstacle() is None
    assert graph.reads == 1
    assert not client.sender.outdated
    pair.readers |= {ON_CYCLONE[:-1] + b"\2"}
    assert client.sender.outdated
    assert client.sender.obstacle() is None
    assert graph.reads == 2


def test_a_server_on_another_dds_that_the_graph_lacks_is_refused(client: RawClient, pair: Pair, graph: Graph) -> None:
    pair.readers = frozenset({ON_CYCLONE, ON_FAST})
    refused = client.sender.obstacle()
    assert isinstance(refused, UnsentCallError)
    assert "/lamp is served on a DDS other than Cyclone DDS" in str(refused)
    assert "remove ros2.rmw" in str(refused)
    assert graph.reads == 0


def server(pair: Pair, *reply_readers: bytes) -> RawServer:
    return RawServer(pair, lambda: list(reply_readers))


def test_requests_carry_their_number_and_header(pair: Pair) -> None:
    header = HEADER.pack(b"12345678", 9)
    pair.receive(wrap(header, REQUEST))
    ((request, payload),) = server(pair).requests(TAKER, 10)
    assert request == RequestId(ON_CYCLONE, 9)
    assert server(pair).unwrap(request, payload) == (header, REQUEST)


def test_requests_in_another_form_are_refused(pair: Pair) -> None:
    pair.receive(REQUEST)
    pair.receive(wrap(HEADER.pack(b"12345678", 9), REQUEST), ON_FAST)
    short, foreign = server(pair).requests(TAKER, 10)
    with pytest.raises(MessageTypeError, match="not little-endian CDR with Cyclone DDS's header"):
        server(pair).unwrap(*short)
    with pytest.raises(MessageTypeError, match="not on Cyclone DDS"):
        server(pair).unwrap(*foreign)


def test_a_reply_waits_for_all_readers_of_its_client(pair: Pair) -> None:
    """DDS does not report which of several readers in a program belongs to the client."""
    first, second = ON_CYCLONE[:-1] + b"\3", ON_CYCLONE[:-1] + b"\4"
    serving, request = server(pair, first, second, OF_MIDSPAN), RequestId(ON_CYCLONE, 1)
    assert not serving.send(request, REQUEST)
    pair.readers = frozenset({first})
    assert not serving.send(request, REQUEST)
    pair.readers |= {second}
    assert serving.send(request, REQUEST)
    pair.readers = frozenset()  # after the first reply, the match is not checked again
    assert serving.send(request, REQUEST)
    assert pair.sent == [REQUEST] * 2
    serving.discard(ON_CYCLONE)
    assert not serving.send(request, REQUEST)


def test_a_reader_that_never_matches_delays_replies_only(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(raw, "time", SimpleNamespace(monotonic=lambda: now))
    first, second = ON_CYCLONE[:-1] + b"\3", ON_CYCLONE[:-1] + b"\4"
    serving, request = server(pair, first, second), RequestId(ON_CYCLONE, 1)
    assert not serving.send(request, REQUEST)
    now += PATIENCE_SECONDS
    assert not serving.send(request, REQUEST)
    pair.readers = frozenset({first})
    assert serving.send(request, REQUEST)


def test_an_undiscovered_client_is_unreachable(pair: Pair) -> None:
    pair.readers = frozenset({ON_CYCLONE})
    assert not server(pair, OF_MIDSPAN).send(RequestId(ON_CYCLONE, 1), REQUEST)


def test_forgotten_clients_are_checked_again(pair: Pair) -> None:
    reader = ON_CYCLONE[:-1] + b"\3"
    serving, request = server(pair, reader), RequestId(ON_CYCLONE, 1)
    pair.readers = frozenset({reader})
    assert serving.send(request, REQUEST)
    serving.retain({ON_CYCLONE})
    pair.readers = frozenset()
    assert serving.send(request, REQUEST)
    serving.retain(set())
    assert not serving.send(request, REQUEST)


def test_client_and_server_register_their_readers_waker(client: RawClient, pair: Pair) -> None:
    waker = rcl.Waker(1, 2)
    client.wake(waker)
    assert pair.waker == waker
    server(pair).wake(None)
    assert pair.waker is None
