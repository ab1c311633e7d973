"""A single store: values of every kind, names, limits, notifications of changes."""

from __future__ import annotations

import contextlib
import json
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.stores.entry import StoreError
from bridge.stores.kinds import (
    AREA,
    BEHAVIOR,
    CURRENT,
    KINDS,
    LINK,
    LOCATION,
    MAP,
    MAP3D,
    OBJECT,
    PATH,
    ValueKind,
)
from bridge.stores.replica import Change, Replica, StoreLimits
from bridge.stores.store import Store, Write
from bridge.stores.table import EntryTable
from tests.stores.conftest import Make
from tests.support.wait import until
from yarp_compat.dev.extras import AreaBehavior, MapLink
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.octomap import Octomap
from yarp_compat.octree import OcTree
from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType
from yarp_compat.sig.vec2d import Vec2D

KITCHEN = Map2DLocation("m1", 1.0, 2.5, 90.0, 'the "kitchen", große')
CORNERS = [Vec2D(0.0, 0.0), Vec2D(1.0, 0.0), Vec2D(1.0, 2.0)]


def grid(name: str = "m1", seed: int = 1, shape: tuple[int, int] = (30, 20)) -> MapGrid2D:
    """Return a map of random cells."""
    random = np.random.default_rng(seed)
    occupancy = random.choice(np.array([*range(101), 255], np.uint8), shape)
    flags = random.integers(0, 6, shape, dtype=np.uint8)
    return MapGrid2D.of(flags, occupancy, name=name, resolution=0.05, origin=(-1.5, 2.0, 30.0))


VALUES: list[tuple[ValueKind[Any], Any]] = [
    (MAP, grid()),
    (MAP3D, Octomap.of(OcTree.of([[32_768, 7, 9]], [1.5], [14], resolution=0.05))),
    (MAP3D, Octomap.of(OcTree.of([[32_768, 7, 9]], [1.5], [14], resolution=0.05), binary=True)),
    (MAP3D, PointCloud.of(np.ones((2, 3), LAYOUTS[PointType.XYZ_I]))),
    (LOCATION, KITCHEN),
    (AREA, Map2DArea("m1", CORNERS, "hall")),
    (BEHAVIOR, AreaBehavior(max_speed=0.2, on_obstacle="wait")),
    (BEHAVIOR, AreaBehavior(keep_out=True)),
    (PATH, Map2DPath([KITCHEN, Map2DLocation("m1", 3.0, 4.0, -45.0)], "round")),
    (OBJECT, Map2DObject("m1", 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, "cup")),
    (LINK, MapLink("lift_0", "lift_1", 12.0)),
    (CURRENT, "m1"),
]


@pytest.mark.parametrize(("kind", "value"), VALUES, ids=lambda value_: getattr(value_, "name", type(value_).__name__))
def test_every_kind_is_read_back(make: Make, kind: ValueKind[Any], value: Any) -> None:
    store = make()
    store.put(kind, "m1", value)
    assert store.get(kind, "m1") == value
    store.replica.close()
    assert make().all(kind) == {"m1": value}


def test_all_kinds_are_tested() -> None:
    assert {kind.name for kind, _ in VALUES} == KINDS.keys()


def test_names_are_listed_by_kind(store: Store) -> None:
    for name in ("b", "a", "c d"):
        store.put(LOCATION, name, KITCHEN)
    store.put(AREA, "z", Map2DArea("m1", CORNERS))
    assert store.names(LOCATION) == ["a", "b", "c d"]
    assert store.delete(LOCATION, "b")
    assert not store.delete(LOCATION, "b")
    assert not store.delete(LOCATION, "never")
    assert store.names(LOCATION) == ["a", "c d"]
    assert store.get(LOCATION, "b") is None
    assert store.clear(LOCATION) == 2
    assert store.names(LOCATION) == []
    assert store.names(AREA) == ["z"]
    assert store.replica.status().deleted == 3


def test_a_failed_rename_changes_nothing(store: Store) -> None:
    area = Map2DArea("m1", CORNERS)
    behavior = AreaBehavior(max_speed=0.5)
    store.write([Write(AREA, "a", area), Write(BEHAVIOR, "a", behavior), Write(AREA, "b", area)])
    with pytest.raises(StoreError, match="area 'b' exists already"):
        store.rename(AREA, "a", "b")
    with pytest.raises(StoreError, match="no area 'c'"):
        store.rename(AREA, "c", "d")
    with pytest.raises(StoreError, match="name"):
        store.rename(AREA, "a", "a/b")
    assert store.names(AREA) == ["a", "b"]
    store.rename(AREA, "a", "c")
    assert store.names(AREA) == ["b", "c"]
    assert store.all(BEHAVIOR) == {"c": behavior}
    store.delete(AREA, "c")
    assert store.all(BEHAVIOR) == {}


def test_an_areas_behavior_is_stored_separately_or_in_its_description(store: Store) -> None:
    store.put(AREA, "a", Map2DArea("m1", CORNERS, "ramp, max_speed=0.2 on_obstacle=wait"))
    assert store.behavior("a") == AreaBehavior(max_speed=0.2, on_obstacle="wait")
    store.put(BEHAVIOR, "a", AreaBehavior(keep_out=True))
    assert store.behavior("a") == AreaBehavior(keep_out=True)
    store.put(AREA, "a", Map2DArea("m1", CORNERS, "stored again by a YARP client"))
    assert store.behavior("a") == AreaBehavior(keep_out=True)
    assert store.behavior("nowhere") == AreaBehavior()


def spoil(store: Store, kind: ValueKind[Any], name: str, body: bytes) -> None:
    """Put an invalid value into the store, as another release of Midspan or a damaged file may do."""
    store.replica.write({(kind.name, name): (body, kind.encoding)})


def test_a_maps_areas_are_returned_with_their_behaviors(store: Store) -> None:
    slow, shut = Map2DArea("m1", CORNERS, "max_speed=0.2"), Map2DArea("m1", CORNERS)
    store.put(AREA, "slow", slow)
    store.put(AREA, "shut", shut)
    store.put(BEHAVIOR, "shut", AreaBehavior(keep_out=True))
    store.put(AREA, "elsewhere", Map2DArea("m2", CORNERS, "keep_out"))
    areas = store.areas("m1")
    assert areas.named == {"slow": (slow, AreaBehavior(0.2)), "shut": (shut, AreaBehavior(keep_out=True))}
    assert areas.keep_out == [shut]
    assert (areas.closed, areas.warnings) == ("", ())


@pytest.mark.parametrize("where", ["description", "behavior"])
def test_an_area_whose_behavior_cannot_be_read_is_a_keep_out_area(store: Store, where: str) -> None:
    area = Map2DArea("m1", CORNERS, "max_speed=fast" if where == "description" else "")
    store.put(AREA, "the lab", area)
    if where == "behavior":
        spoil(store, BEHAVIOR, "the lab", b'{"keep_out": "yes"}')
    areas = store.areas("m1")
    assert areas.keep_out == [area]
    assert not areas.closed
    (warning,) = areas.warnings
    for part in ("keep out of the area 'the lab'", "remove --kind area 'the lab'", str(store.replica.file)):
        assert part in warning
    assert store.areas("m2").warnings == ()
    store.put(BEHAVIOR, "the lab", AreaBehavior())
    assert store.areas("m1").keep_out == []


@pytest.mark.parametrize(
    ("body", "closed"),
    [
        (b'{"map": "m1", "points": [[0, 0], ["a", 1]]}', {"m1"}),
        (b'{"map": "m2", "points": 3}', {"m2"}),
        (b'{"map": 3, "points": []}', {"m1", "m2"}),
        (b"{", {"m1", "m2"}),
    ],
)
def test_robots_keep_out_of_a_map_if_an_area_on_it_cannot_be_read(store: Store, body: bytes, closed: set[str]) -> None:
    good = Map2DArea("m1", CORNERS)
    store.put(AREA, "good", good)
    spoil(store, AREA, "the lab", body)
    assert {name for name in ("m1", "m2") if store.areas(name).closed} == closed
    areas = store.areas(min(closed))
    for part in (f"map '{min(closed)}'", "area 'the lab'", "remove --kind area 'the lab'", str(store.replica.file)):
        assert part in areas.closed
    assert list(store.areas("m1").named) == ["good"]
    store.delete(AREA, "the lab")
    assert not store.areas(min(closed)).closed


def test_the_current_map_must_exist(store: Store) -> None:
    assert store.current_map() == ""
    with pytest.raises(StoreError, match="no map 'm1'; existing maps: none"):
        store.use_map("m1")
    store.put(MAP, "m1", grid())
    store.use_map("m1")
    assert store.current_map() == "m1"


def test_a_map_is_read_with_its_name_in_the_store(store: Store) -> None:
    store.put(MAP, "other", grid("m1"))
    stored_map = store.get(MAP, "other")
    assert stored_map is not None
    assert stored_map.name == "other"
    assert np.array_equal(stored_map.flags, grid().flags)


@pytest.mark.parametrize(
    "name",
    ["", "a/b", "../a", "..", ".", ".hidden", "a\\b", "a*", "a$", "a?b", "a#b", "a%2Fb", "@a", "a\nb", "a\0", " a",
     "a" * 255, "ü" * 128, "\ud800"],
)  # fmt: skip
def test_an_invalid_name_is_refused(store: Store, name: str) -> None:
    with pytest.raises(StoreError, match="name"):
        store.put(LOCATION, name, KITCHEN)
    assert store.names(LOCATION) == []


def test_valid_names_are_accepted(store: Store) -> None:
    for name in ("a", "the kitchen", "küche", "1st-floor_(b)", "a" * 254, "台所", "a.b"):
        store.put(LOCATION, name, KITCHEN)
    assert len(store.names(LOCATION)) == 7


def test_one_invalid_write_of_several_cancels_all(store: Store) -> None:
    with pytest.raises(StoreError, match="cannot be represented in JSON"):
        store.write([Write(LOCATION, "a", KITCHEN), Write(LOCATION, "b", Map2DLocation("m1", float("nan")))])
    with pytest.raises(StoreError, match="a cell with the invalid value 6"):
        store.put(MAP, "m", MapGrid2D.of(np.full((2, 2), 6, np.uint8)))
    assert store.replica.versions() == {}


HEAD = {"midspan": "map", "version": 1, "width": 30, "height": 20, "resolution": 0.05, "origin": [0, 0, 0]}


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        (LOCATION, b"[1]"),
        (LOCATION, b"{"),
        (LOCATION, b"[" * 100_000),
        (LOCATION, b'{"map": 1}'),
        (LOCATION, b'{"x": "1"}'),
        (LOCATION, b'{"x": true}'),
        (LOCATION, b'{"x": NaN}'),
        (LOCATION, b'{"x": 1e999}'),
        (LOCATION, b'{"x": ' + b"9" * 400 + b"}"),
        (LOCATION, b'{"description": "' + b"a" * (1 << 20) + b'"}'),
        (AREA, b'{"points": [[1]]}'),
        (AREA, b'{"points": {}}'),
        (AREA, b'{"points": [' + b"[0,0]," * 10_000 + b"[0,0]]}"),
        (PATH, b'{"waypoints": [1]}'),
        (BEHAVIOR, b'{"max_speed": 0}'),
        (BEHAVIOR, b'{"keep_out": "yes"}'),
        (BEHAVIOR, b'{"on_obstacle": "jump"}'),
        (LINK, b'{"from": "a", "to": "a"}'),
        (LINK, b'{"from": "a", "to": "b", "cost": -1}'),
        (CURRENT, b'{"map": null}'),
        (MAP, b"P5 1000000000 1 255\n"),
        (MAP, b"\n"),
        (MAP, b"a" * 10_000),
        (MAP, json.dumps({**HEAD, "width": 10**9, "occupancy": 0, "flags": 0}).encode() + b"\n"),
        (MAP, json.dumps({**HEAD, "width": 0, "occupancy": 0, "flags": 0}).encode() + b"\n"),
        (MAP, json.dumps({**HEAD, "width": -1, "height": -1, "occupancy": 0, "flags": 0}).encode() + b"\n"),
        (MAP, json.dumps({**HEAD, "occupancy": 10**9, "flags": 0}).encode() + b"\n"),
        (MAP, json.dumps({**HEAD, "occupancy": 1, "flags": 1}).encode() + b"\nxx"),
        (MAP, json.dumps({**HEAD, "version": 2}).encode() + b"\n"),
        (MAP3D, b""),
        (MAP3D, b"# Octomap OcTree binary file\nid OcTree\nsize 2\nres 0.1\ndata\n\x03\x00"),
        (MAP3D, b"# Octomap OcTree file\nid OcTree\nsize 18\nres 0.1\ndata\n" + b"\0\0\0\0\1" * 17 + bytes(5)),
        (MAP3D, b"ply\nformat ascii 1.0\nelement vertex 100000000\nproperty float x\nend_header\n"),
    ],
)
def test_an_invalid_body_is_refused(kind: ValueKind[Any], body: bytes) -> None:
    with pytest.raises(StoreError, match=f"{kind.name} 'a'"):
        kind.decode("a", body)


def test_a_map_with_more_cells_than_stated_is_refused() -> None:
    small, large = MAP.encode("a", grid(shape=(2, 2)))[0], MAP.encode("a", MapGrid2D.of(np.zeros((4000, 4000))))[0]
    head = json.loads(large.partition(b"\n")[0])
    head.update(width=2, height=2)
    assert MAP.decode("a", small).width() == 2
    with pytest.raises(StoreError, match="does not have the 4 cells"):
        MAP.decode("a", json.dumps(head).encode() + b"\n" + large.partition(b"\n")[2])


def test_changes_are_reported_in_order(store: Store) -> None:
    changes: list[Change] = []
    areas: list[Change] = []
    close = store.watch(changes.append)
    store.watch(areas.append, AREA)
    store.put(LOCATION, "a", KITCHEN)
    store.put(AREA, "z", Map2DArea("m1", CORNERS))
    store.delete(LOCATION, "a")
    until(lambda: len(changes) == 3, "all changes are reported")
    assert changes == [
        Change("location", "a", deleted=False, origin="one", here=True),
        Change("area", "z", deleted=False, origin="one", here=True),
        Change("location", "a", deleted=True, origin="one", here=True),
    ]
    assert areas == changes[1:2]
    close()
    store.put(AREA, "y", Map2DArea("m1", CORNERS))
    until(lambda: len(areas) == 2, "the other watch still reports")
    assert len(changes) == 3


def test_a_full_store_refuses_values_and_keeps_working(make: Make) -> None:
    store = make(limits=StoreLimits(keys=2, size=10_000))
    store.put(LOCATION, "a", KITCHEN)
    store.put(LOCATION, "b", KITCHEN)
    with pytest.raises(StoreError, match="the limit is 2"):
        store.put(LOCATION, "c", KITCHEN)
    store.put(LOCATION, "b", Map2DLocation("m2"))
    store.delete(LOCATION, "a")
    with pytest.raises(StoreError, match=r"store\.megabytes"):
        store.put(MAP, "c", grid(shape=(100, 200)))
    store.put(LOCATION, "c", KITCHEN)
    assert store.names(LOCATION) == ["b", "c"]


def test_the_number_of_tombstones_is_limited(make: Make) -> None:
    store = make(limits=StoreLimits(deleted=3))
    for number in range(6):
        store.put(LOCATION, str(number), KITCHEN)
        store.delete(LOCATION, str(number))
    assert sorted(name for _, name in store.replica.versions()) == ["3", "4", "5"]
    store.replica.close()
    assert sorted(name for _, name in make().replica.versions()) == ["3", "4", "5"]


def test_a_second_replica_cannot_open_the_file(make: Make, tmp_path: Path) -> None:
    make()
    with pytest.raises(StoreError, match="in use by another process"):
        Replica(tmp_path / "one.sqlite", "two")


def test_an_invalid_file_is_reported(tmp_path: Path) -> None:
    file = tmp_path / "s.sqlite"
    file.write_bytes(b"a" * 5000)
    with pytest.raises(StoreError, match="move it away"):
        Replica(file, "one")
    file.unlink()
    with sqlite3.connect(file) as base:
        base.execute("PRAGMA user_version = 9")
    base.close()
    with pytest.raises(StoreError, match="newer Midspan"):
        Replica(file, "one")


def test_a_closed_store_raises(store: Store) -> None:
    store.replica.close()
    with pytest.raises(StoreError, match="closed"):
        store.get(LOCATION, "a")
    with pytest.raises(StoreError, match="closed"):
        store.put(LOCATION, "a", KITCHEN)


def test_acknowledged_changes_are_synced_to_the_disk(tmp_path: Path) -> None:
    file = tmp_path / "s.sqlite"
    with contextlib.closing(EntryTable(file)) as table:
        assert table._base.execute("PRAGMA synchronous").fetchone() == (2,)  # FULL
    with contextlib.closing(sqlite3.connect(file)) as base:
        assert base.execute("PRAGMA journal_mode").fetchone() == ("wal",)
