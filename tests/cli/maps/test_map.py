"""``midspan map`` and ``midspan location`` with a store on the hub."""

from __future__ import annotations

import json
import re
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from bridge.cli.maps import location
from bridge.display import drawing
from bridge.display.drawing import AREA_COLOR, draw
from bridge.messages.registry import Registry
from bridge.stores.kinds import AREA, BEHAVIOR, LINK, LOCATION, MAP, MAP3D, PATH
from bridge.stores.store import Store
from bridge.tf.stamped import TF, TF_TYPE, Stamped, write
from tests.cli.conftest import Midspan
from tests.cli.test_docs import examples
from tests.peers.daemon.workers import EngineWorker
from tests.peers.hub.network import HubNetwork
from tests.stores.parts import Shared
from tests.support.missing import OCTOMAP, needs
from tests.yarp_compat.test_octree import a_tree
from yarp_compat.dev.docks import Dock, dock_of
from yarp_compat.dev.extras import AreaBehavior, MapLink
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.dev.places import Places
from yarp_compat.octomap import Octomap
from yarp_compat.octree import OcTree
from yarp_compat.sig.cloudfile import load_cloud
from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType
from yarp_compat.sig.vec2d import Vec2D

AREA_EXAMPLE = Map2DArea("house", [Vec2D(1.0, 1.0), Vec2D(2.0, 1.0), Vec2D(2.0, 2.0)], "zone")


def house(origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> MapGrid2D:
    """A map of walls around a room of 4 by 3 meters."""
    flags = np.full((30, 40), MapFlag.FREE, np.uint8)
    flags[[0, -1], :] = flags[:, [0, -1]] = MapFlag.WALL
    return MapGrid2D.of(flags, name="house", resolution=0.1, origin=origin)


@pytest.fixture
def store(network: HubNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
    """A daemon's store; the commands run in a folder that has the files of a map."""
    monkeypatch.chdir(tmp_path)
    house().save("house.yaml")
    with Shared(tmp_path, "robot1", network.endpoint, domain=network.domain) as shared:
        yield shared.store


@pytest.fixture
def moving(network: HubNetwork, registry: Registry, closing: list[Any]) -> Iterator[EngineWorker]:
    """A side that publishes the pose of the base."""
    worker = EngineWorker(network, registry)
    closing.append(worker)
    stop = threading.Event()
    writer = worker.advertise(TF, TF_TYPE)

    def publish() -> None:
        while not stop.wait(0.05):
            at = time.time_ns()
            half = np.sqrt(0.5)
            transforms = [
                Stamped("map", "odom", at, (1.0, 0.0, 0.0), (0.0, 0.0, half, half)),
                Stamped("odom", "base_link", at, (0.5, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
            ]
            worker.side.write(writer, write(transforms))

    thread = threading.Thread(target=publish)
    thread.start()
    yield worker
    stop.set()
    thread.join()


@pytest.mark.usefixtures("moving")
def test_the_examples_work(midspan: Midspan, store: Store) -> None:
    ran = [command for command in examples("operate/cli.md") if command[0] in ("map", "location")]
    assert len(ran) > 12
    for command in ran:
        done = midspan(*command)
        assert done.code == 0, (command, done)
        assert done.out, command
    grid = store.get(MAP, "house")
    assert grid is not None
    assert {MapFlag.KEEP_OUT, MapFlag.WALL, MapFlag.ENLARGED_OBSTACLE} <= set(map(MapFlag, np.unique(grid.flags)))
    assert store.current_map() == "house"
    assert store.names(LOCATION) == ["charger"]
    dock = store.get(LOCATION, "charger")
    assert dock is not None
    assert dock_of(dock) == Dock()
    assert (dock.map_id, round(dock.x, 6), round(dock.y, 6), round(dock.theta, 6)) == ("house", 1.0, 0.5, 90.0)
    assert MapGrid2D.load("house.map") == grid
    with Image.open("house.png") as picture:
        assert picture.size == (16 * 40, 16 * 30)
    assert set(Places.load("locations.ini").locations) == {"charger", "kitchen"}
    features = json.loads(Path("house.geojson").read_text(encoding="utf-8"))["features"]
    names = {feature["properties"]["name"] for feature in features}
    assert names == {"charger", "kitchen"}


@needs(OCTOMAP)
def test_3d_maps_are_imported_and_exported(midspan: Midspan, store: Store) -> None:
    """Midspan imports files that OctoMap's own program wrote, and that program reads the files that Midspan exports."""
    Octomap.of(a_tree(2).pruned()).save("ours.ot")
    subprocess.run(["convert_octree", "ours.ot", "house.bt"], check=True, capture_output=True, timeout=60)
    assert midspan("map", "import", "house.bt").out == "map3d house\n"
    assert midspan("map", "import", "house.bt").err
    assert midspan("map", "export", "again.bt", "house").code == 0
    assert Path("again.bt").read_bytes() == Path("house.bt").read_bytes()
    assert midspan("map", "export", "house.ot").code == 0
    subprocess.run(["convert_octree", "house.ot", "theirs.bt"], check=True, capture_output=True, timeout=60)
    assert Path("theirs.bt").read_bytes() == Path("house.bt").read_bytes()
    shown = midspan("map", "show", "--3d", "house").out
    occupied = int(Octomap.load("house.bt").voxels().occupied.sum())
    assert f"{occupied} occupied (free or occupied), cells of 0.1 m; -1.2" in shown
    assert shown in midspan("map", "list").out
    for file in ("house.ply", "house.pcd"):
        assert midspan("map", "export", file).code == 0
        assert load_cloud(file).size() == occupied
    assert midspan("map", "import", "house.pcd", "--name", "cloud").code == 0
    assert store.names(MAP3D) == ["cloud", "house"]
    assert "name one of the 2 3D maps: cloud, house" in midspan("map", "export", "x.bt").err
    assert midspan("map", "export", "cloud.ot", "cloud", "--resolution", "0.1").code == 0
    assert midspan("map", "delete", "house", "--3d").out == "house is deleted\n"
    assert "no map3d 'house' is stored; those that are: cloud" in midspan("map", "delete", "house", "--3d").err
    listed = json.loads(midspan("map", "list", "--json").out)
    assert [(stored_map["name"], stored_map["form"], stored_map["points"]) for stored_map in listed] == [
        ("cloud", "cloud", occupied)
    ]


def test_a_slice_of_an_octomap_is_drawn_as_a_grid(midspan: Midspan, store: Store) -> None:
    """A wall in a pruned leaf 2 cells wide, one occupied cell, a free row, and a gap of unknown cells."""
    assert "no 3D map is stored; 'midspan map import" in midspan("map", "show", "--layer", "0.3").err
    cells = [[32_768, 32_768, 32_770], [32_774, 32_769, 32_771], [32_768, 32_771, 32_771], [32_769, 32_771, 32_771]]
    tree = OcTree.of(cells, [1.0, 1.0, -1.0, -1.0], [15, 16, 16, 16], resolution=0.1)
    store.put(MAP3D, "room", Octomap.of(tree))
    store.put(LOCATION, "dock", Map2DLocation("room", 0.35, 0.15, 0.0))
    drawn = midspan("map", "show", "room", "--layer", "0.3").out.splitlines()
    assert drawn == ["  ?????", "##?→a?#", "' ' free, '#' wall, '?' unknown", "a dock: 0.35, 0.15 m, 0 degrees"]
    assert midspan("map", "show", "--3d", "--layer", "0.25").out.splitlines()[0] == "##"
    assert midspan("map", "show", "room", "--layer", "0.3", "--png", "room.png", "--scale", "1").code == 0
    with Image.open("room.png") as picture:
        assert picture.size == (7, 4)
    store.put(MAP3D, "points", PointCloud.of(np.ones(3, LAYOUTS[PointType.XYZ])))
    for arguments, message in (
        (["room", "--layer", "9"], "'room' has no data at 9 m; its heights in meters: 0.2 to 0.4"),
        (["room", "--layer", "nan"], "--layer is a height in meters, not nan"),
        (["points", "--layer", "1"], "'points' is a cloud, which has no free space"),
        (["attic", "--layer", "1"], "no map3d 'attic' is stored; those that are: points, room"),
        (["--layer", "1"], "name one of the 2 3D maps: points, room"),
    ):
        assert message in midspan("map", "show", *arguments).err


def test_the_error_of_an_invalid_3d_map_names_file_and_field(midspan: Midspan, store: Store) -> None:
    Path("bad.bt").write_bytes(Octomap.of(a_tree(1), binary=True).bt()[:-1])
    error = midspan("map", "import", "bad.bt").err
    assert "bad.bt: data: incomplete after" in error
    assert not store.names(MAP3D)


def test_all_kinds_are_listed_and_removed(midspan: Midspan, store: Store) -> None:
    store.put(LOCATION, "a", Map2DLocation("house", 1.0, 2.0, 45.0))
    store.put(LOCATION, "b", Map2DLocation("attic", 1.0, 2.0, 45.0))
    store.put(AREA, "zone", AREA_EXAMPLE)
    store.put(BEHAVIOR, "zone", AreaBehavior(max_speed=0.2, on_obstacle="wait", keep_out=True))
    store.put(PATH, "round", Map2DPath([Map2DLocation("house"), Map2DLocation("attic")]))
    store.put(LINK, "lift", MapLink("a", "b", 12.0))
    rows = midspan("location", "list", "--json").json()
    assert [(row["kind"], row["name"], row["maps"]) for row in rows] == [
        ("location", "a", ["house"]),
        ("location", "b", ["attic"]),
        ("area", "zone", ["house"]),
        ("path", "round", ["attic", "house"]),
        ("link", "lift", ["house", "attic"]),
    ]
    assert rows[2]["behaviour"] == {"max_speed": 0.2, "on_obstacle": "wait", "keep_out": True}
    text = midspan("location", "list").out
    assert re.search(r"area +zone +house +3 corners +up to 0.2 m/s, obstacle: wait, keep out +zone", text)
    assert re.search(r"link +lift +house, attic +a to b, cost 12", text)
    assert [row["name"] for row in midspan("location", "list", "--json", "--map", "attic").json()] == [
        "b",
        "round",
        "lift",
    ]
    assert midspan("location", "list", "--map", "cellar").out.startswith("no entry is stored on the map cellar; ")
    assert midspan("location", "remove", "zone", "--kind", "area").code == 0
    assert midspan("location", "list", "--kind", "area").out.startswith("no area is stored; ")
    assert (store.names(AREA), store.names(BEHAVIOR)) == ([], [])
    done = midspan("location", "remove", "aa")
    assert (done.code, done.err) == (1, "midspan: no location 'aa' is stored; those that are: a\n")


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["map", "show"], "no map is in use"),
        (["map", "show", "hose"], "no map 'hose' is stored; the store has none"),
        (["map", "use", "house"], "no map 'house'"),
        (["map", "import", "nowhere.yaml"], "nowhere.yaml"),
        (["map", "import", "house.yaml", "house.yaml"], "twice in the files"),
        (["map", "import", "house.yaml", "--name", "a/b"], "has /"),
        (["map", "import", "--use", "locations.ini"], "the files have none"),
        (["map", "export", "house.txt"], "no map is in use"),
        (["map", "edit-flags"], "nothing to change"),
        (["map", "edit-flags", "--flag", "wall"], "go together"),
        (["location", "add", "a"], "or --here"),
        (["location", "add", "a", "1", "2", "--here"], "or --here"),
        (["location", "add", "a/b", "1", "2"], "has /"),
        (["location", "add", "a", "1", "2"], "no map is in use"),
        (["location", "export", "x.txt"], "use the extension .ini"),
    ],
    ids=lambda each: "_".join(each) if isinstance(each, list) else "",
)
def test_errors_are_reported(midspan: Midspan, store: Store, words: list[str], why: str) -> None:
    Path("locations.ini").write_text("Version:\n4\nLocations:\n", encoding="utf-8")
    done = midspan(*words)
    assert done.code == 1
    assert why in done.err
    assert "Traceback" not in done.err
    assert not store.replica.versions()


def test_files_are_not_overwritten_without_the_option(midspan: Midspan, store: Store) -> None:
    store.put(MAP, "house", house((1.0, 1.0, 0.0)))
    store.put(LOCATION, "a", Map2DLocation("house"))
    store.use_map("house")
    before = store.replica.versions()
    done = midspan("map", "import", "house.yaml")
    assert done.code == 1
    assert "map 'house' is already stored" in done.err
    assert midspan("location", "add", "a", "1", "1").code == 1
    assert midspan("map", "edit-flags", "--flag", "wall", "--points", "90,90", "91,90", "91,91").code == 1
    assert midspan("map", "edit-flags", "--flag", "wall", "--area", "zone").code == 1
    assert store.replica.versions() == before
    assert midspan("map", "import", "house.yaml", "--replace").code == 0
    assert store.get(MAP, "house") == house()


@pytest.mark.parametrize("equals", [False, True])
def test_negative_coordinates_are_not_read_as_options(midspan: Midspan, store: Store, *, equals: bool) -> None:
    store.put(MAP, "house", house((-3.0, -1.5, 0.0)))
    points = ["--points=-1.6,0.9"] if equals else ["--points", "-1.6,0.9"]
    assert midspan("map", "edit-flags", "house", "--flag", "keep-out", *points, "-.6,0.9", "-6e-1,-5e-1").code == 0
    grid = store.get(MAP, "house")
    assert grid is not None
    assert np.count_nonzero(grid.flags == MapFlag.KEEP_OUT) == pytest.approx(70, abs=20)
    done = midspan("location", "add", "dock", "-1.5", "-2e-1", "-90", "--map", "house")
    assert done.out == "dock: -1.500, -0.200 m, -90.0 degrees on house\n"


def test_missing_store_is_reported_with_its_cure(midspan: Midspan) -> None:
    done = midspan("map", "list")
    assert done.code == 1
    assert "store.enabled" in done.err


@pytest.mark.usefixtures("moving")
def test_unknown_robot_pose_is_not_stored(midspan: Midspan, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(location, "PATIENCE", 0.2)
    done = midspan("location", "add", "a", "--here", "--map", "house", "--base-frame", "nobody")
    assert done.code == 1
    assert "nobody" in done.err
    assert store.names(LOCATION) == []


@pytest.mark.usefixtures("moving")
def test_frames_of_the_robots_pose_are_those_of_the_configuration(
    midspan: Midspan, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(location, "PATIENCE", 0.2)
    config = yaml.safe_load(midspan.config.read_text(encoding="utf-8"))
    config["navigation"] = {"base_frame": "mobile_base"}
    midspan.config.write_text(yaml.safe_dump(config), encoding="utf-8")
    done = midspan("location", "add", "a", "--here", "--map", "house")
    assert (done.code, "mobile_base" in done.err) == (1, True), done
    assert store.names(LOCATION) == []


@pytest.mark.parametrize("theta", [0.0, 90.0])
def test_the_picture_shows_flags_locations_and_areas(theta: float) -> None:
    grid = house((0.0, 0.0, theta))
    grid.flags[5, 5] = MapFlag.KEEP_OUT
    place = grid.toLocation(Vec2D(*grid.centers_of((20, 15))))
    corners = [Vec2D(*grid.centers_of(cell)) for cell in ((25, 20), (35, 20), (35, 25))]
    image = draw(grid, {"here": place}, {"zone": Map2DArea("house", corners)}, 10)
    assert image.size == (400, 300)
    assert image.getpixel((2, 2)) == (0, 0, 0)
    assert image.getpixel((55, 55)) == (255, 0, 0)
    assert image.getpixel((300, 205)) == AREA_COLOR
    assert image.getpixel((205 + 30, 155 + 30)) == (254, 254, 254)
    pixels = np.asarray(image)[150:165, 200:215]
    assert (pixels == (0, 110, 0)).all(axis=2).any()


def test_the_terminal_shows_thin_walls_and_marks() -> None:
    grid = house()
    grid.flags[14:16, :] = MapFlag.WALL
    areas = {"zone": Map2DArea("house", [Vec2D(1.0, 0.4), Vec2D(2.0, 0.4), Vec2D(2.0, 1.2)])}
    locations = {"a": Map2DLocation("house", 1.05, 2.55, 0.0), "b\x1b[2J": Map2DLocation("house", 99.0, 99.0, 0.0)}
    plain = [line.plain for line in drawing.lines(grid, locations, areas, 20, colored=False)]
    assert plain[0] == "#" * 20
    assert plain[3] == "#" * 20
    assert plain[1].strip("# ") == "→a"
    assert "·" in plain[5]
    assert plain[-4:] == [
        "' ' free, '#' wall",
        "a a: 1.05, 2.55 m, 0 degrees",
        "b b?[2J: 99, 99 m, 0 degrees",
        "· zone: area of 3 corners",
    ]
    colored = drawing.lines(grid, locations, areas, 20, colored=True)
    assert colored[0].plain == "▀" * 20
    assert "rgb(0,0,0)" in str(colored[0].spans[0].style)
