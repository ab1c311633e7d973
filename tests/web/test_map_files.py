"""Maps that a page imports and exports, on a real hub."""

from __future__ import annotations

import base64
import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.stores.kinds import LOCATION, MAP, PATH
from bridge.stores.store import Store, Write
from bridge.web.verbs import map_files
from bridge.web.verbs.map_files import Transfers, root_files, unpacked
from bridge.web.verbs.verbs import VerbError
from tests.peers.browser.page import TestPage
from tests.web.conftest import Desk
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.dev.places import Places


def house(name: str = "house") -> MapGrid2D:
    flags = np.zeros((30, 40), np.uint8)
    flags[0], flags[5, 5] = MapFlag.WALL, MapFlag.KEEP_OUT
    return MapGrid2D.of(flags, name=name, resolution=0.05, origin=(-1.0, 2.0, 0.0))


@pytest.fixture
def store(store: Store) -> Store:
    """Return a store with a current map."""
    store.put(MAP, "house", house())
    store.use_map("house")
    return store


@pytest.fixture
def page(desk: Desk, store: Store) -> Iterator[TestPage]:
    assert store is not None
    with TestPage(desk.port) as page_:
        yield page_


def send(page: TestPage, files: dict[str, bytes], part: int = 700) -> str:
    """Upload files, and return the key of the upload."""
    key: str = page.call("upload")["value"]
    for file, data in files.items():
        for at in range(0, max(len(data), 1), part):
            text = base64.b64encode(data[at : at + part]).decode()
            reply = page.call("upload_part", key=key, file=file, at=at, data=text)
            assert reply["ok"], reply
    return key


def written(folder: Path, grid: MapGrid2D, form: str) -> dict[str, bytes]:
    folder.mkdir()
    grid.save(folder / f"{grid.name}{form}")
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def fetch(page: TestPage, name: str) -> dict[str, bytes]:
    """Return the files in a map's zip."""
    export = page.call("export_map", name=name)["value"]
    data = b""
    while len(data) < export["size"]:
        data += base64.b64decode(page.call("download_part", key=export["key"], at=len(data))["value"])
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.testzip() is None
        return {info.filename: archive.read(info) for info in archive.infolist()} | {export["file"]: data}


@pytest.mark.parametrize("form", [".map", ".yaml"])
def test_a_map_is_imported(page: TestPage, store: Store, tmp_path: Path, form: str) -> None:
    grid = house("office")
    key = send(page, written(tmp_path / "files", grid, form))
    assert page.call("import_map", key=key, use=True)["value"] == {"done": True, "maps": ["office"], "taken": []}
    kept = store.get(MAP, "office")
    assert kept is not None
    assert (kept.occupancy == grid.occupancy).all()
    assert (kept.flags == grid.flags).all() or form == ".yaml"
    assert store.current_map() == "office"
    assert "expired" in page.call("import_map", key=key)["error"]


def test_a_map_is_replaced_only_on_request(page: TestPage, store: Store, tmp_path: Path) -> None:
    other = house()
    other.flags[9, 9] = MapFlag.WALL
    key = send(page, written(tmp_path / "files", other, ".map"))
    assert page.call("import_map", key=key)["value"]["taken"] == [["map", "house"]]
    assert store.get(MAP, "house") == house()
    assert page.call("import_map", key=key, name="house 2")["value"]["maps"] == ["house 2"]
    key = send(page, written(tmp_path / "again", other, ".map"))
    assert page.call("import_map", key=key, replace=True)["value"]["done"]
    assert store.get(MAP, "house") == other


def test_an_exported_map_can_be_imported(page: TestPage, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_files, "PART", 100)
    files = fetch(page, "house")
    assert {"house/house.map", "house/house_grid.yaml", "house.zip"} <= set(files)
    store.delete(MAP, "house")
    assert page.call("import_map", key=send(page, {"house.zip": files["house.zip"]}))["value"]["done"]
    assert store.get(MAP, "house") == house()


def test_places_are_imported_with_a_map_of_another_name(page: TestPage, store: Store, tmp_path: Path) -> None:
    places = Places(
        locations={"desk": Map2DLocation("office", 1.0), "door": Map2DLocation("house", 2.0)},
        paths={"round": Map2DPath([Map2DLocation("office", 1.0), Map2DLocation("house", 2.0)])},
    )
    files = {**written(tmp_path / "files", house("office"), ".map"), "places.ini": places.to_text().encode()}
    assert page.call("import_map", key=send(page, files), name="floor")["value"]["done"]
    locations, path = store.all(LOCATION), store.get(PATH, "round")
    assert path is not None
    assert {name: place.map_id for name, place in locations.items()} == {"desk": "floor", "door": "house"}
    assert [point.map_id for point in path.waypoints] == ["floor", "house"]


def test_a_map_is_renamed_with_its_places(page: TestPage, store: Store) -> None:
    store.write([Write(LOCATION, "desk", Map2DLocation("house", 1.0))])
    page.watch("maps", "places")
    assert page.call("rename_map", name="house", to="home")["ok"]
    assert page.value("maps", lambda value: value["current"] == "home")["names"] == ["home"]
    assert page.value("places", lambda value: value["locations"]["desk"]["map"] == "home")


@pytest.mark.parametrize(
    ("files", "why"),
    [
        ({}, "no map among no files"),
        ({"notes.txt": b"x"}, "no map among notes.txt"),
        ({"a.map": b"nothing"}, "a.map: the key MapName is missing"),
        ({"a.yaml": b"image: ../../etc/passwd\nresolution: 0.1\norigin: [0, 0, 0]\n"}, "is outside of"),
        ({"a.yaml": b"image: /etc/passwd\nresolution: 0.1\norigin: [0, 0, 0]\n"}, "is outside of"),
        ({"a.yaml": b"image: a.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n"}, "a.pgm: No such file"),
        ({"a.zip": b"PK\3\4 no zip"}, "cannot unpack a.zip"),
    ],
)  # fmt: skip
def test_invalid_map_files_are_refused(page: TestPage, store: Store, files: dict[str, bytes], why: str) -> None:
    reply = page.call("import_map", key=send(page, files))
    assert why in reply["error"]
    assert store.names(MAP) == ["house"]


@pytest.mark.parametrize(
    ("args", "why"),
    [
        ({"file": "../a.map"}, "file must be a file name"),
        ({"file": ".bashrc"}, "file must be a file name"),
        ({"data": "%%%%"}, "data must be base64"),
        ({"data": "A" * 48_004}, "data must be base64 of up to 48000 characters"),
        ({"at": -1}, "at must be an integer"),
        ({"at": 7}, "the part at 7 does not follow the 0 bytes received"),
        ({"key": "guessed"}, "this transfer has expired"),
    ],
)
def test_invalid_parts_are_refused(page: TestPage, args: dict[str, Any], why: str) -> None:
    part = {"key": page.call("upload")["value"], "file": "a.map", "at": 0, "data": "QUJD"}
    assert why in page.call("upload_part", **{**part, **args})["error"]


def test_uploads_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_files, "MOST_BYTES", 10)
    monkeypatch.setattr(map_files, "MOST_FILES", 2)
    transfers = Transfers()
    key = transfers.new({})
    assert transfers.add(key, "a", 0, bytes(8)) == 8
    with pytest.raises(VerbError, match="the limits are 2 files"):
        transfers.add(key, "a", 8, bytes(3))
    assert transfers.add(key, "b", 0, b"") == 0
    with pytest.raises(VerbError, match="the limits are 2 files"):
        transfers.add(key, "c", 0, b"")
    transfers.new({})
    transfers.new({})
    with pytest.raises(VerbError, match="already in progress"):
        transfers.new({})
    monkeypatch.setattr(map_files, "IDLE_SECONDS", 0.0)
    transfers.new({})


def test_zips_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_files, "MOST_BYTES", 1000)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("../deep/a.pgm", bytes(900))
        archive.writestr("b.pgm", bytes(200))
    with pytest.raises(VerbError, match="has more than"):
        unpacked({"a.zip": bytearray(packed.getvalue())})
    monkeypatch.setattr(map_files, "MOST_BYTES", 2000)
    assert sorted(unpacked({"a.zip": bytearray(packed.getvalue())})) == ["a.pgm", "b.pgm"]


def test_files_of_the_same_name_in_a_zip_are_refused() -> None:
    def packed(second: bytes) -> dict[str, bytearray]:
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("ground/map.yaml", b"image: map.pgm")
            archive.writestr("upstairs/map.yaml", second)
        return {"a.zip": bytearray(file.getvalue())}

    with pytest.raises(VerbError, match=r"several files map\.yaml"):
        unpacked(packed(b"image: other.pgm"))
    assert unpacked(packed(b"image: map.pgm")) == {"map.yaml": b"image: map.pgm"}


def test_a_damaged_zip_is_refused() -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.map", b"text " * 100)
    data = bytearray(file.getvalue())
    data[30 + len("a.map")] = 0xFF  # the first compressed byte
    with pytest.raises(VerbError, match=r"cannot unpack a\.zip"):
        unpacked({"a.zip": data})


def test_root_files_refer_to_the_others() -> None:
    assert root_files(["a.map", "a_grid.yaml", "a.pgm"]) == ["a.map"]
    assert root_files(["a.yaml", "b.yml", "a.pgm"]) == ["a.yaml", "b.yml"]
    assert root_files(["maps_collection.ini", "a.map"]) == ["maps_collection.ini"]
    assert root_files(["locations.ini", "locations_extras.ini", "a.map"]) == ["locations.ini", "a.map"]


def test_folders_and_hidden_files_of_a_zip_are_skipped() -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for number in range(map_files.MOST_FILES + 1):
            archive.writestr(f"house/{number}/", b"")
        for name in ("house/.DS_Store", "__MACOSX/house/._house.map", "house/house.map"):
            archive.writestr(name, name)
    assert unpacked({"a.zip": bytearray(packed.getvalue())}) == {"house.map": b"house/house.map"}
