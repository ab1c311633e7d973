"""Mapper3D on a hub: it builds a layer, a map and files from depth images and clouds."""

from __future__ import annotations

import base64
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from bridge.modules import worker as modules_worker
from bridge.stores.kinds import MAP, MAP3D
from navigation.clouds import MOST_POINTS, read_points
from navigation.mapper3d.octomaps import cloud_message
from navigation.mapper3d.section import Mapper3DSection
from navigation.maps.grid_map import values_at
from tests.peers.hub.modules import Place
from tests.support.wait import until
from yarp_compat import octree
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer
from yarp_compat.octomap import Octomap
from yarp_compat.octree import OcTree
from yarp_compat.pythonic import Client
from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType

OPTICAL = {"x": -0.5, "y": 0.5, "z": -0.5, "w": 0.5}  # looking ahead along x
WIDTH, HEIGHT, FOCUS = 64, 48, 40.0


def settings(**more: Any) -> dict[str, Any]:
    section = {"enabled": True, "clouds": ["/cloud"], "depth": [{"image": "/depth", "info": "/info"}], "period": 0.1}
    return {**section, "map_name": "house", "map_frame": "odom", "layer": {"period": 0.1}, "keep": True, **more}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    with Place(tmp_path_factory.mktemp("place")) as place:
        server = NameServer(port=place.port, gc_seconds=0)
        server.open()
        place.worker.start(place.config(modules={"mapper3d": settings()}))
        until(lambda: connections.exists(place.names, "/mapper3D/rpc"), "the port is registered", 30)
        yield place
        place.worker.stop()
        server.close()


class Robot:
    """A robot with a camera, which publishes clouds, depth images and transforms."""

    def __init__(self, place: Place) -> None:
        far = place.far
        self.place, self.far = place, far
        self.frames = far.advertise("/tf", "tf2_msgs/TFMessage")
        self.static = far.advertise("/tf_static", "tf2_msgs/TFMessage", latched=True)
        self.cloud = far.advertise("/cloud", "sensor_msgs/PointCloud2")
        self.depth = far.advertise("/depth", "sensor_msgs/Image")
        self.info = far.advertise("/info", "sensor_msgs/CameraInfo")
        far.publish(self.static, {"transforms": [self.transform("base_link", "camera", 1.0, OPTICAL, {"sec": 1})]})

    @staticmethod
    def transform(parent: str, child: str, z: float, turn: dict[str, float], stamp: dict[str, int]) -> dict[str, Any]:
        place = {"translation": {"z": z}, "rotation": turn}
        return {"header": {"stamp": stamp, "frame_id": parent}, "child_frame_id": child, "transform": place}

    def stamp(self) -> dict[str, int]:
        """Publish the robot's current pose; return its time."""
        now = time.time_ns()
        stamp = {"sec": now // 10**9, "nanosec": now % 10**9}
        self.far.publish(self.frames, {"transforms": [self.transform("odom", "base_link", 0.0, {"w": 1.0}, stamp)]})
        return stamp

    def publish_cloud(self, points: np.ndarray, **changed: Any) -> None:
        header = {"stamp": self.stamp(), "frame_id": "base_link"}
        self.far.publish(self.cloud, {**cloud_message(header, points.astype(np.float32)), **changed})

    def publish_depth(self, depth: np.ndarray, info: bool = True) -> None:
        header = {"stamp": self.stamp(), "frame_id": "camera"}
        k = [FOCUS, 0.0, WIDTH / 2, 0.0, FOCUS, HEIGHT / 2, 0.0, 0.0, 1.0]
        millimeters = (depth * 1000).astype("<u2")
        image = {"width": WIDTH, "height": HEIGHT, "encoding": "16UC1", "step": 2 * WIDTH}
        self.far.publish(self.depth, {"header": header, **image, "data": millimeters.view(np.uint8).reshape(-1)})
        if info:
            self.far.publish(self.info, {"header": header, "width": WIDTH, "height": HEIGHT, "k": k})


def ask(place: Place, *words: Any) -> Any:
    with Client("/mapper3D/rpc", naming=place.names) as client:
        return client.ask(list(words))


def trigger(place: Place, service: str) -> dict[str, Any]:
    return place.far.call(f"/mapper3d/{service}", "std_srvs/Trigger").result(20)["reply"]


def stop_mapping(place: Place) -> None:
    """Stop mapping, so that pending clouds are ignored."""
    assert trigger(place, "stop")["success"]


def table() -> np.ndarray:
    """Return points of a floor and a table's top in the robot's frame."""
    x, y = np.meshgrid(np.arange(0.5, 3.0, 0.02), np.arange(-1.0, 1.0, 0.02))
    floor = np.stack((x, y, np.full(x.shape, -0.01)), -1).reshape(-1, 3)
    top = floor[(np.abs(floor[:, 0] - 2.0) < 0.3) & (np.abs(floor[:, 1]) < 0.4)] + np.array([0.0, 0.0, 0.75])
    return np.concatenate([floor, top])


def test_a_cloud_is_mapped_into_layer_files_and_store(place: Place) -> None:
    robot = Robot(place)
    layers = place.far.subscribe("/mapper3d/layer", "nav_msgs/OccupancyGrid", latched=True, depth=1)
    updates = place.far.subscribe("/mapper3d/layer_updates", "map_msgs/OccupancyGridUpdate", depth=10)
    ask(place, "start")

    def value(x: float, y: float) -> int:
        published = place.far.wait(layers, 1, 1.0)
        if not published:  # the robot's first pose may have been lost
            return -2
        message = published[-1]
        info, origin = message["info"], message["info"]["origin"]["position"]
        column, row = (int((value - origin[axis]) / info["resolution"]) for value, axis in ((x, "x"), (y, "y")))
        assert message["header"]["frame_id"] == "odom"
        inside = 0 <= column < info["width"] and 0 <= row < info["height"]
        return int(message["data"][row * info["width"] + column]) if inside else -1

    def cleared() -> bool:  # remove what earlier tests mapped
        robot.stamp()
        ask(place, "clear")
        return value(2.0, 0.0) == -1

    def mapped() -> bool:
        robot.publish_cloud(table())
        return (value(2.0, 0.0), value(1.0, 0.8), value(2.9, -0.9)) == (100, 0, 0)

    until(cleared, "the layer is empty", 30)
    until(mapped, "the table is in the layer", 30)
    stop_mapping(place)
    heights = place.far.subscribe("/mapper3d/layer_heights", "grid_map_msgs/GridMap", latched=True, depth=1)

    def height(layer: str) -> float:
        return float(values_at(place.far.wait(heights, 1)[-1], layer, np.array([(2.01, 0.01)]))[0])

    until(lambda: height("lowest") == pytest.approx(0.75), "the table's height is published", 20)
    assert height("highest") == pytest.approx(0.75)
    assert ask(place, "save_to_mapserver") == ["3D map house and layer layer saved into the store."]
    grid = place.worker.store.get(MAP, "layer")
    column, row = grid.cells_at((2.0, 0.0))
    assert grid.flags[row, column] == MapFlag.WALL
    place.worker.store.delete(MAP3D, "house")
    assert trigger(place, "save")["success"]
    stored = place.worker.store.get(MAP3D, "house")
    assert (stored.search(2.0, 0.0, 0.74) > 0, stored.binary) == (True, False)

    for name in ("house.bt", "house.ot"):
        assert ask(place, "save_to_file", name) == [f"Map saved as {name}."]
        (file,) = place.folder.rglob(name)
        assert Octomap.load(file).search(2.0, 0.0, 0.74) > 0
    ask(place, "clear")
    assert place.answer("mapper3d")["blocks"] == 0
    assert ask(place, "load_from_file", "house.ot") == ["Map house.ot loaded; mapping continues on it."]
    until(lambda: value(2.0, 0.0) == 100, "the layer shows the file's map", 20)
    ask(place, "clear")
    assert ask(place, "load_from_mapserver", "house") == ["3D map house loaded; mapping continues on it."]
    until(lambda: place.answer("mapper3d")["blocks"] > 20, "the store's map is loaded", 20)
    ask(place, "start")
    higher = table()[:500] + np.array([0.0, 0.0, 0.4])

    def changed() -> bool:
        robot.publish_cloud(np.concatenate([table(), higher]))
        return bool(place.far.wait(updates, 1, 0.3))

    until(changed, "the update is published", 20)
    update = place.far.wait(updates, 1)[-1]
    assert len(update["data"]) == update["width"] * update["height"] > 0


def test_depth_images_are_used_with_the_info_of_their_time(place: Place) -> None:
    robot = Robot(place)
    ask(place, "clear")
    ask(place, "start")
    depth = np.full((HEIGHT, WIDTH), 2.0)
    depth[:, : WIDTH // 2] = 0.0

    def mapped() -> bool:
        robot.publish_depth(depth)
        return int(place.answer("mapper3d")["blocks"]) > 20

    until(mapped, "the wall is mapped", 30)
    assert ask(place, "save_to_file", "wall.ot") == ["Map saved as wall.ot."]
    (file,) = place.folder.rglob("wall.ot")
    octomap = Octomap.load(file)
    assert octomap.search(2.01, -0.5, 1.0) > 0  # the right side of the image is at the robot's right
    assert octomap.search(1.0, -0.25, 1.0) < 0
    assert np.isnan(octomap.search(2.01, 0.5, 1.0))

    dropped = place.answer("mapper3d")["dropped"]

    def reported() -> bool:
        robot.publish_depth(depth, info=False)
        answer = place.answer("mapper3d")
        return answer["dropped"] > dropped and "CameraInfo" in answer["trouble"]

    until(reported, "an image without its info is dropped", 30)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"width": 100_000_000}, f"width, height: 100000000 x 1 points are declared, more than {MOST_POINTS}"),
        ({"fields": []}, "fields: no x, y, z among none"),
        ({"row_step": 4}, "row_step: 4 bytes"),
        ({"header": {"frame_id": "nowhere"}}, "nowhere"),
    ],
)
def test_an_invalid_cloud_is_reported_with_the_field_name(place: Place, changed: dict[str, Any], words: str) -> None:
    robot = Robot(place)

    def reported() -> bool:
        robot.publish_cloud(table(), **changed)
        return words in place.answer("mapper3d")["trouble"]

    until(reported, "the error is reported", 30)


def test_the_floor_is_at_base_footprint(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The base frame is at the axle, 0.2 m above the floor."""
    with Place(tmp_path_factory.mktemp("axle")) as place:
        place.worker.start(place.config(modules={"mapper3d": settings(keep=False)}))
        robot = Robot(place)
        below = table() - np.array([0.0, 0.0, 0.2])

        def health_has(text: str) -> bool:
            robot.publish_cloud(below)
            return text in place.worker.health().text

        until(lambda: health_has("set modules.mapper3d.floor"), "the missing floor is reported", 30)
        footprint = robot.transform("base_link", "base_footprint", -0.2, {"w": 1.0}, {"sec": 1})
        place.far.publish(robot.static, {"transforms": [footprint]})
        until(lambda: not health_has("floor"), "the floor is found", 30)


def test_services_and_rpc_commands_report_their_errors(place: Place) -> None:
    robot = Robot(place)
    assert trigger(place, "stop")["message"] == "not mapping"
    clouds = place.answer("mapper3d")["clouds"]

    def handled(points: bool) -> bool:
        robot.publish_cloud(table(), **({} if points else {"row_step": 8}))
        return ("row_step: 8 bytes" in place.answer("mapper3d")["trouble"]) != points

    until(lambda: handled(points=False), "an invalid cloud is reported", 30)
    until(lambda: handled(points=True), "a valid cloud clears the error", 30)
    assert place.answer("mapper3d")["clouds"] == clouds
    assert trigger(place, "start")["success"]
    for words in (["fly"], ["save_to_file"], ["save_to_file", "../out"], ["load_from_file", "none"]):
        assert ask(place, *words)[0] == "fail"
    assert any("save_to_mapserver" in line for line in ask(place, "help"))


def test_the_map_survives_a_restart(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modules_worker, "STOP_SECONDS", 60.0)  # the module's thread may begin late to stop it
    with Place(tmp_path_factory.mktemp("kept")) as place:
        config = place.config(modules={"mapper3d": settings()})
        place.worker.start(config)
        robot = Robot(place)

        def mapped() -> bool:
            robot.publish_cloud(table())
            return int(place.answer("mapper3d")["blocks"]) > 20

        until(mapped, "the cloud is mapped", 30)
        place.worker.stop()
        (file,) = place.folder.rglob("mapper3d/map.ot")
        assert Octomap.load(file).search(2.0, 0.0, 0.74) > 0
        place.worker = place.keep(type(place.worker)())
        place.worker.start(config)
        assert place.answer("mapper3d")["blocks"] > 20
        place.worker.stop()
        file.write_bytes(b"# Octomap OcTree file\nsize 3\n")
        place.worker = place.keep(type(place.worker)())
        place.worker.start(config)
        assert "map.ot" in place.answer("mapper3d")["trouble"]
        until(mapped, "the cloud is mapped again", 30)
        running: Any = place.worker.running("mapper3d")
        monkeypatch.setattr(octree, "MAX_NODES", 8)
        running.host.loop.call(running.module._save_state)
        assert "cannot save the map: data: more than 8 nodes" in place.answer("mapper3d")["trouble"]


def test_a_map_that_is_reset_is_published_and_stays_empty_after_a_restart(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(modules_worker, "STOP_SECONDS", 60.0)  # the module's thread may begin late to stop it
    with Place(tmp_path_factory.mktemp("reset")) as place:
        place.worker.start(place.config(modules={"mapper3d": settings()}))
        robot = Robot(place)
        layers = place.far.subscribe("/mapper3d/layer", "nav_msgs/OccupancyGrid", latched=True, depth=1)

        def obstacles() -> bool:
            # the first cloud may be lost, and no layer is published without one
            return any(100 in message["data"] for message in place.far.wait(layers, 1, 1.0)[-1:])

        def mapped() -> bool:
            robot.publish_cloud(table())
            return obstacles()

        until(mapped, "the table is in the layer", 30)
        stop_mapping(place)
        running: Any = place.worker.running("mapper3d")
        running.host.loop.call(running.module._save_state)
        place.far.call("/octomap_server/reset", "std_srvs/Empty").result(20)
        until(lambda: robot.stamp() and not obstacles(), "the layer is empty", 20)
        place.worker.stop()
        place.worker = place.keep(type(place.worker)())
        place.worker.start(place.config(modules={"mapper3d": settings()}))
        assert place.answer("mapper3d")["blocks"] == 0


def test_a_saved_map_that_cannot_be_loaded_is_not_overwritten(tmp_path_factory: pytest.TempPathFactory) -> None:
    with Place(tmp_path_factory.mktemp("refused")) as place:

        def restart(**more: Any) -> str:
            place.worker.stop()
            place.worker = place.keep(type(place.worker)())
            place.worker.start(place.config(modules={"mapper3d": settings(**more)}))
            return str(place.answer("mapper3d")["trouble"])

        def change_and_save() -> None:
            running: Any = place.worker.running("mapper3d")
            running.host.loop.call(running.module.space.clear)
            running.host.loop.call(running.module._save_state)

        place.worker.start(place.config(modules={"mapper3d": settings()}))
        change_and_save()
        (file,) = place.folder.rglob("mapper3d/map.ot")
        assert "voxels have 0.05 m, Mapper3D's 0.1 m" in restart(resolution=0.1)
        for _ in range(2):
            change_and_save()
            assert Octomap.load(file.with_name("map.refused.ot")).resolution == 0.05
            assert Octomap.load(file).resolution == 0.1
        assert "voxels have 0.1 m" in restart()
        change_and_save()
        assert Octomap.load(file.with_name("map.refused.ot")).resolution == 0.05


def test_a_map_of_the_store_is_continued(tmp_path_factory: pytest.TempPathFactory) -> None:
    with Place(tmp_path_factory.mktemp("stored")) as place:
        place.worker.start(place.config())
        keys, store = [[32_768, 32_768, 32_770]], place.worker.store
        store.put(MAP3D, "house", Octomap.of(OcTree.of(keys, 1.5, resolution=0.05)))
        store.put(MAP3D, "coarse", Octomap.of(OcTree.of(keys, 1.5, resolution=0.1)))
        store.put(MAP3D, "points", PointCloud.of(np.zeros(0, LAYOUTS[PointType.XYZ])))

        def start(**more: Any) -> dict[str, Any]:
            place.worker.stop()
            place.worker = place.keep(type(place.worker)())
            place.worker.start(place.config(modules={"mapper3d": settings(**more)}))
            return place.answer("mapper3d")

        status = start(load="house")
        assert (status["blocks"], status["trouble"]) == (1, "")
        got = place.far.call("/octomap_full", "octomap_msgs/GetOctomap").result(20)["reply"]["map"]
        assert OcTree.from_full(np.array(got["data"], np.int8).tobytes(), 0.05).search(0.01, 0.01, 0.11) == 1.5
        for name, words in (
            ("attic", "no 3D map 'attic'; 3D maps in the store: coarse, house, points"),
            ("points", "the 3D map 'points' is a cloud"),
            ("coarse", "voxels have 0.1 m"),
        ):
            status = start(load=name)
            assert status["blocks"] == 0
            assert words in status["trouble"]


def test_octomap_servers_topics_and_services_are_served(place: Place) -> None:
    robot, far = Robot(place), place.far
    ask(place, "clear")
    ask(place, "start")
    topics = {
        name: far.subscribe(f"/octomap_{name}", kind, depth=1)
        for name, kind in (
            ("binary", "octomap_msgs/Octomap"), ("full", "octomap_msgs/Octomap"),
            ("point_cloud_centers", "sensor_msgs/PointCloud2"),
        )
    }  # fmt: skip

    def tree(message: dict[str, Any]) -> OcTree:
        data = np.array(message["data"], np.int8).tobytes()
        make = OcTree.from_binary if message["binary"] else OcTree.from_full
        assert (message["header"]["frame_id"], message["id"]) == ("odom", "OcTree")
        return make(data, message["resolution"])

    def shown(name: str) -> bool:
        """Return whether the table is in the newest message; the first ones may show the map from before the cloud."""
        newest = far.wait(topics[name], 1, 0.3)[-1:]
        if name != "point_cloud_centers":
            return any(tree(message).search(2.0, 0.0, 0.74) > 0 for message in newest)
        centers = (read_points({**cloud, "data": base64.b64decode(cloud["data"])}) for cloud in newest)
        return any((np.abs(points - (2.0, 0.0, 0.74)).max(-1) < 0.06).any() for points in centers)

    def seen() -> bool:
        robot.publish_cloud(table())
        return all(shown(name) for name in topics)

    until(seen, "the table is on all topics", 30)
    stop_mapping(place)
    for name in ("binary", "full"):
        got = far.call(f"/octomap_{name}", "octomap_msgs/GetOctomap").result(20)["reply"]["map"]
        assert got["binary"] == (name == "binary")
        assert tree(got).search(2.0, 0.0, 0.74) > 0

    box = {"min": {"x": 1.0, "y": -2.0, "z": 0.5}, "max": {"x": 3.0, "y": 2.0, "z": 1.0}}
    far.call("/octomap_server/clear_bbx", "octomap_msgs/BoundingBoxQuery", **box).result(20)
    cleared = tree(far.call("/octomap_full", "octomap_msgs/GetOctomap").result(20)["reply"]["map"])
    assert cleared.search(2.0, 0.0, 0.74) < 0
    assert cleared.search(1.0, 0.0, -0.01) > 0
    far.call("/octomap_server/reset", "std_srvs/Empty").result(20)
    assert place.answer("mapper3d")["blocks"] == 0


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"nearest": 5.0, "farthest": 4.0}, "nearest"),
        ({"clouds": ["/a", "/a"]}, "two sources have the topic /a"),
    ],
)
def test_invalid_settings_are_rejected(section: dict[str, Any], words: str) -> None:
    [(path, text)] = Mapper3DSection.model_validate(section).mistakes(None)
    assert words in f"{'.'.join(map(str, path))}: {text}"
