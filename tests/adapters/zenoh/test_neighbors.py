"""Midspan's other sessions are detected on a dialect's network."""

from __future__ import annotations

import time

from bridge.adapters.zenoh.neighbors import DISCOVERY_SECONDS, KeyNeighbors
from tests.adapters.zenoh.conftest import Place
from tests.peers.zenoh.programs import open_session


def test_the_end_of_a_discovery_period_is_reported_once_however_late(place: Place) -> None:
    reported: list[bool] = []
    with open_session(place.router.endpoint) as session:
        neighbors = KeyNeighbors(session, "ros1", "", frozenset(), lambda: reported.append(True), lambda: None)
        try:
            assert neighbors.is_own("5ea"), "the session's token may be delayed"
            now = time.monotonic()
            neighbors.tick(now + DISCOVERY_SECONDS / 2)
            assert reported == []
            neighbors.tick(now + 10 * DISCOVERY_SECONDS)
            neighbors.tick(now + 11 * DISCOVERY_SECONDS)
            assert reported == [True]
        finally:
            neighbors.close()
