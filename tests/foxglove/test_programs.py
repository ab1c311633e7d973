"""A client of the app's protocol with real rospy, rclpy and zenoh programs, through the real daemon."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from tests.foxglove.test_parameters import read_parameters
from tests.peers.browser.foxglove_app import App
from tests.peers.daemon.deployment import Deployment
from tests.peers.peer import Peer
from tests.peers.ros2.network import ros2_environment, ros2_python
from tests.support.ports import free_port
from tests.support.wait import until

STORE = get_typestore(Stores.ROS2_JAZZY)
PARAMETERS = Path(__file__).parents[1] / "peers" / "ros2" / "parameters.py"
RULES = [{"ros1": "/nav/controller", "node": "/controller_server", "owner": "ros2"}]
STRING = "std_msgs/String"


class Robot(Deployment):
    """A deployment with the Foxglove server; clients may send commands."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.app_port = free_port()

    def app(self) -> App:
        def join() -> App | None:
            try:
                return App(self.app_port)
            except OSError:
                return None

        return until(join, "the server accepts clients", 40)

    def document(self) -> dict[str, Any]:
        return next((worker for worker in self.status() if worker.get("worker") == "foxglove"), {})


@pytest.fixture(scope="module")
def of_the_file(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    with Robot(tmp_path_factory.mktemp("robot")) as deployment:
        deployment.start(
            foxglove={"enabled": True, "listen": f"127.0.0.1:{deployment.app_port}", "drive": True},
            routing={"parameters": RULES},
        )
        yield deployment


@pytest.fixture
def robot(of_the_file: Robot) -> Iterator[Robot]:
    yield of_the_file
    of_the_file.stop_programs()


def string(text: str) -> bytes:
    """Return a String in CDR, serialized by rosbags."""
    kind = STORE.types["std_msgs/msg/String"]
    return bytes(STORE.serialize_cdr(kind(data=text), "std_msgs/msg/String"))


def map_message() -> dict[str, Any]:
    return {
        "header": {"frame_id": "map"},
        "info": {"resolution": 0.5, "width": 3, "height": 2, "origin": {"orientation": {"w": 1.0}}},
        "data": [0, 100, -1, 0, 0, 100],
    }


def test_messages_of_each_side_arrive_unchanged(robot: Robot) -> None:
    ros1, ros2, sdk = robot.ros1(), robot.ros2(), robot.sdk()
    with robot.app() as app:
        ends = {name: peer.advertise(f"/by_{name}", STRING) for name, peer in (("ros1", ros1), ("sdk", sdk))}
        raw = ros2.advertise("/by_ros2", STRING)
        for name in ("ros1", "ros2", "sdk"):
            app.subscribe(f"/by_{name}")

        def all_arrived() -> bool:
            ros1.publish(ends["ros1"], {"data": "of ros1"})
            sdk.publish(ends["sdk"], {"data": "of sdk"})
            ros2.ask("publish_raw", id=raw, hex=string("of ros2").hex())
            while app.read(0.2):
                pass
            return all(app.messages[f"/by_{name}"] for name in ("ros1", "ros2", "sdk"))

        until(all_arrived, "a message from each side has arrived", 40)
        for name in ("ros1", "ros2", "sdk"):
            assert app.messages[f"/by_{name}"][0][1] == string(f"of {name}")
            assert app.decoded(f"/by_{name}").data == f"of {name}"
        sides = {topic: channel["metadata"]["side"] for topic, channel in app.channels.items() if "/by_" in topic}
        assert sides == {"/by_ros1": "ros1", "/by_ros2": "ros2", "/by_sdk": "zenoh"}


def test_a_late_app_receives_a_latched_map_of_rospy(robot: Robot) -> None:
    ros1 = robot.ros1()
    ros1.publish(ros1.advertise("/map", "nav_msgs/OccupancyGrid", latched=True), map_message())
    for _ in range(2):
        with robot.app() as app:
            app.subscribe("/map")
            app.received("/map")
            map_ = app.decoded("/map")
            assert (map_.info.width, map_.info.height, map_.header.frame_id) == (3, 2, "map")
            assert np.asarray(map_.data).tolist() == map_message()["data"]
            with robot.app() as late:
                late.subscribe("/map")
                assert late.received("/map")[0][1] == app.messages["/map"][0][1]


def test_the_apps_messages_reach_rospy_and_rclpy(robot: Robot) -> None:
    ros1, ros2 = robot.ros1(), robot.ros2()
    subscriptions = {peer: peer.subscribe("/from_app", STRING) for peer in (ros1, ros2)}
    with robot.app() as app:
        number = app.advertise("/from_app", "std_msgs/msg/String", "json")

        def arrives() -> bool:
            app.publish(number, json.dumps({"data": "hello"}).encode())
            return all(peer.wait(end, 1, 0.2) for peer, end in subscriptions.items())

        until(arrives, "the message arrives", 40)
        assert {peer.wait(end, 1)[0]["data"] for peer, end in subscriptions.items()} == {"hello"}


def test_the_app_calls_services_of_rospy_and_rclpy(robot: Robot) -> None:
    request = bytes(STORE.serialize_cdr(STORE.types["std_msgs/msg/Bool"](data=True), "std_msgs/msg/Bool"))
    with robot.app() as app:
        for name, peer in (("ros1", robot.ros1()), ("ros2", robot.ros2())):
            reply = {"success": True, "message": name}
            peer.ask("serve", service=f"/{name}_light", type="std_srvs/SetBool", reply=reply)
            call = app.call(f"/{name}_light", request)
            frame = app.until(lambda: app.replies.get(call), f"the reply of {name} arrives; {app.texts[-1]}", 30)  # noqa: B023
            assert frame[4] == 1
            assert frame[-len(name) - 1 :] == name.encode() + b"\0"


def test_the_app_sets_a_parameter_of_rclpy(robot: Robot) -> None:
    node = robot.keep(Peer(PARAMETERS, ros2_python(), ros2_environment(), "controller_server"))
    node.ask("declare", parameters={"speed": 0.5, "mode": "slow"})
    with robot.app() as app:

        def speed() -> float | None:
            """Return the value; None while the node does not answer, which is skipped then."""
            value: float | None = read_parameters(app).get("/controller_server.speed", {}).get("value")
            return value

        until(lambda: speed() == 0.5, "the parameter is read", 40)
        app.send(op="setParameters", parameters=[{"name": "/controller_server.speed", "value": 2}], id="w")
        until(lambda: speed() == 2.0, "the parameter is set", 20)
        until(lambda: node.ask("own", name="speed")["value"] == 2.0, "the node has the new value", 10)


@pytest.mark.thorough
def test_a_killed_worker_is_restarted_and_serves_again(robot: Robot) -> None:
    ros2 = robot.ros2()
    ros2.publish(ros2.advertise("/kept", STRING, latched=True), {"data": "kept"})
    with robot.app() as app:
        app.subscribe("/kept")
        app.received("/kept")
        pid = robot.document()["pid"]
        os.kill(pid, signal.SIGKILL)
        until(lambda: robot.document().get("pid", pid) != pid, "a new server process runs", 30)
    with robot.app() as app:
        app.subscribe("/kept")
        assert app.received("/kept")[0][1] == string("kept")
        assert robot.document()["clients"][0]["role"] == "drive"
        shown = robot.command("status").stdout
        assert f"ws://127.0.0.1:{robot.app_port}, 1 client, " in shown
