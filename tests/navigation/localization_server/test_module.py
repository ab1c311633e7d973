"""The module on a hub and on YARP, with each kind of source."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
import pytest

from bridge.modules import worker as modules_worker
from navigation.localization_server.estimate import POSE_COVARIANCE
from navigation.maps.grid import same_walls, to_grid, yaw_of
from navigation.messages import pose_message, stamp_ns
from navigation.pose import Pose
from tests.peers.hub.modules import Place
from tests.peers.navigation.localization import OK, messages_on, near, reports, start_publisher, started, status_of, use
from tests.peers.sim.laboratory import LATCHED, Robot
from tests.support.wait import until
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.localization2d import Localization2DClient, LocalizationStatusEnum
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Reader
from yarp_compat.sig.matrix import Matrix


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0), (math.nan, 0.0, 0.0, 1.0)])
def test_a_start_pose_whose_quaternion_is_not_a_rotation_is_ignored(
    place: Place, robot: Robot, caplog: pytest.LogCaptureFixture, rotation: tuple[float, ...]
) -> None:
    """The same rule applies to goals; without it, a zero quaternion would mean yaw 0."""
    started(place, robot)
    until(reports(place, "not_yet_localized", "no initial pose"), "the module waits for an initial pose", 20)
    pose = {**pose_message(robot.pose), "orientation": dict(zip("xyzw", rotation, strict=True))}
    start = {"header": {"frame_id": "map"}, "pose": {"pose": pose, "covariance": [0.0] * 36}}
    out = place.far.advertise("/initialpose", POSE_COVARIANCE.replace("/msg", ""))
    error = "/initialpose: ignored: the initial pose's quaternion is not a rotation: its length is"
    until(lambda: error in caplog.text or place.far.publish(out, start), "the initial pose is ignored", 20, every=0.2)
    assert status_of(place)["localization"] == "not_yet_localized"
    publish_start = start_publisher(place, robot.pose)
    until(lambda: reports(place, OK)() or publish_start(), "the next start is accepted", 20, every=0.5)


def test_our_localizer_serves_all_sides(place: Place, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modules_worker, "STOP_SECONDS", 60.0)  # the module's thread may begin late to stop it
    poses = place.far.subscribe("/localization/pose", "geometry_msgs/PoseWithCovarianceStamped")
    statuses = place.far.subscribe("/localization/status", "std_msgs/String", latched=True)
    clouds = place.far.subscribe("/localization/particles", "geometry_msgs/PoseArray", latched=True)
    frames = place.far.subscribe("/tf", "tf2_msgs/TFMessage")
    started(place, robot, particles_period=0.2)
    until(reports(place, "not_yet_localized", "no initial pose"), "the module waits for an initial pose", 20)
    true = robot.pose
    start_publisher(place, true, frame="odom")()  # an initial pose in another frame is ignored
    publish_start = start_publisher(place, true @ Pose(0.4, -0.3, 0.2))
    until(lambda: reports(place, OK)() or publish_start(), "the start is accepted", 20, every=0.5)
    until(near(place, true), "the pose is the true one", 20)
    until(lambda: {"data": OK} in place.far.wait(statuses, 1), "the status is published", 20)

    def published() -> bool:
        newest = place.far.wait(poses, 1)[-1]
        at = newest["pose"]["pose"]["position"]
        close = true.distance(Pose(at["x"], at["y"], 0.0)) < 0.15
        return close and newest["header"]["frame_id"] == "map" and 0.0 < newest["pose"]["covariance"][0] < 0.1

    until(published, "the pose is published", 20)

    def corrected() -> bool:
        """Return whether map to odom, combined with the odometry, gives the true pose."""
        for message in reversed(place.far.wait(frames, 1)):
            for transform in message["transforms"]:
                if transform["child_frame_id"] == "odom":
                    at, rotation = transform["transform"]["translation"], transform["transform"]["rotation"]
                    return (Pose(at["x"], at["y"], yaw_of(rotation)) @ robot.odometry).distance(true) < 0.15
        return False

    until(corrected, "the correction is on /tf", 20)

    def ahead() -> bool:
        """Return whether transforms are half a second ahead of the poses, more than a period and any usual delay."""
        times = {stamp_ns(message["header"]) for message in place.far.wait(poses, 1)}
        transforms = [frame for message in place.far.wait(frames, 1) for frame in message["transforms"]]
        return any(stamp_ns(t["header"]) - 500_000_000 in times for t in transforms if t["child_frame_id"] == "odom")

    until(ahead, "transforms are ahead of the poses", 20)

    def cloud_published() -> bool:
        cloud = place.far.wait(clouds, 1)[-1]["poses"]
        return len(cloud) == 1000 and abs(np.mean([p["position"]["x"] for p in cloud]) - true.x) < 0.2

    until(cloud_published, "the particles are published", 20)
    robot.silent = {"scan"}
    until(reports(place, "error", "the laser is silent"), "a silent laser is reported", 20)
    robot.silent = {"odometry"}
    until(reports(place, "error", "odometry is silent"), "silent odometry is reported", 20)
    robot.silent = set()
    until(reports(place, OK), "the robot is localized again", 20)
    before = len(place.far.wait(statuses, 1))
    robot.carry(6.6, 0.8, 1.5)
    until(lambda: {"data": "error"} in place.far.wait(statuses, 1)[before:], "a lost robot is reported", 20)
    until(near(place, robot.pose), "the robot is located again", 20)
    place.worker.stop()
    until(
        lambda: place.far.wait(statuses, 1)[-1] == {"data": "not_yet_localized"},
        "the end of localization is reported",
        20,
    )


def test_a_carried_robot_is_reported_as_lost_at_any_pose_period(place: Place, robot: Robot) -> None:
    statuses = place.far.subscribe("/localization/status", "std_msgs/String", latched=True)
    true = robot.pose
    started(place, robot, period=5.0, initial_pose=[*true[:2], math.degrees(true.theta)])
    until(lambda: {"data": OK} in place.far.wait(statuses, 1), "the robot is localized")
    before = len(place.far.wait(statuses, 1))
    robot.carry(6.6, 0.8, 1.5)
    until(lambda: {"data": "error"} in place.far.wait(statuses, 1)[before:], "the robot is lost")
    until(lambda: place.far.wait(statuses, 1)[-1] == {"data": OK}, "the robot is located again")


def test_localization_continues_at_the_last_pose(place: Place, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modules_worker, "STOP_SECONDS", 60.0)  # the module's thread may begin late to stop it
    true = robot.pose
    wrong = {"initial_pose": [3.0, 3.0, 0.0]}
    started(place, robot, initial_pose=[*true[:2], math.degrees(true.theta)])
    until(reports(place, OK), "the robot is localized", 20)
    place.worker.stop()
    robot.silent = {"scan"}  # so that only the stored pose can give the result
    out = robot.node.publisher("/map", "nav_msgs/msg/OccupancyGrid", LATCHED, priority="state")
    out.publish(to_grid(robot.grid))
    section = {"enabled": True, "map": "/map", "period": 0.05, **wrong}
    place.worker.start(place.config(modules={"localization_server": section}, store={}))
    until(near(place, true), "localization starts at the last pose, not at initial_pose", 20)
    robot.silent = set()
    until(reports(place, OK), "the robot is localized on the topic's map", 20)
    until(lambda: status_of(place)["updates"], "scans are used", 20)
    robot.silent = {"scan"}  # so that only a restart of the localizer changes its count of updates
    until(reports(place, "error", "the laser is silent"), "no further scan arrives", 20)
    updates, maps = status_of(place)["updates"], messages_on(place, "/map")
    repeated = to_grid(robot.grid)  # mapping programs publish their map again every other second
    repeated["info"]["resolution"] = float(np.float32(repeated["info"]["resolution"]))
    out.publish(repeated)
    until(lambda: messages_on(place, "/map") > maps, "the map arrives again", 20)
    place.worker.running("localization_server").host.loop.call(lambda: None)
    assert status_of(place)["updates"] == updates
    robot.grid.flags[:5, :5] = MapFlag.WALL
    out.publish(to_grid(robot.grid))
    until(lambda: status_of(place)["updates"] == 0, "a map with other walls is used", 20)
    robot.silent = set()
    until(lambda: status_of(place)["updates"], "the localizer uses scans again", 20)
    until(near(place, true), "localization continues at the last pose", 20)


def test_status_requests_do_not_query_the_source(place: Place, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    started(place, robot)
    server: Any = place.worker.running("localization_server").module
    threads: list[str] = []
    estimate, cloud = server.source.estimate, server.source.cloud
    monkeypatch.setattr(
        server.source, "estimate", lambda: (threads.append(threading.current_thread().name), estimate())[1]
    )
    monkeypatch.setattr(server.source, "cloud", lambda: (threads.append(threading.current_thread().name), cloud())[1])
    until(lambda: server.health().state == "running", "the module has a map")
    assert server.status().document()["localization"] == "not_yet_localized"
    until(lambda: threads, "the module polls its source")
    assert set(threads) == {"midspan-localization_server"}


def test_areas_drawn_on_a_map_do_not_restart_localization() -> None:
    original = MapGrid2D.of(np.zeros((4, 4), np.uint8), name="lab")
    for flag, same in ((MapFlag.KEEP_OUT, True), (MapFlag.WALL, False), (MapFlag.UNKNOWN, False)):
        other = MapGrid2D.of(np.zeros((4, 4), np.uint8), name="lab")
        other.flags[1, 2] = flag
        assert same_walls(original, other) is same


def test_yarp_ports_serve_the_pose(place: Place, robot: Robot) -> None:
    started(place, robot)
    true = robot.pose
    start = Map2DLocation("lab", true.x + 0.2, true.y, math.degrees(true.theta) + 5.0)
    with NameServer(port=place.port, gc_seconds=0):
        until(lambda: place.names.query("/localizationServer/odometry:o"), "the ports are registered", 20)
        until(lambda: "waiting" not in str(status_of(place).get("ports")), "all ports are open", 20)
        until(lambda: status_of(place).get("map") == "lab", "the map is loaded", 20)
        until(lambda: status_of(place).get("scans", 0) > 0, "scans arrive", 20)
        with (
            Reader("/test/where:i", naming=place.names) as where,
            Reader("/test/odometry:i", naming=place.names) as odometry,
            Localization2DClient("/localization2D_nws_yarp", naming=place.names) as client,
        ):
            connections.connect(place.names, "/localizationServer/streaming:o", "/test/where:i")
            connections.connect(place.names, "/localization2D_nws_yarp/odometry:o", "/test/odometry:i")
            first = where.read()
            assert first is not None
            assert math.isnan(first.values[1])  # the pose is not known yet
            location, covariance = Map2DLocation(), Matrix()
            assert not client.getCurrentPosition(location, covariance)
            assert client.setInitialPose(start)

            def localized() -> bool:
                return client.getLocalizationStatus() is LocalizationStatusEnum.localization_status_localized_ok

            until(localized, "the robot is localized", 20)
            until(near(place, true), "the pose is the true one", 20)
            until(lambda: client.getCurrentPosition(location, covariance), "the pose is known", 20)
            assert location.map_id == "lab"
            assert math.hypot(location.x - true.x, location.y - true.y) < 0.15
            assert abs(math.remainder(location.theta - math.degrees(true.theta), 360.0)) < 5.0
            assert covariance.numpy().shape == (3, 3)
            assert 0.0 < covariance.numpy()[0, 0] < 1.0
            poses = client.getEstimatedPoses()
            assert len(poses) == 500
            assert abs(np.mean([pose.y for pose in poses]) - true.y) < 0.2

            def streamed() -> bool:
                pose = where.read()
                return pose is not None and abs(pose.values[2] - true.y) < 0.15 and pose.envelope != ""

            until(streamed, "the pose is streamed", 20)
            moved = odometry.read()
            while moved is not None and math.isnan(moved.values[0]):
                moved = odometry.read()
            assert moved is not None
            assert len(moved.values) == 9
            assert moved.values[2] == pytest.approx(math.degrees(true.theta), abs=5.0)
            assert moved.values[3:] == pytest.approx([0.0] * 6, abs=1e-3)
            assert isinstance(client.getEstimatedOdometry(), OdometryData)
            assert client.stopLocalizationService()
            until(reports(place, "not_yet_localized", "is stopped"), "localization is stopped", 20)
            assert client.startLocalizationService()
            until(localized, "the robot is localized again", 20)
            assert not client.setInitialPose(Map2DLocation("nowhere", 0.0, 0.0, 0.0))
            use(place, "lab2", robot)
            until(lambda: status_of(place).get("map") == "lab2", "the module uses the other map", 20)
            until(localized, "the robot is localized on the other map", 20)
            assert client.setInitialPose(Map2DLocation("lab", true.x, true.y, math.degrees(true.theta)))
            until(lambda: status_of(place).get("map") == "lab", "the module uses the map of the initial pose", 20)
