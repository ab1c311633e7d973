"""The module on its own hub: YARP clients, hub participants in place of ROS nodes, and the store."""

from __future__ import annotations

import json
import shutil
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.cli.main import main
from bridge.hub.graph.tokens import Origin
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED
from bridge.stores.kinds import AREA, BEHAVIOR, LOCATION, MAP, MAP3D
from bridge.stores.store import Write
from navigation.map2d_server.maps3d import Maps3D
from navigation.map2d_server.publishers import AllMaps, topic_of
from navigation.maps.grid import from_grid
from tests.navigation.map2d_server.served import GRID, Served, six_flags
from tests.navigation.maps.test_maps import flags_from
from tests.support.wait import until
from yarp_compat.dev.extras import AreaBehavior
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.dev.returnvalue import CallFailed
from yarp_compat.octomap import Octomap
from yarp_compat.octree import OcTree
from yarp_compat.pythonic import Client
from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType
from yarp_compat.sig.vec2d import Vec2D

INFO, MARKERS = "nav2_msgs/CostmapFilterInfo", "visualization_msgs/MarkerArray"


def test_a_map_that_cannot_be_published_does_not_keep_others_back(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("navigation.maps.grid.MAX_CELLS", 300)  # the rotated map needs more cells
    rotated = MapGrid2D.of(six_flags().flags, name="attic", resolution=0.5, origin=(0.0, 0.0, 45.0))
    office = served.latest("/maps/office", GRID)
    loop = served.worker.running("map2d_server").host.loop
    both = [Write(MAP, "attic", rotated), Write(MAP, "office", six_flags())]
    loop.call(lambda: served.store.write(both))  # on the module's thread, which then handles both at once
    until(office, "the other map is published", 20)
    reported = lambda: "aligned to yaw 0" in (served.status("map2d_server") or {})["last_refusal"]  # noqa: E731
    until(reported, "the map is reported", 20)


def test_a_yarp_clients_map_is_served_with_all_six_flags(served: Served) -> None:
    grid = six_flags()
    current, mask = served.latest("/map", GRID), served.latest("/keepout_filter_mask", GRID)
    info, all_maps = served.latest("/keepout_costmap_filter_info", INFO), served.latest("/maps/office", GRID)
    with served.client() as client, Client("/map2D_server/command", naming=served.names) as rpc:
        client.maps["office"] = grid
        until(all_maps, "the map has its own topic", 20)
        assert current() is None
        assert rpc.ask(["use", "office"], timeout=10) == ["ok"]
        until(lambda: current() and mask() and info(), "the map and its mask are published", 20)
        assert rpc.ask(["current"], timeout=10) == ["office"]
        with served.client("/mapServer/rpc") as older:
            assert older.maps["office"] == grid
    received = from_grid(current(), "office")
    values = np.asarray(mask()["data"], np.int8).reshape(12, 17)[::-1]
    assert np.array_equal(flags_from(received.occupancy, values), grid.flags)
    assert {**info(), "header": None} == {"header": None, "type": 0, "filter_mask_topic": "/keepout_filter_mask",
                                          "base": 0.0, "multiplier": 1.0}  # fmt: skip
    assert all_maps()["data"] == current()["data"]
    binary, kind = served.latest("/binary_filter_mask", GRID), served.latest("/binary_costmap_filter_info", INFO)
    until(lambda: binary() and kind(), "the binary mask is published", 20)
    inside = np.asarray(binary()["data"], np.int8).reshape(12, 17)[::-1]
    assert np.array_equal(inside == 100, grid.flags == MapFlag.KEEP_OUT)
    assert set(np.unique(inside)) == {0, 100}
    assert {**kind(), "header": None} == {
        **info(),
        "header": None,
        "type": 3,
        "filter_mask_topic": "/binary_filter_mask",
    }


def test_a_3d_map_is_published_with_its_type(served: Served) -> None:
    octomap = Octomap.of(OcTree.of([[32_768, 32_768, 32_770]], 1.5, resolution=0.05), binary=True)
    latest = served.latest("/maps3d/n1st", "octomap_msgs/Octomap")
    served.store.put(MAP3D, "1st", octomap)
    until(latest, "the octomap is published", 20)
    message = latest()
    assert (message["header"]["frame_id"], message["binary"], message["id"], message["resolution"]) == ("map", True, "OcTree", 0.05)  # fmt: skip # noqa: E501
    assert np.array(message["data"], np.int8).tobytes() == octomap.data
    for binary, data in ((True, octomap.data), (False, octomap.tree().full())):
        service = f"/maps3d/n1st/octomap_{'binary' if binary else 'full'}"
        got = served.far.call(service, "octomap_msgs/GetOctomap").result(20)["reply"]["map"]
        assert (got["header"]["frame_id"], got["binary"], got["id"], got["resolution"]) == ("map", binary, "OcTree", 0.05)  # fmt: skip # noqa: E501
        assert np.array(got["data"], np.int8).tobytes() == data
    cloud = PointCloud.of(np.ones(3, LAYOUTS[PointType.XYZ]))
    served.store.put(MAP3D, "1st", cloud)
    points = served.latest("/maps3d/n1st", "sensor_msgs/PointCloud2")
    until(points, "the cloud is published", 20)
    assert (points()["width"], points()["point_step"]) == (3, 16)
    until(
        lambda: not served.far.hub.graph.servers("/maps3d/n1st/octomap_full"),
        "the octomap service of the replaced map is gone",
        20,
    )
    served.store.delete(MAP3D, "1st")
    served.far.until_unpublished("/maps3d/n1st")


def test_each_change_is_published(served: Served) -> None:
    served.store.put(MAP, "one", six_flags("one"))
    served.store.use_map("one")
    current, other = served.latest("/map", GRID), served.latest("/maps/one", GRID)
    until(lambda: current() and other(), "the map is published", 20)
    changed = six_flags("one", seed=2)
    with served.client() as client:
        client.maps["one"] = changed
        until(lambda: np.array_equal(from_grid(current(), "").occupancy, changed.occupancy), "the change arrives", 20)
        served.far.until_published("/maps/one")
        del client.maps["one"]
        served.far.until_unpublished("/maps/one")
        served.far.until_unpublished("/map")


def test_the_map_services_answer(served: Served) -> None:
    served.store.put(MAP, "one", six_flags("one"))
    served.store.put(MAP, "two", six_flags("two", seed=2))
    far = served.far
    load = "nav2_msgs/LoadMap"
    refused = far.call("/static_map", "nav_msgs/GetMap").result(20)
    assert "no current map" in refused["error"]
    assert far.call("/map_server/map", "nav_msgs/GetMap").result(20)["reply"]["map"]["data"] == []
    loaded = far.call("/map_server/load_map", load, map_url="two").result(20)["reply"]
    assert loaded["result"] == 0
    until(lambda: served.store.current_map() == "two", "the loaded map is current", 20)
    got = until(
        lambda: far.call("/static_map", "nav_msgs/GetMap").result(20)["reply"],
        "the map is served",
        20,
        every=0.1,
    )
    assert got["map"]["data"] == loaded["map"]["data"]
    save = {"map_topic": "/maps/one", "map_url": "saved", "image_format": "png", "map_mode": "trinary"}
    assert far.call("/map_saver/save_map", "nav2_msgs/SaveMap", **save).result(20)["reply"] == {"result": True}
    assert {f.name for f in (served.folder / "here/map2d_server/maps").iterdir()} >= {"saved.yaml", "saved.png"}
    assert far.call("/change_map", "nav_msgs/LoadMap", map_url="saved.yaml").result(20)["reply"]["result"] == 0
    assert served.store.current_map() == "saved"
    for url, result in (("nowhere.yaml", 1), ("../saved.yaml", 2), ("/etc/passwd", 2), ("file:///etc/passwd", 2)):
        assert far.call("/map_server/load_map", load, map_url=url).result(20)["reply"]["result"] == result, url
        assert far.call("/map_saver/save_map", "nav2_msgs/SaveMap", **save | {"map_url": url.replace("nowhere", "../x")}
                        ).result(20)["reply"] == {"result": False}  # fmt: skip
    assert far.call("/map_saver/save_map", "nav2_msgs/SaveMap", **save | {"map_topic": "/camera"}).result(20)[
        "reply"
    ] == {"result": False}
    status = served.answer("map2d_server")
    assert status["refusals"] >= 9
    assert "/camera is not a map of the store" in status["last_refusal"]


def test_yarp_clients_save_and_load_files(served: Served) -> None:
    folder = served.folder / "here/map2d_server/maps"
    with served.client() as client:
        client.maps["office"] = grid = six_flags()
        client.locations["kitchen"] = kitchen = Map2DLocation("office", 1, 2, 90, "by the door")
        client.areas["hall"] = Map2DArea("office", [Vec2D(0, 0), Vec2D(1, 0), Vec2D(1, 1)], "")
        served.store.put(BEHAVIOR, "hall", AreaBehavior(max_speed=0.5))
        client.maps.save("office", "office.map")
        client.maps.save_collection("all.ini")
        client.save_places("places.ini")
        client.maps.clear()
        client.locations.clear()
        client.areas.clear()
        client.maps.load("office.map")
        assert client.maps["office"] == grid
        client.maps.clear()
        client.maps.load_collection("all.ini")
        client.load_places("places.ini")
        assert client.maps["office"] == grid
        assert dict(client.locations) == {"kitchen": kitchen}
        assert served.store.behavior("hall") == AreaBehavior(max_speed=0.5)
        before = sorted(served.folder.rglob("*"))
        for name in ("../x.map", "/tmp/x.map", "a/b.map", "..", "", ".map", "C:\\x.map"):
            for call in (lambda n: client.maps.save("office", n), client.maps.load):
                with pytest.raises(CallFailed):
                    call(name)
        for name in ("../x.ini", "/etc/passwd", "sub/x.ini"):
            for call in (client.maps.save_collection, client.maps.load_collection, client.save_places,
                         client.load_places):  # fmt: skip
                with pytest.raises(CallFailed):
                    call(name)
        with pytest.raises(CallFailed):
            client.maps.reload()
        outside = served.folder / "outside"
        outside.mkdir()
        grid.save(outside / "office.map")
        for flags in (outside / "office_yarpflags.ppm", "../../../outside/office_yarpflags.ppm"):
            (folder / "evil.map").write_text(f"MapName x\nYarpMapData {flags}\n")
            with pytest.raises(CallFailed):
                client.maps.load("evil.map")
        shutil.rmtree(outside)
        (folder / "evil.map").unlink()
        assert [path for path in sorted(served.folder.rglob("*")) if "sqlite" not in path.name] == [
            path for path in before if "sqlite" not in path.name
        ]


def test_the_publisher_of_a_bridged_map_is_named_by_its_side(served: Served) -> None:
    """The bridged publisher belongs to a worker's node, which must not be named as the source of the map."""

    def text() -> str:
        return str((served.status("map2d_server") or {}).get("text"))

    with Hub.open(served.hubs.settings("midspan_ros2", worker="ros2")) as hub:
        hub.set_origin(Origin("ros2", "0" * 24, "other"))
        hub.publisher(
            "/map",
            "nav_msgs/msg/OccupancyGrid",
            served.far.registry.ros2("nav_msgs/msg/OccupancyGrid").type_id,
            LATCHED,
        )
        until(lambda: "/map is published by a node on ROS 2, not by this module" in text(), text, 20)
        assert "midspan" not in text()
    until(lambda: "published by" not in text(), "the health text no longer names a publisher", 20)


def test_explain_shows_the_protocol_of_a_client(
    served: Served, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "midspan.yaml"
    file.write_text(json.dumps({"name": "here", "hub": {"listen": served.hubs.endpoint}}))
    answered = "its calls are answered as YARP 3.12 does (it asked for the protocol's version in YARP 3's format"

    def explained() -> str:
        """Return the explanation once it has the worker's reply, which may be late."""
        code, output = main(["explain", "/map2D_nws_yarp/rpc", "--config", str(file)]), capsys.readouterr().out
        return output if code == 0 and answered in output else ""

    with served.client() as client:
        assert list(client.maps) == []
        output = until(explained, "the client's protocol is shown", 20)
    assert "has no decision on it" not in output


def test_areas_and_places_are_published(served: Served) -> None:
    free = MapGrid2D.of(np.zeros((10, 10), np.uint8), name="hall", resolution=1.0)
    served.store.put(MAP, "hall", free)
    served.store.use_map("hall")
    corners = [Vec2D(0.1, 0.1), Vec2D(2.9, 0.1), Vec2D(2.9, 2.9), Vec2D(0.1, 2.9)]
    mask, speed = served.latest("/keepout_filter_mask", GRID), served.latest("/speed_filter_mask", GRID)
    info, shown = served.latest("/speed_costmap_filter_info", INFO), served.latest("/map_locations", MARKERS)
    until(lambda: mask() and speed() and info() and shown(), "all topics are published", 20)
    assert not any(mask()["data"])
    assert not any(speed()["data"])
    with served.client() as client:
        client.areas["slow"] = Map2DArea("hall", corners, "max_speed=0.2 on_obstacle=wait")
        client.areas["shut"] = Map2DArea("hall", [Vec2D(c.x + 5, c.y) for c in corners], "")
        client.locations["kitchen"] = Map2DLocation("hall", 1, 2, 90, "")
        client.locations["far away"] = Map2DLocation("other map", 1, 2, 90, "")
        client.objects["cup"] = Map2DObject("hall", 1, 2, 3)
        client.paths["way"] = Map2DPath([Map2DLocation("hall", 1, 1), Map2DLocation("hall", 2, 2)])
    served.store.put(BEHAVIOR, "shut", AreaBehavior(keep_out=True))
    until(lambda: sum(value > 0 for value in speed()["data"]) == 9, "the slow area is in the mask", 20)
    until(lambda: sum(value == 100 for value in mask()["data"]) == 9, "the closed area is in the keep-out mask", 20)
    limit = info()["base"] + info()["multiplier"] * max(speed()["data"])
    assert (info()["type"], info()["filter_mask_topic"]) == (2, "/speed_filter_mask")
    assert limit == pytest.approx(0.2)
    names = {"location kitchen", "object cup", "area slow", "area shut", "path way"}
    until(lambda: {m["ns"] for m in shown()["markers"]} >= names, "the places are shown", 20)
    assert not any("far away" in marker["ns"] for marker in shown()["markers"])
    assert shown()["markers"][0]["action"] == 3
    served.store.delete(AREA, "slow")
    until(lambda: not any(speed()["data"]), "the speed limit is gone", 20)


def test_masks_keep_robots_out_of_what_cannot_be_read(served: Served) -> None:
    free = MapGrid2D.of(np.zeros((10, 10), np.uint8), name="hall", resolution=1.0)
    corners = [Vec2D(0.1, 0.1), Vec2D(2.9, 0.1), Vec2D(2.9, 2.9), Vec2D(0.1, 2.9)]
    served.store.put(MAP, "hall", free)
    served.store.use_map("hall")
    mask, binary = served.latest("/keepout_filter_mask", GRID), served.latest("/binary_filter_mask", GRID)
    shown = served.latest("/map_locations", MARKERS)

    def warned(text: str) -> bool:
        document = served.far.hub.ask("status", {}, worker="map2d_server", timeout=20.0)[0].value
        return any(text in warning for warning in document["warnings"])

    served.store.put(AREA, "slow", Map2DArea("hall", corners, "max_speed=fast"))
    until(lambda: mask() and sum(value == 100 for value in mask()["data"]) == 9, "robots keep out of the area", 20)
    assert warned("keep out of the area 'slow'")
    served.store.replica.write({(AREA.name, "lab"): (b'{"map": "hall", "points": 3}', AREA.encoding)})
    until(lambda: binary() and set(mask()["data"]) == set(binary()["data"]) == {100}, "robots keep out of the map", 20)
    assert warned("keep out of the map 'hall'")
    assert any(marker["ns"] == "area slow" for marker in shown()["markers"])
    served.store.delete(AREA, "lab")
    served.store.put(BEHAVIOR, "slow", AreaBehavior())
    until(lambda: not any(mask()["data"]), "the map is open", 20)
    assert not warned("keep out")


def test_a_rotated_map_is_published_aligned(served: Served) -> None:
    turned = MapGrid2D.of(np.full((4, 8), MapFlag.WALL, np.uint8), name="t", resolution=0.5, origin=(0, 0, 90))
    served.store.put(MAP, "t", turned)
    served.store.use_map("t")
    current = served.latest("/map", GRID)
    until(current, "the map is published", 20)
    info = current()["info"]
    assert info["origin"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    assert (info["width"], info["height"]) == (4, 8)
    assert set(current()["data"]) == {100}


def test_clicked_points_become_locations(served: Served) -> None:
    served.store.put(MAP, "hall", six_flags("hall"))
    served.store.use_map("hall")
    until(lambda: (served.status("map2d_server") or {}).get("current") == "hall", "the map is current", 20)
    out = served.far.advertise("/clicked_point", "geometry_msgs/PointStamped")

    def click() -> dict[str, Map2DLocation]:
        served.far.publish(out, {"header": {"frame_id": "map"}, "point": {"x": 1.5, "y": -2.0, "z": 0.0}})
        return served.store.all(LOCATION)

    places = until(click, "the point is stored", 20, every=0.1)
    assert places["point1"] == Map2DLocation("hall", 1.5, -2.0, 0.0, "clicked")
    served.far.publish(out, {"header": {"frame_id": "odom"}, "point": {"x": 1.5, "y": -2.0, "z": 0.0}})
    until(
        lambda: "'odom'" in str((served.status("map2d_server") or {}).get("last_refusal")), "the point is refused", 20
    )
    served.far.drop(out)


def test_several_clients_write_at_once(served: Served) -> None:
    """All 40 locations of each of 4 clients are stored."""
    failed: list[str] = []

    def write(number: int) -> None:
        with served.client() as client:
            failed.extend(f"{number}_{i}" for i in range(40)
                          if not client.storeLocation(f"{number}_{i}", Map2DLocation("m", i)))  # fmt: skip

    threads = [threading.Thread(target=write, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    assert len(served.store.names(LOCATION)) == 160


def test_maps_get_legal_topic_names() -> None:
    assert topic_of("office") == "/maps/office"
    assert topic_of("1st floor") == "/maps/n1st_floor"
    first = topic_of("a b")
    assert topic_of("a-b", {first}).startswith("/maps/a_b_")
    assert topic_of("\u00e4") == "/maps/_"


@pytest.mark.parametrize("three", [False, True])
def test_a_map_may_be_added_while_another_thread_reads_the_topics(three: bool) -> None:
    nothing: Any = None
    maps = Maps3D(nothing, nothing, nothing) if three else AllMaps(nothing, nothing, nothing)
    known: dict[str, Any] = maps._ends

    class End:
        @property
        def topic(self) -> str:
            known["b"] = known["a"]
            return "/maps/a"

    known["a"] = ("", End()) if three else End()
    assert maps.topics == {"a": "/maps/a"}
