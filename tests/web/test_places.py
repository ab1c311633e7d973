"""The verbs for the store's places, on a real hub."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.stores.kinds import AREA, BEHAVIOR, CURRENT, LOCATION, MAP, PATH
from bridge.stores.store import Store, Write
from tests.peers.browser.page import TestPage
from tests.stores.parts import Shared
from tests.web.conftest import Desk
from yarp_compat.dev.extras import AreaBehavior
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.vec2d import Vec2D

SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
HALL = Map2DArea("house", [Vec2D(x, y) for x, y in SQUARE])


@pytest.fixture
def store(store: Store) -> Store:
    """Return a store with a current map."""
    store.write([Write(MAP, "house", MapGrid2D.of(np.zeros((4, 5)), name="house", resolution=0.1))])
    store.use_map("house")
    return store


@pytest.fixture
def page(desk: Desk, store: Store) -> Iterator[TestPage]:
    assert store is not None
    with TestPage(desk.port) as page_:
        page_.watch("places")
        page_.value("places")
        yield page_


def test_a_saved_area_is_visible_to_all(page: TestPage, store: Store) -> None:
    assert page.call("keep_area", name="hall", points=SQUARE) == {
        "op": "reply", "id": 1, "ok": True, "value": "saved hall",
    }  # fmt: skip
    assert store.get(AREA, "hall") == HALL
    assert page.value("places", lambda value: value["areas"])["areas"]["hall"] == {"map": "house", "points": SQUARE}
    again = page.call("keep_area", name="hall", points=SQUARE[:3])
    assert again["error"] == "the area 'hall' exists already"
    assert page.call("keep_area", name="hall", points=SQUARE[:3], replace=True)["ok"]
    page.value("places", lambda value: len(value["areas"]["hall"]["points"]) == 3)


def test_a_place_is_replaced_only_on_request(page: TestPage, store: Store) -> None:
    pose = {"name": "desk", "y": 0.0, "theta": 0.0}
    assert page.call("keep_place", x=1.0, **pose)["ok"]
    assert page.call("keep_place", x=2.0, **pose)["error"] == "the place 'desk' exists already"
    assert store.get(LOCATION, "desk") == Map2DLocation("house", 1.0)
    assert page.call("keep_place", x=2.0, replace=True, **pose)["ok"]
    assert store.get(LOCATION, "desk") == Map2DLocation("house", 2.0)


def test_all_kinds_are_renamed_and_deleted(page: TestPage, store: Store) -> None:
    desk, path = Map2DLocation("house", 1.0), Map2DPath([Map2DLocation("house", 1.0)])
    store.write([
        Write(LOCATION, "desk", desk), Write(AREA, "hall", HALL), Write(PATH, "way", path),
        Write(BEHAVIOR, "hall", AreaBehavior(keep_out=True)),
    ])  # fmt: skip
    assert page.call("rename_place", name="desk", to="my desk")["ok"]
    assert page.call("rename_place", name="hall", to="lobby", kind="area")["ok"]
    assert page.call("rename_place", name="way", to="round", kind="path")["ok"]
    places = page.value("places", lambda value: "round" in value["paths"])
    assert [list(places[kind]) for kind in ("locations", "areas", "paths")] == [["my desk"], ["lobby"], ["round"]]
    assert store.get(BEHAVIOR, "lobby") == AreaBehavior(keep_out=True)
    for kind, name in (("location", "my desk"), ("area", "lobby"), ("path", "round")):
        assert page.call("delete_place", name=name, kind=kind)["ok"]
    page.value("places", lambda value: value == {"locations": {}, "areas": {}, "paths": {}})
    assert store.names(BEHAVIOR) == []


@pytest.mark.parametrize(
    ("verb", "args", "why"),
    [
        ("keep_area", {"name": "a", "points": SQUARE[:2]}, "points must be 3 to 500 corners"),
        ("keep_area", {"name": "a", "points": [[0, 0]] * 501}, "points must be 3 to 500 corners"),
        ("keep_area", {"name": "a", "points": [[0, 0], [1, 1], [2]]}, "points must be corners [x, y], in meters"),
        ("keep_area", {"name": "a", "points": [[0, 0], [1, 1], [2, "2"]]}, "points must be corners [x, y], in meters"),
        ("keep_area", {"name": "a", "points": [[0, 0], [1, 1], [2, 2]]}, "not all on one line"),
        ("keep_area", {"name": "a/b", "points": SQUARE}, "the name 'a/b' has /"),
        ("keep_area", {"name": "a", "points": SQUARE, "replace": 1}, "replace must be true or false"),
        ("delete_place", {"name": "none", "kind": "area"}, "unknown area 'none'"),
        ("delete_place", {"name": "none", "kind": "map"}, "kind must be one of location, area, path"),
        ("delete_place", {"name": "none", "kind": []}, "kind must be one of location, area, path"),
        ("rename_place", {"name": "none", "to": "x"}, "no location 'none'"),
    ],
)
def test_invalid_calls_are_refused_with_a_reason(page: TestPage, verb: str, args: dict[str, Any], why: str) -> None:
    reply = page.call(verb, **args)
    assert not reply["ok"]
    assert why in reply["error"]


def test_an_area_needs_a_map(page: TestPage, store: Store) -> None:
    store.clear(CURRENT)
    assert "no current map" in page.call("keep_area", name="a", points=SQUARE)["error"]


def test_places_are_saved_after_a_restart_of_the_store(desk: Desk, tmp_path: Path) -> None:
    """Also by a program that watches no feed of the store."""
    pose = {"x": 1.0, "y": 0.0, "theta": 0.0}
    with TestPage(desk.port) as page:
        for number in range(2):
            with Shared(tmp_path, "here", desk.hubs.endpoint) as shared:
                assert page.call("keep_place", name=f"place_{number}", **pose) == {
                    "op": "reply", "id": number + 1, "ok": True, "value": f"saved place_{number}",
                }  # fmt: skip
                assert shared.store.get(LOCATION, f"place_{number}") == Map2DLocation("", 1.0)
