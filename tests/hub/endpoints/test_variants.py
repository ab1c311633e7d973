"""Updates of key variants, in which endpoints neither wait for each other nor fail together."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from bridge.concurrency import SerialExecutor
from bridge.hub.endpoints.services import HubClient
from bridge.hub.endpoints.sinks import LatchedSink
from bridge.hub.endpoints.variants import KeyVariants, Variants
from bridge.hub.graph.hashes import KindOfEndpoint
from bridge.hub.graph.tokens import EndpointKind, EndpointToken, NodeToken, endpoint_key
from bridge.hub.node import Hub
from bridge.hub.wire.keys import NO_HASH
from tests.peers.hub.endpoints import HASH, LATCHED, STREAM, TYPE, advertise
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

TOKEN = endpoint_key(
    EndpointToken(NodeToken(0, "1", "0", "/", "node"), "7", EndpointKind.PUBLISHER, "/t", TYPE, HASH, STREAM)
)


class Graph:
    """A graph with a hashless subscription, once `change` has been called."""

    def __init__(self) -> None:
        self.variants_version = 0
        self._changed: Callable[[], None] = lambda: None

    def watch(self, changed: Callable[[], None]) -> Callable[[], None]:
        self._changed = changed
        return lambda: None

    def other_hashes(self, wanted: KindOfEndpoint) -> dict[str, bool]:
        assert wanted == (EndpointKind.SUBSCRIPTION, "/t", TYPE)
        return {NO_HASH: False} if self.variants_version else {}

    def change(self) -> None:
        self.variants_version += 1
        self._changed()


class VariedEnd:
    """An endpoint that records its variants, and calls ``work`` for each."""

    def __init__(self, work: Callable[[], object] = lambda: None) -> None:
        self.variants: list[str] = []
        self._work = work

    def follow_variants(self, variants: Variants) -> None:
        for variant in variants:
            self._work()
            self.variants.append(variant)


@pytest.fixture
def graph() -> Graph:
    return Graph()


@pytest.fixture
def variants(graph: Graph) -> Iterator[KeyVariants]:
    executor = SerialExecutor("test-variants")
    yield KeyVariants(cast("Any", graph), executor)
    executor.close()


def test_a_blocking_endpoint_does_not_delay_a_new_endpoint(graph: Graph, variants: KeyVariants) -> None:
    go_on, blocked = threading.Event(), threading.Event()
    variants.add(slow := VariedEnd(lambda: (blocked.set(), go_on.wait(60.0))), TOKEN)
    graph.change()
    assert blocked.wait(20.0)
    quick = VariedEnd()
    adding = threading.Thread(target=variants.add, args=(quick, TOKEN))
    adding.start()
    try:
        adding.join(40.0)
        assert quick.variants == [NO_HASH]
        variants.remove(slow)
    finally:
        go_on.set()
        adding.join(40.0)


def test_endpoint_that_fails_does_not_stop_the_others(
    graph: Graph, variants: KeyVariants, caplog: pytest.LogCaptureFixture
) -> None:
    def fail() -> None:
        msg = "cannot declare"
        raise zenoh.ZError(msg)

    ends = [VariedEnd(fail), VariedEnd()]
    for end in ends:
        variants.add(end, TOKEN)
    graph.change()
    until(lambda: ends[1].variants, "the second endpoint is updated")
    assert [message for message in caplog.messages if message.startswith("/t: ")] == [
        "/t: cannot update the keys for other releases: cannot declare"
    ]


def test_publishing_does_not_wait_for_the_cached_samples_of_another_key(
    network: HubNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on, restoring, restore = threading.Event(), threading.Event(), LatchedSink.restore

    def slow(sink: LatchedSink, samples: Any) -> None:
        restore(sink, samples)
        restoring.set()
        go_on.wait(60.0)

    monkeypatch.setattr(LatchedSink, "restore", slow)
    with Hub.open(network.settings("midspan")) as hub:
        publisher = advertise(hub, "/map", replace(LATCHED, depth=2), "1", "2")
        following = threading.Thread(target=publisher.follow_variants, args=({NO_HASH: True},))
        putting = threading.Thread(target=publisher.put, args=(b"3",))
        try:
            following.start()
            assert restoring.wait(20.0)
            putting.start()
            putting.join(40.0)
            assert not putting.is_alive()
        finally:
            go_on.set()
            following.join(20.0)
            putting.join(20.0)
        (sink,) = publisher._more.values()
        assert isinstance(sink, LatchedSink)
        assert [payload.to_bytes() for payload, _ in sink.stored] == [b"2", b"3"]


class EndedElsewhere(dict[str, Any]):
    """Variants that another thread removes right after this thread has read their names."""

    def __bool__(self) -> bool:
        names = bool(len(self))
        self.clear()
        return names

    def __iter__(self) -> Iterator[str]:
        names = list(super().__iter__())
        self.clear()
        return iter(names)


def test_variants_of_a_client_that_another_thread_ends_are_no_error() -> None:
    client = HubClient.__new__(HubClient)
    client._more = EndedElsewhere({NO_HASH: SimpleNamespace(close=lambda: None)})
    client._end_variants()
    assert len(client._more) == 0
