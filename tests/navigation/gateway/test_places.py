"""Places as goals, before and after a map is in use."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from navigation.gateway.targets import StoredPlaces
from yarp_compat.dev.locations import Map2DLocation


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


def test_a_place_on_a_map_that_the_store_does_not_have() -> None:
    assert places("", waits=True).target(Map2DLocation("elsewhere", 1.0, 2.0, 0.0)).frame == "map"
