"""The planner's view of the store's maps, areas and links."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from bridge.stores.kinds import AREA, BEHAVIOR, LINK, LOCATION, MAP
from bridge.stores.replica import Replica
from bridge.stores.store import Store
from navigation.goals import MapPlace
from navigation.pose import Pose
from navigation.robot_path_planner.atlas import StoreAtlas, leg
from navigation.status import Fault, PlanError
from tests.navigation.robot_path_planner.test_path import area
from tests.peers.navigation.floors import SETTINGS, floor
from yarp_compat.dev.extras import AreaBehavior, MapLink
from yarp_compat.dev.locations import Map2DLocation


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    """Two floors."""
    store = Store(Replica(tmp_path / "store.sqlite", "one"))
    for name in ("floor", "up"):
        store.put(MAP, name, floor(name=name))
    yield store
    store.replica.close()


def test_a_new_link_leads_to_another_map_immediately(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    atlas = StoreAtlas(store, SETTINGS)
    ground = atlas.ground("floor")
    assert ground is not None
    assert not atlas.links()
    store.put(LINK, "lift", MapLink("lift 0", "lift 1", 2.0))
    store.put(LOCATION, "lift 0", Map2DLocation("floor", 4.0, 4.0, 90.0))
    assert not atlas.links()
    assert "link lift: location lift 1 not found" in caplog.text
    store.put(LOCATION, "lift 1", Map2DLocation("up", 1.0, 4.0, 0.0))
    (link,) = atlas.links()
    assert (link.name, link.cost, link.first.pose.theta) == ("lift", 2.0, pytest.approx(1.5708, abs=1e-4))
    part = leg(atlas, ground, Pose(1.0, 1.0, 0.0), MapPlace("up", Pose(2.0, 2.0, 0.0)))
    assert (part.end, part.onto) == (link.first, link.second)


def test_new_keep_out_areas_apply_once_the_cache_is_cleared(store: Store) -> None:
    atlas = StoreAtlas(store, SETTINGS)
    before = atlas.ground("floor")
    assert before is not None
    assert atlas.ground("floor") is before
    store.put(AREA, "lab", area(1.0, 1.0, 2.0, 2.0))
    store.put(BEHAVIOR, "lab", AreaBehavior(keep_out=True))
    atlas.clear()
    ground, other = atlas.ground("floor"), atlas.ground("up")
    assert ground is not None
    assert other is not None
    cell = ground.cell(1.5, 1.5)
    assert cell is not None
    assert ground.kept[cell]
    assert not before.kept[cell]
    assert not other.kept.any()
    assert atlas.ground("roof") is None


def test_robots_keep_out_of_a_map_with_an_area_that_cannot_be_read(
    store: Store, caplog: pytest.LogCaptureFixture
) -> None:
    store.put(LOCATION, "lift 0", Map2DLocation("floor", 4.0, 4.0, 90.0))
    store.put(LOCATION, "lift 1", Map2DLocation("up", 1.0, 4.0, 0.0))
    store.put(LINK, "lift", MapLink("lift 0", "lift 1", 2.0))
    store.replica.write({(AREA.name, "lab"): (b'{"map": "up", "points": [7]}', AREA.encoding)})
    atlas = StoreAtlas(store, SETTINGS)
    ground, up = atlas.ground("floor"), atlas.ground("up")
    assert ground is not None
    assert up is not None
    here, there = Pose(1.0, 1.0, 0.0), Pose(2.0, 2.0, 0.0)
    assert leg(atlas, ground, here, MapPlace("floor", there)).end.pose == there
    for start, goal in ((ground, "up"), (up, "up"), (up, "floor")):
        with pytest.raises(PlanError, match=r"keep out of the map 'up', .*remove --kind area lab") as refused:
            leg(atlas, start, here, MapPlace(goal, there))
        assert refused.value.fault is Fault.NO_MAP
    assert "area 'lab'" in caplog.text


def test_an_area_whose_description_cannot_be_read_is_a_keep_out_area(store: Store) -> None:
    store.put(AREA, "lab", replace(area(1.0, 1.0, 2.0, 2.0), description="max_speed=slowly"))
    ground = StoreAtlas(store, SETTINGS).ground("floor")
    assert ground is not None
    cell = ground.cell(1.5, 1.5)
    assert cell is not None
    assert ground.kept[cell]
