"""The buffer server, used by the real tf2_ros.BufferClient of ROS 1 and by rclpy through the real daemon."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.tf.buffer import TransformBuffer
from bridge.transform_server.buffer_server import ACTION, FRAMES, BufferServer
from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.node import HubNode
from tests.peers.peer import Peer
from tests.peers.ros1.network import ROS1_PYTHON
from tests.support.wait import until

pytestmark = pytest.mark.thorough

CLIENT = Path(__file__).parents[1] / "peers" / "ros1" / "buffer_client.py"
S = 1_000_000_000
START = 1_790_000_000 * S
SUCCEEDED = 4


@pytest.fixture
def buffer(running: Deployment) -> Iterator[TransformBuffer]:
    """A module's buffer: the base moves in the map at 1 m/s for 10 s, and the laser is fixed on the base."""
    transform_buffer = TransformBuffer()
    for n in range(101):
        transform_buffer.set_transform(
            "map", "base", START + n * S // 10, (n / 10, 0, 0), (0.0, 0.0, 0.0, 1.0), "wheels"
        )
    transform_buffer.set_transform("base", "laser", 0, (0, 2, 0), (0.0, 0.0, 0.6, 0.8), "urdf", static=True)
    with HubNode(running.settings("transform_server")) as program:
        program.on(lambda: BufferServer(program.node, transform_buffer))
        yield transform_buffer


class Ros1:
    """A ROS 1 program that uses tf2_ros.BufferClient."""

    def __init__(self, deployment: Deployment) -> None:
        self._peer = deployment.keep(Peer(CLIENT, ROS1_PYTHON, deployment.master.env))
        assert self._peer.ask("server", seconds=40)["there"], "the server does not exist"

    def lookup(self, target: str, source: str, stamp: int, timeout: float = 0.0, **more: Any) -> tuple[Any, ...]:
        """Return the pose, or the error and its text."""
        result = self._peer.ask("lookup", target=target, source=source, stamp=stamp, timeout=timeout, **more)
        return tuple(result["pose"]) if "pose" in result else (result["error"], result["text"])

    def frames(self) -> str:
        return str(self._peer.ask("frames")["yaml"])


class Ros2:
    """rclpy's action client used as in ROS 2's tf2_ros.BufferClient, which is not published as a wheel."""

    ERRORS = ("", "LookupException", "ConnectivityException", "ExtrapolationException", "InvalidArgumentException")

    def __init__(self, deployment: Deployment) -> None:
        self._peer = deployment.ros2()

    def lookup(self, target: str, source: str, stamp: int, timeout: float = 0.0, **more: Any) -> tuple[Any, ...]:
        """Return the pose, or the error and its text."""
        goal = {
            "target_frame": target,
            "source_frame": source,
            "source_time": stamp_of(stamp),
            "timeout": stamp_of(round(timeout * S)),
        }
        if more:
            goal |= {"advanced": True, "target_time": stamp_of(more["target_stamp"]), "fixed_frame": more["fixed"]}
        sent = self._peer.ask("send_goal", action=ACTION, type="tf2_msgs/LookupTransform", goal=goal)["id"]
        state = self._peer.ask("goal", id=sent, until={"ends": 1}, seconds=30)
        if state["status"] != SUCCEEDED:
            return "no result", str(state)
        result = state["result"]
        if code := result["error"]["error"]:
            return self.ERRORS[code], result["error"]["error_string"]
        header, pose = result["transform"]["header"], result["transform"]["transform"]
        moved, turned = pose["translation"], pose["rotation"]
        at = header["stamp"]["sec"] * S + header["stamp"]["nanosec"]
        return at, *(moved[k] for k in "xyz"), *(turned[k] for k in "xyzw")

    def frames(self) -> str:
        call = self._peer.ask("call", service=FRAMES, type="tf2_msgs/FrameGraph", request={}, seconds=40)["id"]
        answer = self._peer.ask("result", id=call, seconds=30)
        assert answer["done"], "tf2_frames does not answer"
        return str(answer["reply"]["frame_yaml"])


def stamp_of(ns: int) -> dict[str, int]:
    return dict(zip(("sec", "nanosec"), divmod(ns, S), strict=True))


def assert_answers(client: Ros1 | Ros2, buffer: TransformBuffer) -> None:
    """Check every kind of lookup of a BufferClient."""
    result = until(
        lambda: (text := client.lookup("map", "laser", START + S // 4)) and len(text) == 8 and text,
        "a lookup succeeds, although goals during discovery may be lost", 60,
    )  # fmt: skip
    assert result == pytest.approx((START + S // 4, 0.25, 2, 0, 0, 0, 0.6, 0.8))
    full = client.lookup("base", "base", START, target_stamp=START + S, fixed="map")
    assert full == pytest.approx((START + S, -1, 0, 0, 0, 0, 0, 1))
    assert client.lookup("map", "base", 0)[0] == START + 10 * S
    for question, name, texts in (
        (("map", "nowhere", 0), "LookupException", "does not exist"),
        (("map", "crater", 0), "ConnectivityException", "two or more unconnected trees"),
        (("map", "base", START + 99 * S), "ExtrapolationException", "into the future"),
        (("map", "", 0), "InvalidArgumentException", "cannot be empty"),
    ):
        text = client.lookup(*question)
        assert text[0] == name
        assert texts in text[1]
    began = time.monotonic()
    assert client.lookup("map", "base", START + 99 * S, 0.5)[0] == "ExtrapolationException"
    assert time.monotonic() - began >= 0.5
    reported = yaml.safe_load(client.frames())
    assert reported["base"] == buffer_says(buffer)


def buffer_says(buffer: TransformBuffer) -> Any:
    text = yaml.safe_load(buffer.yaml())["base"]
    assert (text["parent"], text["broadcaster"], text["buffer_length"]) == ("map", "wheels", 10.0)
    return text


def test_buffer_clients_of_ros1_and_ros2_look_up_frames(running: Deployment, buffer: TransformBuffer) -> None:
    buffer.set_transform("moon", "crater", 0, (0, 0, 0), (0.0, 0.0, 0.0, 1.0), static=True)
    for client in (Ros1(running), Ros2(running)):
        assert_answers(client, buffer)
