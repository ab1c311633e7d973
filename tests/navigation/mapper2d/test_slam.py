"""Mapper2D with poses from the scans: the drawn map, its graph in a file, and the module on a hub."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bridge.messages.scan import LaserScan
from bridge.modules.host import Host
from navigation.algorithms.loops import LoopSearch
from navigation.algorithms.slam import at_once
from navigation.algorithms.submaps import Scan
from navigation.mapper2d import drawn as drawn_module
from navigation.mapper2d import graph_file
from navigation.mapper2d.drawn import DrawnMap
from navigation.mapper2d.mapper import Mapper
from navigation.mapper2d.poses import Poses
from navigation.mapper2d.section import Mapper2DSection
from navigation.mapper2d.source import MatchedPoses
from navigation.pose import Pose
from tests.navigation.algorithms.scanned import Laser, Seen, corridor, drive
from tests.peers.hub.modules import Place
from tests.support.wait import until
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

SEGMENTS = corridor()
AROUND = 28.0
S = 1_000_000_000


@pytest.fixture(scope="module")
def driven() -> list[Seen]:
    return list(drive(Laser(SEGMENTS), AROUND))


def mapping() -> DrawnMap:
    return DrawnMap(Mapper(Mapper2DSection(width=14.0, height=10.0, farthest=8.0)))


def draw(drawn: DrawnMap, driven: list[Seen]) -> None:
    for number, seen in enumerate(driven):
        drawn.scan(seen.odometry._replace(stamp_ns=number * S // 5), seen.scan)
        drawn.work()


def far_off(grid: MapGrid2D) -> float:
    """Return the share of a map's walls that are more than two cells away from the corridor's."""
    rows, columns = np.nonzero(grid.flags == MapFlag.WALL)
    points = grid.centers_of(np.stack((columns, rows), -1))
    start, vectors = SEGMENTS[:, :2], SEGMENTS[:, 2:] - SEGMENTS[:, :2]
    along = ((points[:, None] - start) * vectors).sum(-1) / (vectors * vectors).sum(-1)
    nearest = start + np.clip(along, 0.0, 1.0)[..., None] * vectors
    distances = np.linalg.norm(points[:, None] - nearest, axis=-1).min(axis=1)
    return float((distances > 2.0 * grid.resolution).mean())


def test_the_drawn_map_is_right_after_the_loop(driven: list[Seen], tmp_path: Path) -> None:
    drawn = mapping()
    drawn.locate(driven[0].truth)
    draw(drawn, driven)
    at = driven[-1].truth
    drawn.mapper.paint((at.x, at.y), MapFlag.KEEP_OUT, 3)
    drawn.finish()
    grid = drawn.mapper.grid()
    assert (grid.flags == MapFlag.WALL).sum() > 500
    assert far_off(grid) < 0.01
    assert (grid.flags == MapFlag.KEEP_OUT).sum() == 9

    # a later run starts from a place that is only roughly known
    path = tmp_path / "map.graph.npz"
    graph_file.write(path, drawn.saved())
    again = mapping()
    again.load(grid, path)
    assert again.slam.unsure is not None
    guess = driven[30].truth @ Pose(0.4, 0.2, -0.2)
    again.locate(guess)
    draw(again, driven[30:90])
    assert again.slam.pose.distance(driven[89].truth) < 0.05
    again.finish()
    grown = again.mapper.grid()
    assert far_off(grown) < 0.01
    assert (grown.flags == MapFlag.KEEP_OUT).sum() == 9
    assert len(again.slam.submaps.views) > len(drawn.slam.submaps.views)


def test_scans_at_an_unknown_place_are_not_saved_with_a_loaded_map(driven: list[Seen], tmp_path: Path) -> None:
    drawn, path = mapping(), tmp_path / "map.graph.npz"
    drawn.locate(driven[0].truth)
    draw(drawn, driven[:20])
    graph_file.write(path, drawn.saved())
    again = mapping()
    again.load(drawn.mapper.grid(), path)
    again.scan(driven[10].odometry, driven[10].scan)
    assert again.slam.unsure is not None
    graph_file.write(path, again.saved())
    before, after = drawn.slam.submaps, graph_file.read(path).submaps
    assert [pose[:3] for pose in after.graph.poses] == [pose[:3] for pose in before.graph.poses]
    assert (len(after.views), len(after.graph.edges)) == (len(before.views), len(before.graph.edges))


def test_a_map_whose_poses_change_while_it_is_drawn_is_drawn_again_for_saving(
    driven: list[Seen], monkeypatch: pytest.MonkeyPatch
) -> None:
    away = Pose(0.0, 0.3, 0.0)
    drawn = mapping()
    drawn.locate(away @ driven[0].truth)
    draw(drawn, driven[:60])
    monkeypatch.setattr(drawn_module, "_SLICE", len(drawn.slam.submaps.views) // 2)
    drawn.draw_again()
    drawn.work()
    poses = drawn.slam.submaps.graph.poses
    poses[:] = [away.inverse @ pose for pose in poses]  # as after a closed loop
    drawn.finish()
    assert far_off(drawn.mapper.grid()) < 0.02


def test_a_map_moves_with_the_robot_that_is_set_elsewhere(driven: list[Seen]) -> None:
    drawn = mapping()
    draw(drawn, driven[:30])
    drawn.locate(driven[29].truth)
    drawn.finish()
    assert far_off(drawn.mapper.grid()) < 0.02
    drawn.clear()
    assert drawn.slam.pose.distance(driven[29].truth) < 0.01
    assert not (drawn.mapper.grid().flags == MapFlag.WALL).any()


class Recorded:
    """The odometry of recorded scans, whose stamps are their indices."""

    corrected = False

    def __init__(self, driven: list[Seen]) -> None:
        self._driven = driven

    def mount(self, _frame: str) -> Pose:
        return Pose(0.0, 0.0, 0.0)

    def odometry(self, stamp: int) -> Pose:
        return self._driven[stamp].odometry


def matched(driven: list[Seen]) -> tuple[MatchedPoses, Callable[[int], object]]:
    """Return a source of poses that matches recorded scans, and a function that adds the scan with an index."""
    section = Mapper2DSection(width=14.0, height=10.0, farthest=8.0, publish_tf=False)
    poses, host = Recorded(driven), SimpleNamespace(background=SimpleNamespace(submit=at_once, trouble=""))
    source = MatchedPoses(cast("Host", host), section, Mapper(section), cast("Poses", poses))

    def add(number: int) -> object:
        scan = driven[number].scan
        return source.add("laser", LaserScan(number, scan.first, scan.step, 0.05, scan.farthest, scan.ranges))

    return source, add


def test_a_pose_that_is_set_before_mapping_starts_moves_with_the_robot(driven: list[Seen]) -> None:
    source, add = matched(driven)
    source.locate(driven[0].truth)
    source._mapper.mapping = False
    for number in range(20):
        add(number)
    source._mapper.mapping = True
    add(20)
    assert source.drawn.slam.pose.distance(driven[20].truth) < 0.1


def test_a_new_map_continues_at_the_pose_on_the_previous_one(driven: list[Seen]) -> None:
    source, add = matched(driven)
    source.locate(driven[0].truth)
    for number in range(20):
        add(number)
    source.clear()
    add(20)
    assert source.drawn.slam.pose.distance(driven[20].truth) < 0.05
    assert len(source.drawn.slam.submaps.views) == 1


def test_scans_move_the_robot_but_not_the_map_while_mapping_is_stopped(driven: list[Seen]) -> None:
    drawn = mapping()
    drawn.locate(driven[0].truth)
    draw(drawn, driven[:30])
    drawn.mapper.mapping = False
    views = len(drawn.slam.submaps.views)
    draw(drawn, driven[30:40])
    assert len(drawn.slam.submaps.views) == views
    assert drawn.slam.pose.distance(driven[39].truth) < 0.03


@pytest.mark.parametrize("spoil", ["text", "nan", "owner", "beams", "deflated"])
def test_an_invalid_file_is_refused(driven: list[Seen], tmp_path: Path, spoil: str) -> None:
    drawn = mapping()
    draw(drawn, driven[:3])
    path = tmp_path / "map.graph.npz"
    graph_file.write(path, drawn.saved())
    with np.load(path) as loaded:
        arrays = dict(loaded)
    if spoil == "nan":
        arrays["poses"][0, 0] = math.nan
    elif spoil == "owner":
        arrays["submaps"][0] = 7
    elif spoil == "beams":
        arrays["beams"][0] += 1
    if spoil == "text":
        path.write_text("not an archive")
    elif spoil == "deflated":
        data = bytearray(path.read_bytes())
        names, extras = data[26] + 256 * data[27], data[28] + 256 * data[29]
        data[30 + names + extras] = 255  # an invalid block after the header of the first file
        path.write_bytes(data)
    else:
        np.savez(path, **arrays)
    with pytest.raises(ValueError, match=r"cannot read the graph of the map, map\.graph\.npz"):
        graph_file.read(path)


def test_the_module_publishes_the_odometry_on_the_map(
    driven: list[Seen], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = {"enabled": True, "period": 0.1, "farthest": 8.0, "laser": [0.0, 0.0, 0.0]}
    with Place(tmp_path) as place:
        place.worker.start(place.config(modules={"mapper2d": section}))
        scans = place.far.advertise("/scan", "sensor_msgs/LaserScan")
        frames = place.far.advertise("/tf", "tf2_msgs/TFMessage")
        corrections = place.far.subscribe("/tf", "tf2_msgs/TFMessage", depth=100)
        first = driven[0]

        def corrected(seen: Seen, truth: Pose) -> bool:
            now = time.time_ns()
            stamp = {"sec": now // S, "nanosec": now % S}
            place.far.publish(frames, {"transforms": [odometry(seen.odometry, stamp)]})
            place.far.publish(scans, message(seen.scan, stamp))
            received = [tf for m in place.far.wait(corrections, 1, 0.1)[-5:] for tf in m["transforms"]]
            on_map = [pose_of(tf) for tf in received if tf["header"]["frame_id"] == "map"]
            return any((pose @ seen.odometry).distance(truth) < 0.02 for pose in on_map)

        for seen in driven[:60:2]:
            # at the first scan, the map's frame coincides with the odometry frame
            truth = first.odometry @ (first.truth.inverse @ seen.truth)
            until(lambda seen=seen, truth=truth: corrected(seen, truth), "the robot is at its place on the map", 40)
        assert seen.odometry.distance(truth) > 0.1
        assert place.answer("mapper2d")["submaps"] >= 1
        reply = place.far.call("/dynamic_map", "nav_msgs/GetMap").result(20)["reply"]["map"]
        assert (reply["header"]["frame_id"], 100 in reply["data"]) == ("map", True)

        # several updates at one simulated time publish one transform
        running, now = place.worker.running("mapper2d"), time.time_ns() + S
        with monkeypatch.context() as still:
            still.setattr(running.host.clock, "now_ns", lambda: now)
            for _ in range(3):
                running.host.loop.call(running.module.source.work)
        stamp = {"sec": (now + S // 2) // S, "nanosec": (now + S // 2) % S}  # tf_tolerance ahead of now

        def stamps() -> list[Any]:
            return [m["transforms"][0]["header"]["stamp"] for m in place.far.wait(corrections, 1)]

        until(lambda: stamp in stamps() and stamps()[-1] != stamp, "the transform and the next one arrive", 20)
        assert stamps().count(stamp) == 1

        def contradicted() -> bool:
            now = time.time_ns()
            stamp = {"sec": now // S, "nanosec": now % S}
            both = [odometry(seen.odometry, stamp), localized(stamp)]
            place.far.publish(frames, {"transforms": both})
            place.far.publish(scans, message(seen.scan, stamp))
            return "a localizer publishes the transform" in place.worker.running("mapper2d").health().text

        until(contradicted, "another program's transform is reported", 20)


def test_scans_are_mapped_while_loops_are_searched_and_a_failed_search_is_reported(
    driven: list[Seen], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, free = threading.Event(), threading.Event()

    def search(*_arguments: Any) -> None:
        begun.set()
        assert free.wait(60.0)
        raise ValueError("no solution")

    monkeypatch.setattr(LoopSearch, "search", search)
    section = {"enabled": True, "farthest": 8.0, "laser": [0.0, 0.0, 0.0]}
    with Place(tmp_path) as place:
        place.worker.start(place.config(modules={"mapper2d": section}))
        scans = place.far.advertise("/scan", "sensor_msgs/LaserScan")
        frames = place.far.advertise("/tf", "tf2_msgs/TFMessage")
        left = iter(driven)

        def drive_on() -> None:
            seen, now = next(left), time.time_ns()
            stamp = {"sec": now // S, "nanosec": now % S}
            place.far.publish(frames, {"transforms": [odometry(seen.odometry, stamp)]})
            place.far.publish(scans, message(seen.scan, stamp))

        until(lambda: begun.is_set() or drive_on(), "a search begins", 40, every=0.05)
        views = place.answer("mapper2d")["views"]
        until(lambda: drive_on() or place.answer("mapper2d")["views"] > views + 3, "scans are mapped", 40, every=0.05)
        assert place.worker.running("mapper2d").health().state == "running"
        free.set()
        failed = "the search for loops failed (ValueError: no solution)"
        until(lambda: failed in place.worker.running("mapper2d").health().text, "the error is reported", 40)


def localized(stamp: dict[str, int]) -> dict[str, Any]:
    header = {"stamp": stamp, "frame_id": "map"}
    return {"header": header, "child_frame_id": "odom", "transform": {"rotation": {"w": 1.0}}}


def odometry(pose: Pose, stamp: dict[str, int]) -> dict[str, Any]:
    half = 0.5 * pose.theta
    place = {"translation": {"x": pose.x, "y": pose.y}, "rotation": {"z": math.sin(half), "w": math.cos(half)}}
    header = {"stamp": stamp, "frame_id": "odom"}
    return {"header": header, "child_frame_id": "base_link", "transform": place}


def pose_of(frame: dict[str, Any]) -> Pose:
    place, rotation = frame["transform"]["translation"], frame["transform"]["rotation"]
    return Pose(place["x"], place["y"], 2.0 * math.atan2(rotation["z"], rotation["w"]))


def message(scan: Scan, stamp: dict[str, int]) -> dict[str, Any]:
    limits = {"range_min": 0.1, "range_max": 8.0, "angle_min": scan.first, "angle_increment": scan.step}
    return {"header": {"stamp": stamp, "frame_id": "laser"}, **limits, "ranges": scan.ranges.tolist()}
