"""The module on a hub and on YARP, over each kind of source."""

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
from navigation.messages import pose_message
from navigation.pose import Pose, wrapped
from tests.modules.place import Place
from tests.navigation.localization_server.robot import LATCHED, Robot
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
    with Place(tmp_path) as made:
        yield made


@pytest.fixture
def robot(place: Place) -> Iterator[Robot]:
    made = Robot(place.far.hub, place.far.registry)
    yield made
    made.close()


def started(place: Place, robot: Robot, **section: Any) -> None:
    """Start the module, with the laboratory in the store."""
    config = place.config(modules={"localization_server": {"enabled": True, "period": 0.05, **section}}, store={})
    place.worker.start(config)
    use(place, robot.grid.name, robot)


def use(place: Place, name: str, robot: Robot) -> None:
    robot.grid.m_map_name = name
    place.worker.store.put(MAP, name, robot.grid)
    place.worker.store.use_map(name)


def said(place: Place) -> dict[str, Any]:
    return place.answer("localization_server")


def heard(place: Place, topic: str) -> int:
    return sum(end["messages"] for end in said(place)["topics"] if end["topic"] == topic)


def says(place: Place, status: str, reason: str = "") -> Callable[[], bool]:
    def look() -> bool:
        found = said(place)
        return found["localization"] == status and reason in found["reason"]

    return look


def near(place: Place, pose: Pose, metres: float = 0.15) -> Callable[[], bool]:
    def look() -> bool:
        found = said(place).get("pose")
        return bool(found) and pose.distance(Pose(*found)) < metres and abs(wrapped(found[2] - pose.theta)) < 0.1

    return look


def tell_start(place: Place, pose: Pose, covariance: Any = None, frame: str = "map") -> Callable[[], None]:
    out = place.far.advertise("/initialpose", POSE_COVARIANCE.replace("/msg", ""))
    covariance = np.zeros(36) if covariance is None else spatial(covariance)
    message = {
        "header": {"frame_id": frame},
        "pose": {"pose": pose_message(pose), "covariance": covariance.tolist()},
    }
    return lambda: place.far.publish(out, message)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0), (math.nan, 0.0, 0.0, 1.0)])
def test_a_start_whose_quaternion_is_not_a_rotation_is_refused(
    place: Place, robot: Robot, caplog: pytest.LogCaptureFixture, turn: tuple[float, ...]
) -> None:
    """As a goal's, which a zero quaternion would turn to yaw 0."""
    started(place, robot)
    until(says(place, "not_yet_localized", "no start was given"), "it waits for a start", 20)
    pose = {**pose_message(robot.pose), "orientation": dict(zip("xyzw", turn, strict=True))}
    start = {"header": {"frame_id": "map"}, "pose": {"pose": pose, "covariance": [0.0] * 36}}
    out = place.far.advertise("/initialpose", POSE_COVARIANCE.replace("/msg", ""))
    why = "/initialpose: refused: the start's quaternion is not a rotation: its length is"
    until(lambda: why in caplog.text or place.far.publish(out, start), "the start is refused", 20, every=0.2)
    assert said(place)["localization"] == "not_yet_localized"
    tell = tell_start(place, robot.pose)
    until(lambda: says(place, OK)() or tell(), "the next start is accepted", 20, every=0.5)


def test_our_own_localiser_for_all_sides(place: Place, robot: Robot) -> None:
    poses = place.far.subscribe("/localization/pose", "geometry_msgs/PoseWithCovarianceStamped")
    statuses = place.far.subscribe("/localization/status", "std_msgs/String", latched=True)
    clouds = place.far.subscribe("/localization/particles", "geometry_msgs/PoseArray", latched=True)
    frames = place.far.subscribe("/tf", "tf2_msgs/TFMessage")
    started(place, robot, particles_period=0.2)
    until(says(place, "not_yet_localized", "no start was given"), "it waits for a start", 20)
    true = robot.pose
    refused = tell_start(place, true, frame="odom")
    refused()
    tell = tell_start(place, true @ Pose(0.4, -0.3, 0.2))
    until(lambda: says(place, OK)() or tell(), "the start is taken", 20, every=0.5)
    until(near(place, true), "it is where it is", 20)
    until(lambda: {"data": OK} in place.far.wait(statuses, 1), "the status is told", 20)

    def published() -> bool:
        newest = place.far.wait(poses, 1)[-1]
        at = newest["pose"]["pose"]["position"]
        close = true.distance(Pose(at["x"], at["y"], 0.0)) < 0.15
        return close and newest["header"]["frame_id"] == "map" and 0.0 < newest["pose"]["covariance"][0] < 0.1

    until(published, "the pose is told", 20)

    def corrected() -> bool:
        """The odometry's frame on the map, with odometry in it, is the truth."""
        for message in reversed(place.far.wait(frames, 1)):
            for one in message["transforms"]:
                if one["child_frame_id"] == "odom":
                    at, turn = one["transform"]["translation"], one["transform"]["rotation"]
                    return (Pose(at["x"], at["y"], yaw_of(turn)) @ robot.odometry).distance(true) < 0.15
        return False

    until(corrected, "its correction is on /tf", 20)

    def cloud_is_there() -> bool:
        cloud = place.far.wait(clouds, 1)[-1]["poses"]
        return len(cloud) == 1000 and abs(np.mean([p["position"]["x"] for p in cloud]) - true.x) < 0.2

    until(cloud_is_there, "the particles are told", 20)
    robot.silent = {"scan"}
    until(says(place, "error", "the laser is silent"), "a silent laser is told", 20)
    robot.silent = {"odometry"}
    until(says(place, "error", "odometry is silent"), "silent odometry is told", 20)
    robot.silent = set()
    until(says(place, OK), "it goes on", 20)
    told = len(place.far.wait(statuses, 1))
    robot.carry(6.6, 0.8, 1.5)
    until(lambda: {"data": "error"} in place.far.wait(statuses, 1)[told:], "a robot that is lost says so", 20)
    until(near(place, robot.pose), "and is found again", 20)
    place.worker.stop()
    until(lambda: place.far.wait(statuses, 1)[-1] == {"data": "not_yet_localized"}, "its end is told", 20)


def test_a_carried_robot_is_told_to_be_lost_however_seldom_the_pose_is_told(place: Place, robot: Robot) -> None:
    statuses = place.far.subscribe("/localization/status", "std_msgs/String", latched=True)
    true = robot.pose
    started(place, robot, period=5.0, initial_pose=[*true[:2], math.degrees(true.theta)])
    until(lambda: {"data": OK} in place.far.wait(statuses, 1), "it is localised")
    told = len(place.far.wait(statuses, 1))
    robot.carry(6.6, 0.8, 1.5)
    until(lambda: {"data": "error"} in place.far.wait(statuses, 1)[told:], "it is lost")
    until(lambda: place.far.wait(statuses, 1)[-1] == {"data": OK}, "and found again")


def test_it_goes_on_where_it_was(place: Place, robot: Robot) -> None:
    true = robot.pose
    wrong = {"initial_pose": [3.0, 3.0, 0.0]}
    started(place, robot, initial_pose=[*true[:2], math.degrees(true.theta)])
    until(says(place, OK), "it is localised", 20)
    place.worker.stop()
    robot.silent = {"scan"}  # so that it is the memory that knows
    out = robot.node.publisher("/map", "nav_msgs/msg/OccupancyGrid", LATCHED, priority="state")
    out.publish(to_grid(robot.grid))
    section = {"enabled": True, "map": "/map", "period": 0.05, **wrong}
    place.worker.start(place.config(modules={"localization_server": section}, store={}))
    until(near(place, true), "it begins where it was, whatever the section says", 20)
    robot.silent = set()
    until(says(place, OK), "it is localised on the topic's map", 20)
    until(lambda: said(place)["updates"], "scans count", 20)
    robot.silent = {"scan"}  # so that a localiser that begins anew is seen by its updates
    until(says(place, "error", "the laser is silent"), "no further scan comes", 20)
    before, told = said(place)["updates"], heard(place, "/map")
    again = to_grid(robot.grid)  # as mapping programs tell it every other second
    again["info"]["resolution"] = float(np.float32(again["info"]["resolution"]))
    out.publish(again)
    until(lambda: heard(place, "/map") > told, "it is told again", 20)
    place.worker.running("localization_server").host.loop.call(lambda: None)
    assert said(place)["updates"] == before
    robot.grid.flags[:5, :5] = MapFlag.WALL
    out.publish(to_grid(robot.grid))
    until(lambda: said(place)["updates"] == 0, "a map with other walls is taken", 20)
    robot.silent = set()
    until(lambda: said(place)["updates"], "it goes on", 20)
    until(near(place, true), "where it was", 20)


def test_who_asks_how_it_is_does_not_disturb_it(place: Place, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
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
    until(lambda: threads, "it asks its source")
    assert set(threads) == {"midspan-localization_server"}


def test_what_is_drawn_on_a_map_beside_its_walls_delocalises_nobody() -> None:
    one = MapGrid2D.of(np.zeros((4, 4), np.uint8), name="lab")
    for flag, same in ((MapFlag.KEEP_OUT, True), (MapFlag.WALL, False), (MapFlag.UNKNOWN, False)):
        other = MapGrid2D.of(np.zeros((4, 4), np.uint8), name="lab")
        other.flags[1, 2] = flag
        assert same_walls(one, other) is same


def test_its_yarp_ports(place: Place, robot: Robot) -> None:
    started(place, robot)
    true = robot.pose
    here = Map2DLocation("lab", true.x + 0.2, true.y, math.degrees(true.theta) + 5.0)
    with NameServer(port=place.port, gc_seconds=0):
        until(lambda: place.names.query("/localizationServer/odometry:o"), "the ports are there", 20)
        until(lambda: "waiting" not in str(said(place).get("ports")), "all are open", 20)
        until(lambda: said(place).get("map") == "lab", "the map is there", 20)
        until(lambda: said(place).get("scans", 0) > 0, "scans are heard", 20)
        with (
            Reader("/test/where:i", naming=place.names) as where,
            Reader("/test/odometry:i", naming=place.names) as odometry,
            Localization2DClient("/localization2D_nws_yarp", naming=place.names) as client,
        ):
            connections.connect(place.names, "/localizationServer/streaming:o", "/test/where:i")
            connections.connect(place.names, "/localization2D_nws_yarp/odometry:o", "/test/odometry:i")
            first = where.read()
            assert first is not None
            assert math.isnan(first.values[1])  # nobody knows yet
            location, covariance = Map2DLocation(), Matrix()
            assert not client.getCurrentPosition(location, covariance)
            assert client.setInitialPose(here)

            def localized() -> bool:
                return client.getLocalizationStatus() is LocalizationStatusEnum.localization_status_localized_ok

            until(localized, "it is localised", 20)
            until(near(place, true), "it is where it is", 20)
            assert client.getCurrentPosition(location, covariance)
            assert location.map_id == "lab"
            assert math.hypot(location.x - true.x, location.y - true.y) < 0.15
            assert abs(math.remainder(location.theta - math.degrees(true.theta), 360.0)) < 5.0
            assert covariance.numpy().shape == (3, 3)
            assert 0.0 < covariance.numpy()[0, 0] < 1.0
            poses = client.getEstimatedPoses()
            assert len(poses) == 500
            assert abs(np.mean([one.y for one in poses]) - true.y) < 0.2

            def streamed() -> bool:
                found = where.read()
                return found is not None and abs(found.values[2] - true.y) < 0.15 and found.envelope != ""

            until(streamed, "the pose is streamed", 20)
            found = odometry.read()
            while found is not None and math.isnan(found.values[0]):
                found = odometry.read()
            assert found is not None
            assert len(found.values) == 9
            assert found.values[2] == pytest.approx(math.degrees(true.theta), abs=5.0)
            assert found.values[3:] == pytest.approx([0.0] * 6, abs=1e-3)
            assert isinstance(client.getEstimatedOdometry(), OdometryData)
            assert client.stopLocalizationService()
            until(says(place, "not_yet_localized", "was stopped"), "it rests", 20)
            assert client.startLocalizationService()
            until(localized, "it works again", 20)
            assert not client.setInitialPose(Map2DLocation("nowhere", 0.0, 0.0, 0.0))
            use(place, "lab2", robot)
            until(lambda: said(place).get("map") == "lab2", "another map is taken", 20)
            until(localized, "it is localised there", 20)
            assert client.setInitialPose(Map2DLocation("lab", true.x, true.y, math.degrees(true.theta)))
            until(lambda: said(place).get("map") == "lab", "the start was on another map, which is taken", 20)


def test_in_front_of_amcl(place: Place, robot: Robot) -> None:
    taken: list[dict[str, Any]] = []

    def set_map(request: dict[str, Any], answer: Any) -> None:
        taken.append(request)
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
    until(says(place, "not_yet_localized", "not known where odom is in map"), "it waits for the frames", 20)
    robot.localized = Pose(1.0, 2.0, 0.5)
    until(says(place, OK), "amcl's frames are heard", 20)
    assert near(place, robot.localized @ robot.odometry, 0.01)()
    until(lambda: said(place)["particles"] == 7, "so are its particles", 20)
    weighted = robot.node.publisher("/particle_cloud", "nav2_msgs/msg/ParticleCloud", LATCHED, priority="state")
    weighted.publish({"particles": [{"pose": pose_message(Pose(1.0, 2.0, 0.5)), "weight": 0.2}] * 5})
    until(lambda: said(place)["particles"] == 5, "and those of ROS 2's", 20)
    with NameServer(port=place.port, gc_seconds=0):
        until(lambda: place.names.query("/localization2D_nws_yarp/rpc"), "the port is there", 20)
        until(lambda: "waiting" not in str(said(place).get("ports")), "all are open", 20)
        with Localization2DClient("/localization2D_nws_yarp", naming=place.names) as client:
            location, found = Map2DLocation(), Matrix()
            assert client.getCurrentPosition(location, found)
            assert found.numpy() == pytest.approx(covariance)
            there = Map2DLocation("lab", 3.0, 4.0, 90.0)
            until(lambda: bool(client.setInitialPose(there)), "the start is told", 20)
            until(lambda: len(starts) > 0, "amcl hears it", 20)
            told = len(starts)
            assert client.setInitialPose(there, Matrix(3, 3))
            until(lambda: len(starts) > told, "amcl hears that, too", 20)
    for start in (starts[0], starts[-1]):
        assert start["header"]["frame_id"] == "map"
        assert yaw_of(start["pose"]["pose"]["orientation"]) == pytest.approx(math.pi / 2)
        assert start["pose"]["covariance"][[0, 35]] == pytest.approx([0.25, math.radians(15.0) ** 2])
    assert not taken  # its first map amcl has by itself
    use(place, "lab2", robot)
    until(lambda: len(taken) > 0, "amcl is given another map", 20)
    assert from_grid(taken[-1]["map"], "lab2").flags.shape == robot.grid.flags.shape
    where = taken[-1]["initial_pose"]["pose"]["pose"]["position"]
    assert (robot.localized @ robot.odometry).distance(Pose(where["x"], where["y"], 0.0)) < 0.01
    for wide, status in ((3.0, "not_yet_localized"), (0.55, OK)):  # the second is what rviz's starts come to
        spread = np.diag([wide**2, wide**2, 0.1])
        amcl.publish({"header": {"frame_id": "map"}, "pose": {"covariance": spatial(spread)}})
        until(says(place, status, "" if status == OK else "3.0 m apart"), f"a spread of {wide} m is {status}", 20)
    told = len(taken)
    section = {"enabled": True, "period": 0.05, "source": "amcl"}
    assert place.worker.reload(
        place.config(modules={"localization_server": section}, navigation={"map": "/floor"}, store={})
    )
    robot.grid.flags[:5, :5] = MapFlag.WALL
    robot.node.publisher("/floor", "nav_msgs/msg/OccupancyGrid", LATCHED, priority="state").publish(to_grid(robot.grid))
    until(lambda: len(taken) > told, "amcl is given the map of another source, too", 20)
    assert (from_grid(taken[-1]["map"], "floor").flags == robot.grid.flags).all()
    robot.localized = None
    until(says(place, "error", "localisation is stale"), "a dead amcl is told", 20)


def test_poses_of_a_topic_and_of_a_port(place: Place, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = place.far.subscribe("/tf", "tf2_msgs/TFMessage")
    section = {"enabled": True, "period": 0.05, "topic": "/uwb", "pose_age": 1.0}

    def by(source: str) -> Config:
        return place.config(navigation={"localizer": source}, modules={"localization_server": section}, store={})

    place.worker.start(by("topic"))
    until(says(place, "not_yet_localized", "no pose has come from /uwb"), "it waits for poses", 20)
    out = place.far.advertise("/uwb", "geometry_msgs/PoseStamped")
    given = Pose(4.0, 5.0, 1.0)
    wrong = {"header": {"frame_id": "uwb"}, "pose": pose_message(given)}
    until(lambda: (place.far.publish(out, wrong), "frame 'uwb'" in said(place)["reason"])[1], "frames are heeded", 20)
    message = {"header": {"frame_id": "map"}, "pose": pose_message(given)}
    until(lambda: (place.far.publish(out, message), says(place, OK)())[1], "poses are taken", 20)
    assert near(place, given, 0.01)()
    told = lambda: "odom" in str(place.far.wait(frames, 1, 0.1))  # noqa: E731
    until(lambda: (place.far.publish(out, message), told())[1], "the correction is on /tf", 20)
    until(says(place, "error", "/uwb has been silent for"), "silence is told", 20)
    assert place.worker.reload(by("port"))  # a line of the configuration; nothing else starts anew
    with NameServer(port=place.port, gc_seconds=0), Writer("/test/pose:o", naming=place.names) as writer:
        until(lambda: place.names.query("/localizationServer/pose:i"), "the port is there", 20)
        until(lambda: "waiting" not in str(said(place).get("ports")), "all are open", 20)
        writer.connect("/localizationServer/pose:i")
        until(lambda: (writer.write([1.0, "x"]), "neither" in said(place)["reason"])[1], "nonsense is told", 20)
        there = Map2DLocation("lab", 2.0, 3.0, 90.0)
        until(lambda: (writer.write(there), near(place, Pose(2.0, 3.0, math.pi / 2), 0.01)())[1], "a location", 20)
        numbers = [3.0, 2.0, -90.0]
        until(lambda: (writer.write(numbers), near(place, Pose(3.0, 2.0, -math.pi / 2), 0.01)())[1], "numbers", 20)
        assert writer.write([5.0, 2.0, -90.0], strict=True) == 1
        until(near(place, Pose(5.0, 2.0, -math.pi / 2), 0.01), "all has come that was written", 20)
        running, go_on, taken = place.worker.running("localization_server"), threading.Event(), list[Pose]()
        assert isinstance(running.module, LocalizationServer)
        monkeypatch.setattr(running.module.source, "take", taken.append)
        running.host.loop.post(lambda: go_on.wait(40))
        (port,) = (port for port in running.host.yarp.status() if port["port"] == "/localizationServer/pose:i")
        for x in (1.0, 2.0):
            assert writer.write([x, 0.0, 0.0], strict=True) == 1
        until(lambda: received(running, port["port"]) == port["messages"] + 2, "both have come", 20)
    clock = running.host.clock
    came = clock.now_ns()
    until(lambda: clock.now_ns() > came, "time passes")
    go_on.set()
    running.host.loop.call(lambda: None)
    assert [pose.x for pose in taken] == [2.0], "while the thread is busy the newest alone waits"
    assert taken[0].stamp_ns <= came, "and is of when it came"


def received(running: Running, name: str) -> int:
    return sum(port["messages"] for port in running.host.yarp.status() if port["port"] == name)


def test_poses_with_a_covariance_and_of_an_odometry(place: Place) -> None:
    section = {"enabled": True, "period": 0.05, "source": "topic", "topic": "/gnss", "pose_age": 10.0}
    place.worker.start(place.config(modules={"localization_server": section}, store={}))
    told = place.far.subscribe("/localization/pose", POSE_COVARIANCE.replace("/msg", ""))
    for number, kind in enumerate((POSE_COVARIANCE, "nav_msgs/msg/Odometry"), 1):
        out = place.far.advertise("/gnss", kind.replace("/msg", ""))
        there, spread = Pose(float(number), 5.0, 1.0), np.diag([0.04 * number, 0.09, 0.01])
        posed = {"pose": pose_message(there), "covariance": spatial(spread).tolist()}
        message = {"header": {"frame_id": "map"}, "pose": posed}
        until(lambda o=out, m=message, p=there: (place.far.publish(o, m), near(place, p, 0.01)())[1], kind, 20)
        told_so = lambda n=number: place.far.wait(told, 1)[-1]["pose"]["covariance"][0] == pytest.approx(0.04 * n)  # noqa: E731
        until(told_so, "as sure as it is told", 20)


def test_behind_whatever_says_where_the_odometry_is(place: Place, robot: Robot) -> None:
    started(place, robot, source="tf")
    until(says(place, "not_yet_localized", "not known where odom is in map"), "it waits for the frames", 20)
    robot.localized = Pose(1.0, 2.0, 0.5)
    until(says(place, OK), "the frames are heard", 20)
    assert near(place, robot.localized @ robot.odometry, 0.01)()
    robot.localized = None
    until(says(place, "error", "localisation is stale"), "their end is told", 20)


def test_in_front_of_another_server(place: Place, robot: Robot, tmp_path: Path) -> None:
    started(place, robot, ports=["/other"])
    with NameServer(port=place.port, gc_seconds=0), Place(tmp_path / "second") as second:
        until(lambda: place.names.query("/other/odometry:o"), "the other's ports are there", 20)
        second.port = place.port
        follower = Robot(second.far.hub, second.far.registry)
        try:
            started(second, follower, source="server", server="/other")
            until(says(second, "not_yet_localized"), "it says what the other says", 20)
            tell = tell_start(second, robot.pose)
            until(lambda: says(second, OK)() or tell(), "the start is told to the other", 20, every=0.5)
            until(near(second, robot.pose), "it is where the other says", 20)
            until(lambda: said(second)["particles"] == 500, "with the other's particles", 20)
            running = second.worker.running("localization_server")
            server: Any = running.module
            use(place, "lab2", robot)
            until(says(second, "not_yet_localized", "on the map 'lab2', not on 'lab'"), "poses of another map", 20)
            until(lambda: said(second)["particles"] == 0, "are not of this one", 20)
            second.worker.store.put(MAP, "lab2", robot.grid)
            use(place, "lab", robot)
            until(says(second, OK), "those of this one are taken again", 20)
            running.host.loop.call(lambda: server.begin(robot.pose, None, "lab2"))
            until(lambda: said(place)["map"] == "lab2", "the other is told where it begins on another map", 20)
            until(lambda: says(second, OK)() and said(second)["map"] == "lab2", "it says where the robot is there", 20)

            def troubled() -> bool:
                """A start that was still on its way has it wait for scans instead; the next time none is."""
                robot.silent = set()
                until(says(second, OK), "all is well", 20)
                robot.silent = {"scan"}
                until(lambda: not says(second, OK)(), "not any more", 20)
                return says(second, "error", "/other/rpc says error")()

            until(troubled, "the other's trouble is told", 30)
            place.worker.stop()
            until(says(second, "error", "/other/rpc"), "it is told that the other has gone", 20)
            source = server.source

            def refused() -> bool:
                try:
                    source.initial(robot.pose, None)
                except RuntimeError as err:
                    return "is not there" in str(err)
                return False

            until(refused, "nobody is told where to begin", 20, every=0.1)
        finally:
            follower.close()
