"""The module on a hub and on YARP, with each kind of source."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.config.model import Config
from bridge.hub.wire.qos import Qos
from bridge.modules.worker import Running
from bridge.stores.kinds import MAP
from navigation.localization_server.estimate import POSE_COVARIANCE, spatial
from navigation.localization_server.module import LocalizationServer
from navigation.maps.grid import from_grid, same_walls, to_grid, yaw_of
from navigation.messages import pose_message, stamp_ns
from navigation.pose import Pose, wrapped
from tests.peers.hub.modules import Place
from tests.peers.sim.laboratory import LATCHED, Robot
from tests.support.wait import until
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.localization2d import Localization2DClient, LocalizationStatusEnum
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Reader, Writer
from yarp_compat.sig.matrix import Matrix

OK = "localized_ok"


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as place:
        yield place


@pytest.fixture
def robot(place: Place) -> Iterator[Robot]:
    standing = Robot(place.far.hub, place.far.registry)
    yield standing
    standing.close()


def started(place: Place, robot: Robot, **section: Any) -> None:
    """Start the module, with the laboratory in the store."""
    config = place.config(modules={"localization_server": {"enabled": True, "period": 0.05, **section}}, store={})
    place.worker.start(config)
    use(place, robot.grid.name, robot)


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("nowhere.at:All", "cannot be imported: No module named 'nowhere'"),
        ("collections:Counter", "is not a subclass of navigation.localization_server.sources.PoseSource"),
    ],
)
def test_an_invalid_class_as_source_is_reported(place: Place, source: str, reason: str) -> None:
    place.worker.start(place.config(modules={"localization_server": {"enabled": True, "source": source}}, store={}))
    assert f"the source of poses: {source} {reason}" in place.worker.running("localization_server").health().text


def use(place: Place, name: str, robot: Robot) -> None:
    robot.grid.m_map_name = name
    place.worker.store.put(MAP, name, robot.grid)
    place.worker.store.use_map(name)


def status_of(place: Place) -> Any:
    """Return the module's status document, a dictionary."""
    return place.answer("localization_server")


def messages_on(place: Place, topic: str) -> int:
    """Return how many messages the module has received on a topic."""
    return sum(end["messages"] for end in status_of(place)["topics"] if end["topic"] == topic)


def reports(place: Place, status: str, reason: str = "") -> Callable[[], bool]:
    """Return a check that the module reports a status, with a reason that contains the given text."""

    def check() -> bool:
        document = status_of(place)
        return document["localization"] == status and reason in document["reason"]

    return check


def near(place: Place, pose: Pose, meters: float = 0.15) -> Callable[[], bool]:
    """Return a check that the module's pose is close to a pose."""

    def check() -> bool:
        estimate = status_of(place).get("pose")
        return (
            bool(estimate) and pose.distance(Pose(*estimate)) < meters and abs(wrapped(estimate[2] - pose.theta)) < 0.1
        )

    return check


def start_publisher(place: Place, pose: Pose, covariance: Any = None, frame: str = "map") -> Callable[[], None]:
    """Return a function that publishes a start pose."""
    out = place.far.advertise("/initialpose", POSE_COVARIANCE.replace("/msg", ""))
    covariance = np.zeros(36) if covariance is None else spatial(covariance)
    message = {
        "header": {"frame_id": frame},
        "pose": {"pose": pose_message(pose), "covariance": covariance.tolist()},
    }
    return lambda: place.far.publish(out, message)


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0), (math.nan, 0.0, 0.0, 1.0)])
def test_a_start_pose_whose_quaternion_is_not_a_rotation_is_ignored(
    place: Place, robot: Robot, caplog: pytest.LogCaptureFixture, rotation: tuple[float, ...]
) -> None:
    """As for goals; a zero quaternion would otherwise mean yaw 0."""
    started(place, robot)
    until(reports(place, "not_yet_localized", "no start pose"), "the module waits for a start pose", 20)
    pose = {**pose_message(robot.pose), "orientation": dict(zip("xyzw", rotation, strict=True))}
    start = {"header": {"frame_id": "map"}, "pose": {"pose": pose, "covariance": [0.0] * 36}}
    out = place.far.advertise("/initialpose", POSE_COVARIANCE.replace("/msg", ""))
    error = "/initialpose: ignored: the start pose's quaternion is not a rotation: its length is"
    until(lambda: error in caplog.text or place.far.publish(out, start), "the start pose is ignored", 20, every=0.2)
    assert status_of(place)["localization"] == "not_yet_localized"
    publish_start = start_publisher(place, robot.pose)
    until(lambda: reports(place, OK)() or publish_start(), "the next start is accepted", 20, every=0.5)


def test_our_localizer_serves_all_sides(place: Place, robot: Robot) -> None:
    poses = place.far.subscribe("/localization/pose", "geometry_msgs/PoseWithCovarianceStamped")
    statuses = place.far.subscribe("/localization/status", "std_msgs/String", latched=True)
    clouds = place.far.subscribe("/localization/particles", "geometry_msgs/PoseArray", latched=True)
    frames = place.far.subscribe("/tf", "tf2_msgs/TFMessage")
    started(place, robot, particles_period=0.2)
    until(reports(place, "not_yet_localized", "no start pose"), "the module waits for a start pose", 20)
    true = robot.pose
    start_publisher(place, true, frame="odom")()  # is ignored
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
        """Whether map to odom, combined with the odometry, gives the true pose."""
        for message in reversed(place.far.wait(frames, 1)):
            for transform in message["transforms"]:
                if transform["child_frame_id"] == "odom":
                    at, rotation = transform["transform"]["translation"], transform["transform"]["rotation"]
                    return (Pose(at["x"], at["y"], yaw_of(rotation)) @ robot.odometry).distance(true) < 0.15
        return False

    until(corrected, "its correction is on /tf", 20)

    def ahead() -> bool:
        """Whether transforms are half a second ahead of the poses, more than a period and any usual delay."""
        times = {stamp_ns(message["header"]) for message in place.far.wait(poses, 1)}
        transforms = [frame for message in place.far.wait(frames, 1) for frame in message["transforms"]]
        return any(stamp_ns(t["header"]) - 500_000_000 in times for t in transforms if t["child_frame_id"] == "odom")

    until(ahead, "its transforms are ahead of the poses", 20)

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
    until(lambda: place.far.wait(statuses, 1)[-1] == {"data": "not_yet_localized"}, "its end is reported", 20)


def test_a_carried_robot_is_reported_as_lost_at_any_pose_period(place: Place, robot: Robot) -> None:
    statuses = place.far.subscribe("/localization/status", "std_msgs/String", latched=True)
    true = robot.pose
    started(place, robot, period=5.0, initial_pose=[*true[:2], math.degrees(true.theta)])
    until(lambda: {"data": OK} in place.far.wait(statuses, 1), "the robot is localized")
    before = len(place.far.wait(statuses, 1))
    robot.carry(6.6, 0.8, 1.5)
    until(lambda: {"data": "error"} in place.far.wait(statuses, 1)[before:], "it is lost")
    until(lambda: place.far.wait(statuses, 1)[-1] == {"data": OK}, "the robot is located again")


def test_localization_continues_at_the_last_pose(place: Place, robot: Robot) -> None:
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
    until(near(place, true), "it starts at its last pose, not at initial_pose", 20)
    robot.silent = set()
    until(reports(place, OK), "it is localized on the topic's map", 20)
    until(lambda: status_of(place)["updates"], "scans are used", 20)
    robot.silent = {"scan"}  # so that a restart of the localizer shows in its updates
    until(reports(place, "error", "the laser is silent"), "no further scan arrives", 20)
    updates, maps = status_of(place)["updates"], messages_on(place, "/map")
    repeated = to_grid(robot.grid)  # mapping programs publish it every other second
    repeated["info"]["resolution"] = float(np.float32(repeated["info"]["resolution"]))
    out.publish(repeated)
    until(lambda: messages_on(place, "/map") > maps, "the map arrives again", 20)
    place.worker.running("localization_server").host.loop.call(lambda: None)
    assert status_of(place)["updates"] == updates
    robot.grid.flags[:5, :5] = MapFlag.WALL
    out.publish(to_grid(robot.grid))
    until(lambda: status_of(place)["updates"] == 0, "a map with other walls is used", 20)
    robot.silent = set()
    until(lambda: status_of(place)["updates"], "it uses scans again", 20)
    until(near(place, true), "it continues at its last pose", 20)


def test_status_requests_do_not_query_the_source(place: Place, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    started(place, robot)
    server: Any = place.worker.running("localization_server").module
    threads: list[str] = []
    estimate, cloud = server.source.estimate, server.source.cloud
    monkeypatch.setattr(
        server.source, "estimate", lambda: (threads.append(threading.current_thread().name), estimate())[1]
    )
    monkeypatch.setattr(server.source, "cloud", lambda: (threads.append(threading.current_thread().name), cloud())[1])
    until(lambda: server.health().state == "running", "it has a map")
    assert server.status()["localization"] == "not_yet_localized"
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
            assert math.isnan(first.values[1])  # not known yet
            location, covariance = Map2DLocation(), Matrix()
            assert not client.getCurrentPosition(location, covariance)
            assert client.setInitialPose(start)

            def localized() -> bool:
                return client.getLocalizationStatus() is LocalizationStatusEnum.localization_status_localized_ok

            until(localized, "the robot is localized", 20)
            until(near(place, true), "the pose is the true one", 20)
            assert client.getCurrentPosition(location, covariance)
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
            until(lambda: status_of(place).get("map") == "lab2", "it uses the other map", 20)
            until(localized, "it is localized there", 20)
            assert client.setInitialPose(Map2DLocation("lab", true.x, true.y, math.degrees(true.theta)))
            until(lambda: status_of(place).get("map") == "lab", "it uses the map of the start", 20)


def test_the_pose_of_amcl_is_served(place: Place, robot: Robot) -> None:
    maps: list[dict[str, Any]] = []

    def set_map(request: dict[str, Any], answer: Any) -> None:
        maps.append(request)
        answer({"success": True})

    starts: list[dict[str, Any]] = []
    robot.node.server("/set_map", "nav_msgs/srv/SetMap", set_map)
    robot.node.subscription("/initialpose", POSE_COVARIANCE, starts.append, Qos(depth=5))
    covariance = np.diag([0.04, 0.09, 0.01])
    amcl = robot.node.publisher("/amcl_pose", POSE_COVARIANCE, LATCHED, priority="state")
    amcl.publish({"header": {"frame_id": "map"}, "pose": {"covariance": spatial(covariance)}})
    cloud = robot.node.publisher("/particlecloud", "geometry_msgs/msg/PoseArray", LATCHED, priority="state")
    cloud.publish({"poses": [pose_message(Pose(1.0, 2.0, 0.5))] * 7})
    started(place, robot, source="amcl")
    until(reports(place, "not_yet_localized", "no transform from odom to map"), "it waits for the frames", 20)
    robot.localized = Pose(1.0, 2.0, 0.5)
    until(reports(place, OK), "amcl's frames arrive", 20)
    assert near(place, robot.localized @ robot.odometry, 0.01)()
    until(lambda: status_of(place)["particles"] == 7, "amcl's particles arrive", 20)
    weighted = robot.node.publisher("/particle_cloud", "nav2_msgs/msg/ParticleCloud", LATCHED, priority="state")
    weighted.publish({"particles": [{"pose": pose_message(Pose(1.0, 2.0, 0.5)), "weight": 0.2}] * 5})
    until(lambda: status_of(place)["particles"] == 5, "the particles of ROS 2's amcl arrive", 20)
    with NameServer(port=place.port, gc_seconds=0):
        until(lambda: place.names.query("/localization2D_nws_yarp/rpc"), "the port is registered", 20)
        until(lambda: "waiting" not in str(status_of(place).get("ports")), "all ports are open", 20)
        with Localization2DClient("/localization2D_nws_yarp", naming=place.names) as client:
            location, received_covariance = Map2DLocation(), Matrix()
            assert client.getCurrentPosition(location, received_covariance)
            assert received_covariance.numpy() == pytest.approx(covariance)
            start_location = Map2DLocation("lab", 3.0, 4.0, 90.0)
            until(lambda: bool(client.setInitialPose(start_location)), "the start is sent", 20)
            until(lambda: len(starts) > 0, "amcl receives it", 20)
            before = len(starts)
            assert client.setInitialPose(start_location, Matrix(3, 3))
            until(lambda: len(starts) > before, "amcl receives the second one", 20)
    for start in (starts[0], starts[-1]):
        assert start["header"]["frame_id"] == "map"
        assert yaw_of(start["pose"]["pose"]["orientation"]) == pytest.approx(math.pi / 2)
        assert start["pose"]["covariance"][[0, 35]] == pytest.approx([0.25, math.radians(15.0) ** 2])
    assert not maps  # amcl loads its first map itself
    use(place, "lab2", robot)
    until(lambda: len(maps) > 0, "amcl receives the other map", 20)
    assert from_grid(maps[-1]["map"], "lab2").flags.shape == robot.grid.flags.shape
    position = maps[-1]["initial_pose"]["pose"]["pose"]["position"]
    assert (robot.localized @ robot.odometry).distance(Pose(position["x"], position["y"], 0.0)) < 0.01
    for wide, status in ((3.0, "not_yet_localized"), (0.55, OK)):  # the second is that of starts from rviz
        spread = np.diag([wide**2, wide**2, 0.1])
        amcl.publish({"header": {"frame_id": "map"}, "pose": {"covariance": spatial(spread)}})
        until(reports(place, status, "" if status == OK else "over 3.0 m"), f"a spread of {wide} m is {status}", 20)
    before = len(maps)
    section = {"enabled": True, "period": 0.05, "source": "amcl"}
    assert place.worker.reload(
        place.config(modules={"localization_server": section}, navigation={"map": "/floor"}, store={})
    )
    robot.grid.flags[:5, :5] = MapFlag.WALL
    robot.node.publisher("/floor", "nav_msgs/msg/OccupancyGrid", LATCHED, priority="state").publish(to_grid(robot.grid))
    until(lambda: len(maps) > before, "amcl receives the map of another source, too", 20)
    assert (from_grid(maps[-1]["map"], "floor").flags == robot.grid.flags).all()
    robot.localized = None
    until(reports(place, "error", "localization is stale"), "a dead amcl is reported", 20)


def test_poses_from_a_topic_and_from_a_port(place: Place, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = place.far.subscribe("/tf", "tf2_msgs/TFMessage")
    section = {"enabled": True, "period": 0.05, "topic": "/uwb", "pose_age": 1.0}

    def by(source: str) -> Config:
        return place.config(navigation={"localizer": source}, modules={"localization_server": section}, store={})

    place.worker.start(by("topic"))
    until(reports(place, "not_yet_localized", "waiting for a pose on /uwb"), "it waits for poses", 20)
    out = place.far.advertise("/uwb", "geometry_msgs/PoseStamped")
    given = Pose(4.0, 5.0, 1.0)
    wrong = {"header": {"frame_id": "uwb"}, "pose": pose_message(given)}
    until(
        lambda: (place.far.publish(out, wrong), "frame 'uwb'" in status_of(place)["reason"])[1],
        "the frame is checked",
        20,
    )
    message = {"header": {"frame_id": "map"}, "pose": pose_message(given)}
    until(lambda: (place.far.publish(out, message), reports(place, OK)())[1], "poses are accepted", 20)
    assert near(place, given, 0.01)()
    corrected = lambda: "odom" in str(place.far.wait(frames, 1, 0.1))  # noqa: E731
    until(lambda: (place.far.publish(out, message), corrected())[1], "the correction is on /tf", 20)
    until(reports(place, "error", "/uwb has been silent for"), "silence is reported", 20)
    assert place.worker.reload(by("port"))  # one changed setting restarts nothing else
    with NameServer(port=place.port, gc_seconds=0), Writer("/test/pose:o", naming=place.names) as writer:
        until(lambda: place.names.query("/localizationServer/pose:i"), "the port is registered", 20)
        until(lambda: "waiting" not in str(status_of(place).get("ports")), "all ports are open", 20)
        writer.connect("/localizationServer/pose:i")
        until(
            lambda: (writer.write([1.0, "x"]), "invalid pose" in status_of(place)["reason"])[1],
            "an invalid value is reported",
            20,
        )
        location = Map2DLocation("lab", 2.0, 3.0, 90.0)
        until(lambda: (writer.write(location), near(place, Pose(2.0, 3.0, math.pi / 2), 0.01)())[1], "a location", 20)
        numbers = [3.0, 2.0, -90.0]
        until(lambda: (writer.write(numbers), near(place, Pose(3.0, 2.0, -math.pi / 2), 0.01)())[1], "numbers", 20)
        assert writer.write([5.0, 2.0, -90.0], strict=True) == 1
        until(near(place, Pose(5.0, 2.0, -math.pi / 2), 0.01), "all writes have arrived", 20)
        running, resume, accepted = place.worker.running("localization_server"), threading.Event(), list[Pose]()
        assert isinstance(running.module, LocalizationServer)
        monkeypatch.setattr(running.module.source, "set_pose", accepted.append)
        running.host.loop.post(lambda: resume.wait(40))
        (port,) = (port for port in running.host.yarp.status() if port["port"] == "/localizationServer/pose:i")
        for x in (1.0, 2.0):
            assert writer.write([x, 0.0, 0.0], strict=True) == 1
        until(lambda: received(running, port["port"]) == port["messages"] + 2, "both have arrived", 20)
    clock = running.host.clock
    arrived = clock.now_ns()
    until(lambda: clock.now_ns() > arrived, "time passes")
    resume.set()
    running.host.loop.call(lambda: None)
    assert [pose.x for pose in accepted] == [2.0], "while the thread is busy, only the newest pose waits"
    assert accepted[0].stamp_ns <= arrived, "its stamp is the time of its arrival"


def received(running: Running, name: str) -> int:
    return sum(port["messages"] for port in running.host.yarp.status() if port["port"] == name)


def test_poses_with_a_covariance_and_from_odometry(place: Place) -> None:
    section = {"enabled": True, "period": 0.05, "source": "topic", "topic": "/gnss", "pose_age": 10.0}
    place.worker.start(place.config(modules={"localization_server": section}, store={}))
    poses = place.far.subscribe("/localization/pose", POSE_COVARIANCE.replace("/msg", ""))
    for number, kind in enumerate((POSE_COVARIANCE, "nav_msgs/msg/Odometry"), 1):
        out = place.far.advertise("/gnss", kind.replace("/msg", ""))
        pose, spread = Pose(float(number), 5.0, 1.0), np.diag([0.04 * number, 0.09, 0.01])
        message = {
            "header": {"frame_id": "map"},
            "pose": {"pose": pose_message(pose), "covariance": spatial(spread).tolist()},
        }
        until(lambda o=out, m=message, p=pose: (place.far.publish(o, m), near(place, p, 0.01)())[1], kind, 20)

        def published(number: int = number) -> bool:
            return place.far.wait(poses, 1)[-1]["pose"]["covariance"][0] == pytest.approx(0.04 * number)

        until(published, "the covariance is forwarded", 20)


def test_the_pose_of_tf_is_served(place: Place, robot: Robot) -> None:
    started(place, robot, source="tf")
    until(reports(place, "not_yet_localized", "no transform from odom to map"), "it waits for the frames", 20)
    robot.localized = Pose(1.0, 2.0, 0.5)
    until(reports(place, OK), "the frames arrive", 20)
    assert near(place, robot.localized @ robot.odometry, 0.01)()
    robot.localized = None
    until(reports(place, "error", "localization is stale"), "their end is reported", 20)


def test_the_pose_of_another_yarp_server_is_served(place: Place, robot: Robot, tmp_path: Path) -> None:
    started(place, robot, ports=["/other"])
    with NameServer(port=place.port, gc_seconds=0), Place(tmp_path / "second") as second:
        until(lambda: place.names.query("/other/odometry:o"), "the other's ports are registered", 20)
        second.port = place.port
        with Robot(second.far.hub, second.far.registry) as follower:
            started(second, follower, source="server", server="/other")
            until(reports(second, "not_yet_localized"), "it reports the other's status", 20)
            publish_start = start_publisher(second, robot.pose)
            until(lambda: reports(second, OK)() or publish_start(), "the start is sent to the other", 20, every=0.5)
            until(near(second, robot.pose), "its pose is the other's", 20)
            until(lambda: status_of(second)["particles"] == 500, "its particles are the other's", 20)
            running = second.worker.running("localization_server")
            server: Any = running.module
            use(place, "lab2", robot)
            until(
                reports(second, "not_yet_localized", "on the map 'lab2', not on 'lab'"),
                "poses on another map are refused",
                20,
            )
            until(lambda: status_of(second)["particles"] == 0, "particles on another map are refused", 20)
            second.worker.store.put(MAP, "lab2", robot.grid)
            use(place, "lab", robot)
            until(reports(second, OK), "poses on this map are accepted again", 20)
            running.host.loop.call(lambda: server.begin(robot.pose, None, "lab2"))
            until(lambda: status_of(place)["map"] == "lab2", "the other uses the map of the start", 20)
            until(lambda: reports(second, OK)() and status_of(second)["map"] == "lab2", "it is localized there", 20)

            def error_reported() -> bool:
                """Retried: after a start that was still in transit the other waits for scans instead."""
                robot.silent = set()
                until(reports(second, OK), "both are localized", 20)
                robot.silent = {"scan"}
                until(lambda: not reports(second, OK)(), "the status changes", 20)
                return reports(second, "error", "/other/rpc reports error")()

            until(error_reported, "the other's error is reported", 30)
            place.worker.stop()
            until(reports(second, "error", "/other/rpc"), "the missing server is reported", 20)
            source = server.source

            def refused() -> bool:
                try:
                    source.initial(robot.pose, None)
                except RuntimeError as err:
                    return "is not available" in str(err)
                return False

            until(refused, "a start is refused", 20, every=0.1)
