"""Mapper2D on a hub and on YARP: it maps scans, publishes the map to all sides, and paints areas."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.clock import SYSTEM_CLOCK
from bridge.stores.kinds import MAP
from tests.peers.hub.modules import Place
from tests.support.wait import until
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Client, Reader, Writer
from yarp_compat.sig.image import ImageRgb
from yarp_compat.sig.vector import Vector

BEAMS = 360
RADIUS = 2.02
S = 1_000_000_000


@contextlib.contextmanager
def mapping(folder: Path) -> Iterator[Place]:
    with Place(folder) as place:
        server = NameServer(port=place.port, gc_seconds=0)
        server.open()
        section = {"enabled": True, "pose": "port", "laser": [0.5, 0.0, 90.0], "period": 0.1, "width": 8, "height": 8}
        section |= {"laser_port": "/robot/laser:o", "pose_port": "/robot/odometry:o"}
        place.worker.start(place.config(modules={"mapper2d": section}))
        until(lambda: connections.exists(place.names, "/mapper2D/yarpviewTarget:i"), "the ports are registered", 30)
        until(lambda: connections.exists(place.names, "/mapper2D/odometry:i"), "all ports are registered", 30)
        yield place
        place.worker.stop()
        server.close()


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    with mapping(tmp_path_factory.mktemp("place")) as mapper:
        yield mapper


@pytest.fixture
def untouched(tmp_path: Path) -> Iterator[Place]:
    """A mapper that receives no delayed scans from other tests."""
    with mapping(tmp_path) as mapper:
        yield mapper


def ask(place: Place, *words: Any) -> Any:
    """Return the reply to a command on the rpc port."""
    with Client("/mapper2D/rpc", naming=place.names) as client:
        return client.ask(list(words))


def scans(place: Place) -> None:
    """Publish poses and scans from the middle of a round room until they are mapped."""
    out = place.far.advertise("/scan", "sensor_msgs/LaserScan")

    def mapped() -> bool:
        with Writer(naming=place.names) as writer:
            writer.connect("/mapper2D/odometry:i")
            for number in range(20):
                now = time.time()
                writer.write(OdometryData(1.0, 2.0, 30.0), envelope=f"{number} {now:.9f}")
                stamp = {"sec": int(now), "nanosec": int(now % 1 * 1e9)}
                scan = {"angle_min": -math.pi, "angle_increment": math.tau / BEAMS, "ranges": [RADIUS] * BEAMS}
                header = {"stamp": stamp, "frame_id": "laser"}
                place.far.publish(out, {**scan, "header": header, "range_min": 0.1, "range_max": 20.0})
        return place.answer("mapper2d")["scans"] > 3

    until(mapped, "scans are mapped", 30)


def test_a_map_is_made_painted_and_saved(place: Place) -> None:
    assert ask(place, "clear") == ["Started a new map."]
    assert ask(place, "start") == ["Mapping."]
    topic = place.far.subscribe("/mapper2d/map", "nav_msgs/OccupancyGrid", latched=True, depth=1)
    scans(place)
    assert ask(place, "stop") == ["Stopped; 'start' continues."]
    # the laser: half a meter ahead of the robot, which is turned by 30 degrees
    middle = 1.0 + 0.5 * math.cos(math.radians(30)), 2.0 + 0.5 * math.sin(math.radians(30))
    until(lambda: {100, 0, -1} <= set(place.far.wait(topic, 1)[-1]["data"]), "the map is published", 20)
    message = place.far.wait(topic, 1)[-1]
    assert (message["header"]["frame_id"], message["info"]["width"]) == ("map", 160)

    assert ask(place, "set_pixel_type", "keepout") == ["Clicks paint keepout."]
    assert ask(place, "set_pixel_size", 3) == ["The brush has 3 by 3 cells."]
    with (
        Reader(naming=place.names) as reader,
        Writer(naming=place.names) as yarpview,
    ):
        connections.connect(place.names, "/mapper2D/map:o", reader.name)
        shown = reader.read()
        assert shown is not None
        picture = shown.to(ImageRgb).numpy()
        assert picture.shape == (160, 160, 3)
        assert {(254, 254, 254), (0, 0, 0), (0, 90, 200)} <= set(map(tuple, picture.reshape(-1, 3).tolist()))
        yarpview.connect("/mapper2D/yarpviewTarget:i")
        for click in ([70, 80], [60, 20, 100, 20], [1000, 2]):
            assert yarpview.write(click, strict=True) == 1

        def painted() -> bool:
            answer = ask(place, "save_to_mapserver")
            assert answer == ["Map map saved into the store."]
            grid = place.worker.store.get(MAP, "map")
            return int((grid.flags == MapFlag.KEEP_OUT).sum()) == 9 + 43 * 3

        until(painted, "the clicks are painted", 20)
    grid = place.worker.store.get(MAP, "map")
    column, row = grid.cells_at(middle)
    assert grid.flags[row, column] == MapFlag.FREE
    column, row = grid.cells_at((middle[0], middle[1] - RADIUS))
    assert (grid.flags[row - 1 : row + 2, column] == MapFlag.WALL).any()
    assert (grid.flags[80, 70], grid.flags[20, 60], grid.flags[20, 100]) == (MapFlag.KEEP_OUT,) * 3
    outside = lambda: "outside the map's picture" in str(place.answer("mapper2d"))  # noqa: E731
    until(outside, "the click outside the map is reported", 20)


def test_a_click_is_painted_and_due_for_publication_in_one_step(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    running = place.worker.running("mapper2d")
    module: Any = running.module
    call, changed = running.host.loop.call, list[bool]()

    def observed(action: Callable[[], Any]) -> Any:
        def run() -> None:
            module._changed = False
            action()
            changed.append(module._changed)

        return call(run)

    with monkeypatch.context() as patched:
        patched.setattr(module._canvas, "click", lambda _values: 1)
        patched.setattr(running.host.loop, "call", observed)
        module._click(SimpleNamespace(values=[70, 80]))
    assert changed == [True]


def test_laser_and_pose_ports_of_yarp_are_connected(place: Place) -> None:
    ask(place, "clear")
    ask(place, "start")
    with Writer("/robot/laser:o", naming=place.names) as laser, Writer("/robot/odometry:o", naming=place.names) as base:

        def mapped() -> bool:
            envelope = f"1 {time.time():.9f}"
            base.write(OdometryData(1.0, 2.0, 30.0), envelope=envelope)
            laser.write(LaserScan2D(0.0, 360.0, 0.1, 20.0, Vector([RADIUS] * BEAMS), 1), envelope=envelope)
            return place.answer("mapper2d")["scans"] > 3

        until(mapped, "scans are mapped", 30)
    assert ask(place, "stop") == ["Stopped; 'start' continues."]
    assert place.answer("mapper2d")["scans"] > 3
    assert ask(place, "save_to_mapserver") == ["Map map saved into the store."]
    grid = place.worker.store.get(MAP, "map")
    middle = 1.0 + 0.5 * math.cos(math.radians(30)), 2.0 + 0.5 * math.sin(math.radians(30))
    column, row = grid.cells_at(middle)
    assert grid.flags[row, column] == MapFlag.FREE
    column, row = grid.cells_at((middle[0] + RADIUS, middle[1]))
    assert (grid.flags[row, column - 1 : column + 2] == MapFlag.WALL).any()


def test_the_map_is_saved_by_slam_toolboxs_service(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    def save(name: str) -> int:
        request = {"name": {"data": name}}
        reply = place.far.call("/slam_toolbox/save_map", "slam_toolbox/SaveMap", **request).result(20)["reply"]
        return int(reply["result"])

    ask(place, "clear")
    assert save("nothing") == 1
    ask(place, "set_pixel_type", "wall")
    assert ask(place, "paint", 0.0, 0.0)[0].endswith("cells painted.")
    assert (save("floor"), save("")) == (0, 0)
    for name in ("../out", "/etc/out", "a/b", "out.txt"):
        assert save(name) == 255
    assert "/slam_toolbox/save_map: the map is not saved: '../out' is refused" in caplog.text
    files = {file.name for file in Path(place.folder).rglob("maps/*")}
    assert files >= {"floor.yaml", "floor.pgm", "map.yaml"}
    assert not any("out" in name for name in files)
    assert ask(place, "load_from_file", "floor.yaml") == ["Map floor loaded; mapping continues on it."]
    assert ask(place, "initLoc", "map", 1.0, 2.0, 30)[0].endswith("30 degrees on map.")


def test_a_map_with_a_long_name_is_saved(place: Place) -> None:
    name = "\u5730\u56fe" * 20
    (place.worker.running("mapper2d").host.folder / "maps" / "graphs").mkdir(parents=True, exist_ok=True)
    assert ask(place, "initLoc", name, 1.0, 2.0, 30)[0].endswith(f"30 degrees on {name}.")
    try:
        assert ask(place, "save_to_mapserver") == [f"Map {name} saved into the store."]
    finally:
        ask(place, "initLoc", "map", 1.0, 2.0, 30)


def test_the_service_save_reports_why_the_graph_cannot_be_saved(untouched: Place) -> None:
    maps = untouched.worker.running("mapper2d").host.folder / "maps"
    maps.mkdir()
    (maps / "graphs").touch()
    reply = untouched.far.call("/mapper2d/save", "std_srvs/Trigger").result(20)["reply"]
    assert not reply["success"]
    assert "graphs" in reply["message"]
    assert not untouched.worker.store.names(MAP), "the map is not saved either"


@pytest.mark.parametrize("name", ["../out", "/etc/out.map", "a/b", ".hidden", "out.txt"])
def test_files_outside_the_map_folder_are_refused(place: Place, name: str) -> None:
    for command in ("save_to_file", "load_from_file"):
        outcome, reason = ask(place, command, name)
        assert outcome == "fail"
        assert "refused" in reason


def test_a_map_is_saved_to_a_file_and_loaded(place: Place) -> None:
    ask(place, "clear")
    ask(place, "enlarge", 1)
    assert ask(place, "save_to_file", "flat") == ["Map map saved as flat.map."]
    assert list(Path(place.folder).rglob("flat.map"))
    ask(place, "clear")
    assert ask(place, "load_from_file", "flat") == ["Map map loaded; mapping continues on it."]
    assert place.answer("mapper2d")["size"] == pytest.approx([10.0, 10.0])
    assert ask(place, "initLoc", "other", 0.0, 0.0, 90.0)[0].startswith("The robot is at 0, 0 m, 90 degrees")
    assert ask(place, "initLoc", "map", 1.0, 2.0, 30)[0].endswith("30 degrees on map.")
    outcome, reason = ask(place, "load_from_mapserver", "none")
    assert (outcome, "no map 'none' in the store" in reason) == ("fail", True)
    for command in (["fly"], ["initLoc", "x", "y"], ["set_pixel_size", 0], ["set_pixel_type", "lava"], ["paint", 1]):
        assert ask(place, *command)[0] == "fail"
    help_ = ask(place, "help")
    assert all(any(command in line for line in help_) for command in ("save_to_file", "initLoc", "set_pixel_type"))


def test_a_pose_whose_quaternion_is_not_a_rotation_is_ignored(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    section = {"enabled": True, "map_frame": "odom", "initial_pose": "/initialpose"}
    with Place(tmp_path) as place:
        place.worker.start(place.config(modules={"mapper2d": section}))
        out = place.far.advertise("/initialpose", "geometry_msgs/PoseWithCovarianceStamped")
        pose = {"position": {"x": 1.0}, "orientation": dict.fromkeys("xyzw", 0.0)}
        message = {"header": {"frame_id": "odom"}, "pose": {"pose": pose}}
        error = "/initialpose: ignored: the pose's quaternion is not a rotation: its length is 0.00, not 1"
        until(lambda: error in caplog.text or place.far.publish(out, message), "the pose is ignored", 20, every=0.2)


@pytest.mark.parametrize("by", ["tf", "topic"])
def test_a_wall_is_mapped_at_its_place_with_poses_from_frames_and_from_topics(tmp_path: Path, by: str) -> None:
    """The robot drives along x toward a wall at x = 3 m. The laser, 0.5 m in front of the base, has one beam ahead.

    With frames, the laser is mounted upside down and turned by half a radian: ahead is half a radian to its left.
    """
    upside_down = by == "tf"
    section = {"enabled": True, "pose": by, "pose_topic": "/truth", "period": 0.1, "map_frame": "odom"}
    section["initial_pose"] = "/initialpose"
    with Place(tmp_path) as place:
        place.worker.start(place.config(modules={"mapper2d": section}))
        grids = place.far.subscribe("/mapper2d/map", "nav_msgs/OccupancyGrid", latched=True, depth=1)
        scan = place.far.advertise("/scan", "sensor_msgs/LaserScan")
        frames = place.far.advertise("/tf", "tf2_msgs/TFMessage")
        static = place.far.advertise("/tf_static", "tf2_msgs/TFMessage", latched=True)
        truth = place.far.advertise("/truth", "nav_msgs/Odometry")
        mounted = transform("base_link", "laser", 0.5, {"sec": 1})
        if upside_down:
            mounted["transform"]["rotation"] = {"x": math.cos(0.25), "y": math.sin(0.25), "w": 0.0}
        place.far.publish(static, {"transforms": [mounted]})
        starts = place.far.advertise("/initialpose", "geometry_msgs/PoseWithCovarianceStamped")
        moved = 0.0

        def mapped() -> bool:
            nonlocal moved
            for _ in range(10):
                now = time.time_ns()
                stamp = {"sec": now // 10**9, "nanosec": now % 10**9}
                place.far.publish(frames, {"transforms": [transform("odom", "base_link", moved, stamp)]})
                pose = {"position": {"x": moved}, "orientation": {"w": 1.0}}
                place.far.publish(truth, {"header": {"stamp": stamp, "frame_id": "odom"}, "pose": {"pose": pose}})
                # both poses are ignored
                for frame, x in (("odom", math.nan), ("elsewhere", 9.0)):
                    place.far.publish(starts, {"header": {"frame_id": frame}, "pose": {"pose": {"position": {"x": x}}}})
                beams = {
                    "angle_min": 0.5 * upside_down,
                    "angle_increment": 0.01,
                    "range_min": 0.1,
                    "range_max": 20.0,
                    "ranges": [2.525 - moved],
                }
                place.far.publish(scan, {"header": {"stamp": stamp, "frame_id": "laser"}, **beams})
                moved = (moved + 0.1) % 1.0
                time.sleep(0.01)  # so that consecutive poses have different times
            return place.answer("mapper2d")["scans"] > 10

        until(mapped, "scans are mapped", 30)

        def walls() -> set[tuple[float, float]]:
            grid = place.far.wait(grids, 1)[-1]
            origin, width = grid["info"]["origin"]["position"], grid["info"]["width"]
            cells = [divmod(at, width) for at, value in enumerate(grid["data"]) if value == 100]
            return {(round(origin["x"] + 0.05 * x, 2), round(origin["y"] + 0.05 * y, 2)) for y, x in cells}

        until(lambda: walls() == {(3.0, 0.0)}, "the wall is at its true place", 20)


def transform(parent: str, child: str, x: float, stamp: dict[str, int]) -> dict[str, Any]:
    """Return a frame ahead of another, without rotation."""
    place = {"translation": {"x": x}, "rotation": {"w": 1.0}}
    return {"header": {"stamp": stamp, "frame_id": parent}, "child_frame_id": child, "transform": place}


def test_a_scan_from_before_a_clock_jump_is_not_used(untouched: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    place = untouched
    assert ask(place, "start") == ["Mapping."]
    running = place.worker.running("mapper2d")
    host, now = running.host, [time.time_ns() + 10 * S]
    monkeypatch.setattr(host.clock, "now_ns", lambda: now[0])

    def receives_scans() -> bool:
        assert running.module is not None
        return "no scans on" not in running.module.health().text

    def counts() -> list[int]:
        host.loop.call(lambda: None)
        status = place.answer("mapper2d")
        return [status["scans"], status["dropped"]]

    def set_back() -> None:
        jumps: list[None] = []
        withdraw = SYSTEM_CLOCK.on_jump(lambda: jumps.append(None))  # notified after the module
        with monkeypatch.context() as system:
            system.setattr(SYSTEM_CLOCK, "_wall", lambda: time.time_ns() - 10 * S)
            SYSTEM_CLOCK.check()  # the clock's own thread may be checking, too
            until(lambda: jumps, "the clock was set back")
        SYSTEM_CLOCK.check()
        until(lambda: len(jumps) > 1, "the clock has its own time again")
        withdraw()
        host.loop.call(lambda: None)

    with Writer(naming=place.names) as writer:
        writer.connect("/mapper2D/laser:i")

        def scan() -> None:
            """Write a scan stamped with a time at which no pose is known."""
            message = LaserScan2D(0.0, 360.0, 0.1, 20.0, Vector([RADIUS] * BEAMS), 1)
            assert writer.write(message, envelope=f"1 {now[0] / S + 1.0:.9f}", strict=True) == 1
            until(receives_scans, "the scan arrives")

        assert not receives_scans()
        scans, dropped = counts()
        scan()
        assert counts() == [scans, dropped], "the scan waits"
        now[0] -= 20 * S
        until(lambda: counts() == [scans, dropped + 1], "the scan is dropped")
        assert not receives_scans()
        scan()
        set_back()
        assert not receives_scans()
        now[0] += 5 * S
        scan()
        assert counts() == [scans, dropped + 1], "the previous scan was discarded"
        set_back()
