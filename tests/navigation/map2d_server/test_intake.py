"""Maps of other programs, which a rule in ``take`` imports, and of other Map2DServers, which it does not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bridge.hub.node import Hub
from bridge.stores.kinds import MAP
from tests.contract.hubside import HubSide
from tests.navigation.map2d_server.served import GRID, Served, six_flags
from tests.support.wait import until
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D


def test_another_programs_map_is_imported_and_not_republished(served: Served) -> None:
    theirs = six_flags("taken")
    theirs.flags[theirs.flags == MapFlag.KEEP_OUT] = MapFlag.FREE
    served.store.put(MAP, "other", six_flags("other"))
    served.store.use_map("other")
    served.far.until_published("/map")
    mine = {"header": {"frame_id": "map"}, "info": message_info(theirs), "data": data(theirs)}
    out = served.far.advertise("/map", GRID, latched=True, depth=1)
    try:
        served.far.publish(out, mine)
        until(lambda: served.store.get(MAP, "taken"), "the map is in the store", 20)
        until(lambda: served.store.current_map() == "taken", "the map is current", 20)
        served.far.until_unpublished("/map")
        stored = served.store.get(MAP, "taken")
        assert stored is not None
        assert np.array_equal(stored.occupancy, theirs.occupancy)
        until(
            lambda: "published by /far" in str((served.status("map2d_server") or {}).get("text")),
            "the status names the publisher",
            20,
        )
        # painted cells are kept when the mapper publishes again
        stored.flags[0, 0] = MapFlag.KEEP_OUT
        served.store.put(MAP, "taken", stored)
        theirs.occupancy[5, 5] = 100 - theirs.occupancy[5, 5] % 101
        served.far.publish(out, mine | {"data": data(theirs)})

        def updated() -> bool:
            now = served.store.get(MAP, "taken")
            return now is not None and bool(now.occupancy[5, 5] == theirs.occupancy[5, 5])

        until(updated, "the next map is imported", 20)
        now = served.store.get(MAP, "taken")
        assert now is not None
        assert now.flags[0, 0] == MapFlag.KEEP_OUT
    finally:
        served.far.drop(out)
    served.far.until_published("/map")


@contextmanager
def twin_of(served: Served) -> Iterator[Callable[[], None]]:
    """Run another Map2DServer; yield a function that publishes its map, and returns when the module has received it."""
    with Hub.open(replace(served.hubs.settings("far"), node="map2d_server")) as hub:
        twin = HubSide(hub, served.far.registry)
        current = twin.subscribe("/map", GRID, latched=True, depth=1)
        twin.wait(current, 1, 20)
        out = twin.advertise("/map", GRID, latched=True, depth=1)
        theirs = six_flags("theirs", seed=3)

        def publish() -> None:
            counters = intake(served)._end.counters
            before = counters.messages
            twin.publish(out, {"header": {"frame_id": "map"}, "info": message_info(theirs), "data": data(theirs)})
            until(lambda: counters.messages > before, "the message is received", 20)

        yield publish


@pytest.fixture
def other(served: Served) -> Served:
    """Make ``other`` the current map."""
    served.store.put(MAP, "other", six_flags("other"))
    served.store.use_map("other")
    served.far.until_published("/map")
    return served


def check_not_imported(served: Served) -> None:
    def handled() -> bool:
        return bool(served.worker.running("map2d_server").host.loop.call(settled, 20))

    def settled() -> bool:
        return not intake(served)._unknown and not intake(served)._due

    until(handled, "the messages are handled", 20)
    assert served.store.get(MAP, "taken") is None
    assert served.store.current_map() == "other"


def test_a_map_of_another_map2d_server_is_not_imported(other: Served) -> None:
    with twin_of(other) as publish:
        publish()
        publish()
        other.far.until_published("/map", 2)
        check_not_imported(other)


def test_the_map_of_a_map2d_server_that_leaves_at_once_is_not_imported(other: Served) -> None:
    with twin_of(other) as publish:
        publish()
    until(lambda: len(other.far.publishers("/map")) == 1, "the other server has left", 20)
    check_not_imported(other)


def test_a_map_waits_until_the_graph_shows_its_publisher(other: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    graph = intake(other)._host.node.hub.graph
    tokens: list[str] = []
    put_token = graph._put_token
    monkeypatch.setattr(graph, "_put_token", lambda key: bool(tokens.append(key)))
    with twin_of(other) as publish:
        publish()
        with pytest.raises(AssertionError, match="not within"):
            until(lambda: other.store.get(MAP, "taken"), "the map is in the store", 0.6)
        monkeypatch.undo()
        for key in tokens:
            graph._notify(put_token(key))
        check_not_imported(other)


def intake(served: Served) -> Any:
    module: Any = served.worker.running("map2d_server").module
    return module._intakes[0]


def message_info(grid: MapGrid2D) -> dict[str, Any]:
    x, y, _ = grid.getOrigin()
    return {"resolution": grid.resolution, "width": grid.width(), "height": grid.height(),
            "origin": {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}}  # fmt: skip


def data(grid: MapGrid2D) -> list[int]:
    return [int(value) if value <= 100 else -1 for value in grid.occupancy[::-1].reshape(-1)]
