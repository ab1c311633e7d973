"""Midspan's other sessions on a dialect's network."""

from __future__ import annotations

import time

from bridge.adapters.zenoh.neighbours import DISCOVERY_SECONDS, KeyNeighbours
from tests.adapters.zenoh.conftest import Place
from tests.peers.zenoh.programs import open_session


def test_the_end_of_a_discovery_period_is_reported_once_however_late(place: Place) -> None:
    reported: list[bool] = []
    with open_session(place.router.endpoint) as session:
        neighbours = KeyNeighbours(session, "ros1", "", frozenset(), lambda: reported.append(True), lambda: None)
        try:
            assert neighbours.is_own("5ea"), "its token may be delayed"
            now = time.monotonic()
            neighbours.tick(now + DISCOVERY_SECONDS / 2)
            assert reported == []
            neighbours.tick(now + 10 * DISCOVERY_SECONDS)
            neighbours.tick(now + 11 * DISCOVERY_SECONDS)
            assert reported == [True]
        finally:
            neighbours.close()
