"""Places as goals, before and after a map is in use."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.stores.entry import StoreError
from bridge.stores.kinds import AREA, LOCATION
from navigation.gateway.targets import StoredPlaces
from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.sig.vec2d import Vec2D


def places(current: str, *, waits: bool) -> StoredPlaces:
    store = SimpleNamespace(current_map=lambda: current, names=lambda _kind: ["house", "shed"])
    return StoredPlaces(cast("Any", SimpleNamespace(store=store)), "map", lambda: waits)


@pytest.mark.parametrize(
    ("current", "waits", "frame"),
    [
        ("house", True, "map"),
        ("shed", True, "house"),
        ("", True, "house"),  # another map may come into use first, on which these coordinates are a different place
        ("", False, "map"),
    ],
)
def test_the_frame_of_a_place_depends_on_the_map_in_use(current: str, waits: bool, frame: str) -> None:
    place = Map2DLocation("house", 1.0, 2.0, 90.0)
    assert places(current, waits=waits).target(place).frame == frame


def test_a_place_on_a_map_that_is_not_stored_is_rejected_if_a_map_is_in_use() -> None:
    assert places("", waits=True).target(Map2DLocation("elsewhere", 1.0, 2.0, 0.0)).frame == "map"
    with pytest.raises(LookupError, match="is on map 'elsewhere', which is not stored; stored maps: house, shed"):
        places("house", waits=True).known(Map2DLocation("elsewhere", 1.0, 2.0, 0.0))


def test_a_named_place_on_a_map_that_is_not_stored_is_rejected() -> None:
    stored = places("house", waits=True)
    assert stored.store is not None
    cast("Any", stored.store).get = lambda kind, _name: Map2DLocation("luna", 1.0, 2.0) if kind is LOCATION else None
    with pytest.raises(LookupError, match="is on map 'luna', which is not stored; stored maps: house, shed"):
        stored.find("moon")


@pytest.mark.parametrize("reason", ["the store is disabled (store.enabled)", "store.sqlite is in use"])
def test_the_reason_why_the_store_is_unavailable_is_reported(reason: str) -> None:
    class Storeless:
        @property
        def store(self) -> None:
            raise StoreError(reason)

    with pytest.raises(LookupError) as caught:
        StoredPlaces(cast("Any", Storeless()), "map").find("kitchen")
    assert str(caught.value) == f"stored places are unavailable: {reason}"


def test_an_invalid_area_is_not_unknown() -> None:
    line = Map2DArea("house", [Vec2D(0.0, 0.0), Vec2D(1.0, 0.0)])
    values = {(AREA, "line"): line}
    store = SimpleNamespace(
        get=lambda kind, name: values.get((kind, name)),
        names=lambda kind: [name for other, name in values if other is kind],
    )
    stored = StoredPlaces(cast("Any", SimpleNamespace(store=store)), "map")
    with pytest.raises(LookupError, match="area 'line' is invalid; it must have a map and at least three points"):
        stored.find("line")
    with pytest.raises(LookupError, match="unknown location or area 'lin'; known: line"):
        stored.find("lin")
