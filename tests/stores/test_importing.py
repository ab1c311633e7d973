"""Imports of files: once, at the start, with timestamps older than any written value."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from bridge.config.sections.store import StoreSection
from bridge.stores.entry import OLDEST
from bridge.stores.kinds import AREA, BEHAVIOR, LINK, LOCATION, MAP
from bridge.stores.service import import_at_start
from tests.stores.conftest import Make
from tests.stores.test_store import KITCHEN, grid
from yarp_compat.dev.extras import AreaBehavior, Extras, MapLink, extras_file
from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.dev.places import Places, save_maps
from yarp_compat.sig.vec2d import Vec2D


@pytest.fixture
def section(tmp_path: Path) -> StoreSection:
    """Return a configuration that imports a collection of two maps, and a places file with extras."""
    save_maps({name: grid(name) for name in ("m1", "m2")}, tmp_path / "maps_collection.ini")
    area = Map2DArea("m1", [Vec2D(0.0, 0.0), Vec2D(1.0, 0.0), Vec2D(1.0, 1.0)])
    file = tmp_path / "locations.ini"
    Places({"kitchen": KITCHEN, "hall": Map2DLocation("m2", 1.0)}, {}, {"zone": area}).save(file)
    Extras({"zone": AreaBehavior(max_speed=0.3)}, {"lift": MapLink("kitchen", "hall", 5.0)}).save(extras_file(file))
    return StoreSection(maps=tmp_path / "maps_collection.ini", locations=file)


def test_files_are_imported_once(make: Make, section: StoreSection) -> None:
    store = make()
    import_at_start(store, section)
    assert store.names(MAP) == ["m1", "m2"]
    assert store.get(MAP, "m2") == grid("m2")
    assert store.current_map() == "m1"
    assert store.get(LOCATION, "kitchen") == KITCHEN
    assert store.all(BEHAVIOR) == {"zone": AreaBehavior(max_speed=0.3)}
    assert store.all(LINK) == {"lift": MapLink("kitchen", "hall", 5.0)}
    store.delete(MAP, "m2")
    store.delete(LOCATION, "hall")
    store.put(LOCATION, "kitchen", Map2DLocation("m1", 9.0))
    store.put(AREA, "new", Map2DArea("m1"))
    before = store.replica.versions()
    import_at_start(store, section)
    assert store.replica.versions() == before


def test_a_value_written_while_files_are_read_is_kept(make: Make) -> None:
    replica = make().replica
    written, imported = (b"written", "text/plain"), (b"imported", "text/plain")
    key, deleted, new = (("kind", name) for name in ("written", "deleted", "new"))
    replica.write({key: written, deleted: written})
    replica.write({deleted: None})
    (entry,) = replica.write(dict.fromkeys([key, deleted, new], imported), oldest=True)
    assert (entry.key, entry.version.stamp.ns) == (new, OLDEST)
    assert [replica.get(*one) for one in (key, deleted, new)] == [written, None, imported]


def test_imports_of_a_joining_machine_change_no_written_value(make: Make, section: StoreSection) -> None:
    old, new = make("old"), make("new")
    old.put(LOCATION, "kitchen", Map2DLocation("m1", 9.0))
    old.put(MAP, "m1", grid("m1", seed=2))
    import_at_start(new, section)
    for key in old.replica.versions():
        entry = old.replica.entry(*key)
        assert entry is not None
        assert new.replica.merge(entry)
    for key in new.replica.versions():
        entry = new.replica.entry(*key)
        assert entry is not None
        old.replica.merge(entry)
    for name_ in (old, new):
        assert name_.get(LOCATION, "kitchen") == Map2DLocation("m1", 9.0)
        assert name_.get(MAP, "m1") == grid("m1", seed=2)
        assert name_.names(MAP) == ["m1", "m2"]
        assert name_.replica.status().conflicts == 0


@pytest.mark.parametrize("text", ["mapfile: nowhere.map\n", "Version:\n9\n", "nonsense\n", None])
def test_an_unreadable_file_is_reported_and_the_others_are_imported(
    make: Make, section: StoreSection, tmp_path: Path, caplog: pytest.LogCaptureFixture, text: str | None
) -> None:
    store = make()
    bad = tmp_path / "bad.ini"
    if text is not None:
        bad.write_text(text)
    with caplog.at_level(logging.ERROR):
        import_at_start(store, section.model_copy(update={"maps": bad}))
    assert "store.maps" in caplog.text
    assert "bad.ini" in caplog.text or "nowhere.map" in caplog.text
    assert store.names(MAP) == []
    assert store.names(LOCATION) == ["hall", "kitchen"]
