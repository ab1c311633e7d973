"""LocalizationServer and its sources of poses: amcl, topics, ports, tf, other servers, classes."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.config.model import Config
from bridge.hub.endpoints.calls import CallError
from bridge.hub.wire.qos import Qos
from bridge.modules.worker import Running
from bridge.stores.kinds import MAP
from navigation.localization_server.estimate import POSE_COVARIANCE, LocalizationStatus, PoseEstimate, spatial
from navigation.localization_server.module import LocalizationServer
from navigation.localization_server.sources import PoseSource
from navigation.maps.grid import from_grid, to_grid, yaw_of
from navigation.messages import pose_message
from navigation.pose import Pose
from tests.peers.hub.modules import Place
from tests.peers.navigation.localization import OK, near, reports, start_publisher, started, status_of, use
from tests.peers.sim.laboratory import LATCHED, Robot
from tests.support.wait import until
from yarp_compat.dev.localization2d import Localization2DClient
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapFlag
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Writer
from yarp_compat.sig.matrix import Matrix


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


class FaultySource(PoseSource):
    """A user's localizer with errors; ``answer`` is what it returns or raises."""

    accepts_starts = corrects = True
    answer: Any = None

    def __init__(self, *_arguments: Any) -> None: ...

    def initial(self, pose: Pose, covariance: Any) -> None: ...

    def estimate(self) -> Any:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def correction(self) -> Any:
        return self.estimate().pose


GOOD = PoseEstimate(Pose(1.0, 2.0, 0.5), np.zeros((3, 3)), 1.0, LocalizationStatus.OK, "")
NAN = replace(GOOD, pose=Pose(math.nan, 2.0, 0.5))


def test_errors_of_a_class_as_source_make_the_pose_unknown(
    place: Place, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FaultySource, "answer", GOOD)
    source = f"{__name__}:FaultySource"
    place.worker.start(place.config(modules={"localization_server": {"enabled": True, "source": source}}, store={}))
    module = place.worker.running("localization_server").module
    received: list[Any] = []
    robot.node.subscription("/tf", "tf2_msgs/msg/TFMessage", received.append, Qos(depth=100))
    corrections = lambda: {  # noqa: E731
        frame["transform"]["translation"]["x"]
        for message in received
        for frame in message["transforms"]
        if frame["header"]["frame_id"] == "map"
    }
    until(corrections, "the correction arrives")
    for answer, reason in (
        (NAN, "not finite"),
        (None, "returned NoneType instead of a PoseEstimate"),
        (replace(GOOD, covariance=np.zeros(3)), "covariance"),
        (replace(GOOD, pose=None), "the pose is None"),
        (ValueError("a bug"), "ValueError: a bug"),
    ):
        monkeypatch.setattr(FaultySource, "answer", answer)
        until(lambda reason=reason: reason in module.status().document()["reason"], reason)
        assert module.status().document()["localization"] == "error"
    monkeypatch.setattr(FaultySource, "answer", GOOD)
    until(lambda: module.status().document()["localization"] == OK, "the pose is known again")
    assert corrections() == {1.0}


def test_a_map_is_sent_to_amcl_again_after_a_failed_call(place: Place, robot: Robot) -> None:
    maps: list[dict[str, Any]] = []

    def set_map(request: dict[str, Any], answer: Any) -> None:
        maps.append(request)
        answer({"success": True} if len(maps) > 1 else CallError("the worker was restarted"))

    robot.node.server("/set_map", "nav_msgs/srv/SetMap", set_map)
    started(place, robot, source="amcl")
    use(place, "lab2", robot)
    until(lambda: len(maps) == 2, "the map is sent again", 20)
    until(lambda: status_of(place)["set_map"] == "done", "amcl has the map", 20)


def test_a_pose_on_the_previous_map_is_not_reliable(place: Place, robot: Robot) -> None:
    success = False
    robot.node.server("/set_map", "nav_msgs/srv/SetMap", lambda _request, answer: answer({"success": success}))
    robot.localized = Pose(1.0, 2.0, 0.5)
    started(place, robot, source="amcl")
    until(reports(place, OK), "amcl's frames arrive", 20)
    use(place, "lab2", robot)
    until(reports(place, "not_yet_localized", "the previous map: /set_map refused the map"), "amcl has another map", 20)
    success = True
    use(place, "lab3", robot)
    until(reports(place, OK), "amcl has the map", 20)


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
    until(reports(place, "not_yet_localized", "no transform from odom to map"), "the module waits for the frames", 20)
    robot.localized = Pose(1.0, 2.0, 0.5)
    until(reports(place, OK), "amcl's frames arrive", 20)
    until(near(place, robot.localized @ robot.odometry, 0.01), "the pose is that of amcl's frames", 20)
    until(lambda: status_of(place)["particles"] == 7, "amcl's particles arrive", 20)
    weighted = robot.node.publisher("/particle_cloud", "nav2_msgs/msg/ParticleCloud", LATCHED, priority="state")
    weighted.publish({"particles": [{"pose": pose_message(Pose(1.0, 2.0, 0.5)), "weight": 0.2}] * 5})
    until(lambda: status_of(place)["particles"] == 5, "the particles of ROS 2's amcl arrive", 20)
    with NameServer(port=place.port, gc_seconds=0):
        until(lambda: place.names.query("/localization2D_nws_yarp/rpc"), "the port is registered", 20)
        until(lambda: "waiting" not in str(status_of(place).get("ports")), "all ports are open", 20)
        with Localization2DClient("/localization2D_nws_yarp", naming=place.names) as client:
            location, received_covariance = Map2DLocation(), Matrix()
            # the pose is unknown while amcl's frames are late
            until(lambda: client.getCurrentPosition(location, received_covariance), "the pose is known", 20)
            assert received_covariance.numpy() == pytest.approx(covariance)
            start_location = Map2DLocation("lab", 3.0, 4.0, 90.0)
            until(lambda: bool(client.setInitialPose(start_location)), "the initial pose is sent", 20)
            until(lambda: len(starts) > 0, "amcl receives the initial pose", 20)
            before = len(starts)
            assert client.setInitialPose(start_location, Matrix(3, 3))
            until(lambda: len(starts) > before, "amcl receives the second initial pose", 20)
    for start in (starts[0], starts[-1]):
        assert start["header"]["frame_id"] == "map"
        assert yaw_of(start["pose"]["pose"]["orientation"]) == pytest.approx(math.pi / 2)
        assert start["pose"]["covariance"][[0, 35]] == pytest.approx([0.25, math.radians(15.0) ** 2])
    assert not maps  # no map is sent: amcl loads its first map itself
    use(place, "lab2", robot)
    until(lambda: len(maps) > 0, "amcl receives the other map", 20)
    assert from_grid(maps[-1]["map"], "lab2").flags.shape == robot.grid.flags.shape
    position = maps[-1]["initial_pose"]["pose"]["pose"]["position"]
    assert (robot.localized @ robot.odometry).distance(Pose(position["x"], position["y"], 0.0)) < 0.01
    for wide, status in ((3.0, "not_yet_localized"), (0.55, OK)):  # the second spread is the one that rviz sends
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


def test_poses_are_received_from_a_topic_and_from_a_port(
    place: Place, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = place.far.subscribe("/tf", "tf2_msgs/TFMessage")
    section = {"enabled": True, "period": 0.05, "topic": "/uwb", "pose_age": 1.0}

    def by(source: str) -> Config:
        return place.config(navigation={"localizer": source}, modules={"localization_server": section}, store={})

    place.worker.start(by("topic"))
    until(reports(place, "not_yet_localized", "waiting for a pose on /uwb"), "the module waits for poses", 20)
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
    # published again, because the pose is stale a second after the last message
    until(lambda: (place.far.publish(out, message), near(place, given, 0.01)())[1], "the pose is the published one", 20)
    corrected = lambda: "odom" in str(place.far.wait(frames, 1, 0.1))  # noqa: E731
    until(lambda: (place.far.publish(out, message), corrected())[1], "the correction is on /tf", 20)
    until(reports(place, "error", "/uwb has been silent for"), "silence is reported", 20)
    assert place.worker.reload(by("port"))  # the worker applies the change without a restart of its process
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
        until(
            lambda: (writer.write(location), near(place, Pose(2.0, 3.0, math.pi / 2), 0.01)())[1],
            "a location becomes the pose",
            20,
        )
        numbers = [3.0, 2.0, -90.0]
        until(
            lambda: (writer.write(numbers), near(place, Pose(3.0, 2.0, -math.pi / 2), 0.01)())[1],
            "numbers become the pose",
            20,
        )
        running, resume, accepted = place.worker.running("localization_server"), threading.Event(), list[Pose]()
        assert isinstance(running.module, LocalizationServer)
        monkeypatch.setattr(running.module.source, "set_pose", accepted.append)
        assert writer.write([5.0, 2.0, -90.0], strict=True) == 1
        until(lambda: 5.0 in [pose.x for pose in accepted], "all writes have arrived", 20)
        accepted.clear()
        running.host.loop.post(lambda: resume.wait(40))
        (port,) = (port for port in running.host.yarp.status() if port["port"] == "/localizationServer/pose:i")
        for x in (1.0, 2.0):
            assert writer.write([x, 0.0, 0.0], strict=True) == 1
        until(lambda: received(running, port["port"]) == port["messages"] + 2, "both poses have arrived", 20)
    clock = running.host.clock
    arrived = clock.now_ns()
    until(lambda: clock.now_ns() > arrived, "time passes")
    resume.set()
    running.host.loop.call(lambda: None)
    assert [pose.x for pose in accepted] == [2.0], "while the thread is busy, only the newest pose waits"
    assert accepted[0].stamp_ns <= arrived, "its stamp is the time of its arrival"


def received(running: Running, name: str) -> int:
    return sum(port["messages"] for port in running.host.yarp.status() if port["port"] == name)


def test_poses_with_a_covariance_keep_it(place: Place) -> None:
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
    until(reports(place, "not_yet_localized", "no transform from odom to map"), "the module waits for the frames", 20)
    robot.localized = Pose(1.0, 2.0, 0.5)
    until(reports(place, OK), "the frames arrive", 20)
    until(near(place, robot.localized @ robot.odometry, 0.01), "the pose is that of the frames", 20)
    robot.localized = None
    until(reports(place, "error", "localization is stale"), "the loss of the frames is reported", 20)


def test_the_pose_of_another_yarp_server_is_served(place: Place, robot: Robot, tmp_path: Path) -> None:
    started(place, robot, ports=["/other"])
    with NameServer(port=place.port, gc_seconds=0), Place(tmp_path / "second") as second:
        until(lambda: place.names.query("/other/odometry:o"), "the other server's ports are registered", 20)
        second.port = place.port
        with Robot(second.far.hub, second.far.registry) as follower:
            started(second, follower, source="server", server="/other")
            until(reports(second, "not_yet_localized"), "the module reports the other server's status", 20)
            publish_start = start_publisher(second, robot.pose)
            until(
                lambda: reports(second, OK)() or publish_start(),
                "the initial pose is sent to the other server",
                20,
                every=0.5,
            )
            until(near(second, robot.pose), "the module serves the other server's pose", 20)
            until(lambda: status_of(second)["particles"] == 500, "the module serves the other server's particles", 20)
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
            until(lambda: status_of(place)["map"] == "lab2", "the other server uses the map of the initial pose", 20)
            until(
                lambda: reports(second, OK)() and status_of(second)["map"] == "lab2",
                "the robot is localized on that map",
                20,
            )

            def error_reported() -> bool:
                """Retried: an initial pose still in transit makes the other server wait for scans instead."""
                robot.silent = set()
                until(reports(second, OK), "the robot is localized", 20)
                robot.silent = {"scan"}
                until(lambda: not reports(second, OK)(), "the status changes", 20)
                return reports(second, "error", "/other/rpc reports error")()

            until(error_reported, "the other server's error is reported", 30)
            place.worker.stop()
            until(reports(second, "error", "/other/rpc"), "the missing server is reported", 20)
            source = server.source

            def refused() -> bool:
                try:
                    source.initial(robot.pose, None)
                except RuntimeError as err:
                    return "is not available" in str(err)
                return False

            until(refused, "an initial pose is refused", 20, every=0.1)
