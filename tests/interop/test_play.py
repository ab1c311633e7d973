"""A ROS 1 bag is played to rclpy in place of RViz 2, a YARP reader, Mapper2D and rospy, all on the bag's time."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.bags.play.services import PAUSE, STEP
from tests.bags.playing import NS, START, Said, stamp, transform, write_bag
from tests.contract.side import CUSTOM_FOLDER
from tests.peers.daemon.deployment import Deployment
from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.yarp.programs import Definitions, Names, YarpProgram
from tests.support.process import Process
from tests.support.wait import until

SCAN, TF, TWIST, GRID = "sensor_msgs/LaserScan", "tf2_msgs/TFMessage", "geometry_msgs/Twist", "nav_msgs/OccupancyGrid"
SECONDS = 4.0
IMPORTS = ("bridge.bags.play.output", "bridge.bags.play.player", "bridge.cli.bags.play", "bridge.cli.main")


def drive() -> Iterator[Said]:
    """Return the messages of a robot in a round room: frames at 20 Hz, scans and velocities at 5 Hz."""
    yield Said(0.0, "/tf_static", TF, {"transforms": [transform("base_link", "laser", x=0.2)]})
    for tick in range(int(20 * SECONDS) + 1):
        at = tick / 20
        yield Said(at, "/tf", TF, {"transforms": [transform("odom", "base_link", at, at / SECONDS)]})
        if tick % 4 == 0:
            header = {"stamp": stamp(at), "frame_id": "laser"}
            beams = {"angle_min": -math.pi, "angle_increment": math.tau / 180, "ranges": [2.0] * 180}
            yield Said(at, "/scan", SCAN, {"header": header, "range_min": 0.1, "range_max": 20.0, **beams})
            yield Said(at, "/cmd_vel", TWIST, {"linear": {"x": 0.25}})


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bags") / "drive.bag", drive(), ["/tf_static"])


@pytest.fixture(scope="module")
def names() -> Iterator[Names]:
    names = Names()
    yield names
    names.stop()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, names: Names) -> Iterator[Deployment]:
    """A deployment with Mapper2D that takes its time from /clock."""
    mapper = {"enabled": True, "map_frame": "odom", "width": 8, "height": 8, "resolution": 0.1, "period": 0.2}
    with Deployment(tmp_path_factory.mktemp("site")) as deployment:
        deployment.start(
            clock={"source": "sim"},
            yarp={"enabled": True, "nameserver": "site", "address": names.endpoint, "poll": 0.1},
            modules={"mapper2d": mapper},
        )
        until(lambda: mapper_of(deployment), "the mapper runs", 40, every=0.1)
        yield deployment
        deployment.stop_programs()


def mapper_of(site: Deployment) -> list[dict[str, Any]]:
    """Return the status document of Mapper2D in a list, which is empty until Mapper2D runs."""
    return [document for document in site.status() if "scans" in document]


def play(site: Deployment, bag: Path, *words: str) -> Process:
    return Process([*MIDSPAN, "play", bag, "--config", site.file, *words], imports=IMPORTS)


def in_the_bag(seconds: float) -> bool:
    return START / NS <= seconds <= START / NS + SECONDS


def test_each_side_and_the_mapper_receive_a_ros_1_bag_on_its_time(site: Deployment, bag: Path, names: Names) -> None:
    rviz, rospy = site.ros2(), site.ros1()
    yarp = site.keep(YarpProgram(names.client, "/reader", Definitions((CUSTOM_FOLDER,))))
    scans, frames = rviz.subscribe("/scan", SCAN), rviz.subscribe("/tf_static", TF, latched=True)
    grids, velocities = rviz.subscribe("/mapper2d/map", GRID, latched=True), rviz.subscribe("/cmd_vel", TWIST)
    ports = yarp.subscribe("/scan", SCAN)
    assert rospy.ask("now")["seconds"] == 0.0  # rospy waits for the clock
    with play(site, bag, "--clock", "--rate", "2", "--loop") as player:
        received = rviz.wait(scans, 10)
        assert [round(value, 2) for value in received[-1]["ranges"]] == [2.0] * 180
        assert received[-1]["header"]["frame_id"] == "laser"
        assert rviz.wait(frames, 1)[0]["transforms"][0]["child_frame_id"] == "laser"
        assert yarp.wait(ports, 3, 30)[-1]["header"]["frame_id"] == "laser"
        until(lambda: in_the_bag(rospy.ask("now")["seconds"]), "rospy uses the bag's time", 20)

        def mapped() -> list[dict[str, Any]]:
            return [grid for grid in rviz.wait(grids, 1) if grid["data"].count(100) > 50]

        walls = until(mapped, "the mapper has walls", 40, every=0.2)
        assert in_the_bag(walls[-1]["header"]["stamp"]["sec"])
        player.signal(signal.SIGINT)
        until(lambda: player.popen.poll() is not None, "the player ends", 10)
    assert player.popen.poll() == 0
    assert rviz.wait(velocities, 0) == []


def test_requested_velocities_reach_each_side_and_end_with_zero(site: Deployment, bag: Path) -> None:
    rviz, rospy = site.ros2(), site.ros1()
    ends = [(peer, peer.subscribe("/cmd_vel", TWIST)) for peer in (rviz, rospy)]
    with play(site, bag, "--commands", "--paused", "--topics", "/cmd_vel", "--duration", "3") as player:
        # the play lasts for 3 s, so all routes must exist before it begins
        until(lambda: rospy.ask("connections", id=ends[1][1])["count"], "rospy is connected to the publisher", 30)
        until(lambda: rviz.graph()["publishers"].get("/cmd_vel"), "rclpy has discovered the publisher", 30)
        rospy.ask("await_service", service=PAUSE, seconds=30)
        call = rospy.ask("call", service=PAUSE, type="std_srvs/SetBool", request={"data": False})["id"]
        assert rospy.ask("result", id=call, seconds=20)["reply"]["success"]
        for peer, end in ends:
            until(lambda peer=peer, end=end: zero(peer.wait(end, 1)), "zero is received", 30)  # type: ignore[misc]
            speeds = [item["linear"]["x"] for item in peer.wait(end, 1)]
            assert (set(speeds), speeds[-1]) == ({0.25, 0.0}, 0.0)  # zero is repeated
        until(lambda: player.popen.poll() is not None, "the player ends", 10)
        assert "the robot may move: /cmd_vel" in player.output()


def zero(twists: list[dict[str, Any]]) -> bool:
    return bool(twists) and twists[-1]["linear"]["x"] == 0.0


def test_a_rospy_program_steps_and_resumes_on_the_bags_time(site: Deployment, bag: Path) -> None:
    rospy = site.ros1()
    scans = rospy.subscribe("/scan", SCAN)
    with play(site, bag, "--clock", "--paused", "--topics", "/scan"):
        for service in (STEP, PAUSE):
            rospy.ask("await_service", service=service, seconds=30)
        until(lambda: rospy.ask("connections", id=scans)["count"], "rospy is connected to the publisher of scans", 20)
        for count in (1, 2):
            call = rospy.ask("call", service=STEP, type="std_srvs/Trigger", request={})["id"]
            assert rospy.ask("result", id=call, seconds=20)["reply"]["success"]
            assert len(rospy.wait(scans, count)) == count
        at = START / NS + 0.2
        until(lambda: rospy.ask("now")["seconds"] == pytest.approx(at), "rospy's time is that of the second scan", 10)
        call = rospy.ask("call", service=PAUSE, type="std_srvs/SetBool", request={"data": False})["id"]
        assert rospy.ask("result", id=call, seconds=20)["reply"]["success"]
        assert len(rospy.wait(scans, 21)) == 21
