"""Midspan's other sessions are detected on a dialect's network."""

from __future__ import annotations

import contextlib
import threading
import time

import pytest
import zenoh

from bridge.adapters.zenoh.neighbors import DISCOVERY_SECONDS, KeyNeighbors, new_zid
from tests.adapters.zenoh.conftest import Place
from tests.peers.hub.calls import nothing
from tests.peers.zenoh.programs import open_session
from tests.support.wait import until


def test_the_end_of_a_discovery_period_is_reported_once_however_late(place: Place) -> None:
    reported: list[bool] = []
    with open_session(place.router.endpoint) as session:
        neighbors = KeyNeighbors(session, "ros1", "", frozenset(), lambda: reported.append(True), lambda: None)
        try:
            now = time.monotonic()
            assert neighbors.is_own("5ea"), "the session's token may be delayed"
            neighbors.tick(now + DISCOVERY_SECONDS / 2)
            assert reported == []
            neighbors.tick(now + 10 * DISCOVERY_SECONDS)
            neighbors.tick(now + 11 * DISCOVERY_SECONDS)
            assert reported == [True]
        finally:
            neighbors.close()


def test_the_query_for_all_sessions_is_handled_on_another_thread(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """During the query, zenoh holds the session's lock when it calls the handler with known tokens."""
    threads: list[threading.Thread] = []
    on_reply = KeyNeighbors._on_reply

    def handle(neighbors: KeyNeighbors, reply: zenoh.Reply) -> None:
        threads.append(threading.current_thread())
        on_reply(neighbors, reply)

    monkeypatch.setattr(KeyNeighbors, "_on_reply", handle)
    with contextlib.ExitStack() as stack:
        first, _second = [
            stack.enter_context(contextlib.closing(KeyNeighbors(session, "ros1", "", frozenset(), nothing, nothing)))
            for session in (stack.enter_context(open_session(place.router.endpoint, id=new_zid())) for _ in range(2))
        ]
        until(first.sightings, "the other session is seen")
        # while zenoh links the two sessions directly, a query may find no token
        until(lambda: (first.settled(time.monotonic()), threads)[1], "a query has found the other session")
    assert threading.current_thread() not in threads
