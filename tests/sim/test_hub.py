"""The simulator on the hub: its topics, commands, services and time."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock, call

import numpy as np
import pytest

from bridge import clock
from bridge.config.model import Config
from bridge.config.sections.yarp import TopicPort, YarpSection
from sim import messages
from sim.base import Twist
from sim.depth import DepthCamera
from sim.simulator import Simulator, SimWorker
from tests.peers.hub.rig import HubRig
from tests.support.ports import free_port
from tests.support.status_documents import check_document
from tests.support.wait import until

WHEELS = ["mobile_base_l_wheel_joint", "mobile_base_r_wheel_joint"]


class Place(HubRig):
    """A hub, the simulator's worker, and a client with its own hub session."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.port = free_port()
        self.worker = self.keep(SimWorker())

    def config(self, *, source: str = "system", **sim: Any) -> Config:
        yarp = {"address": f"127.0.0.1:{self.port}", "namespace": "/root", "ip": "127.0.0.1"}
        return super().config(yarp=yarp, clock={"source": source}, sim={"plan": "apartment", **sim})

    def call(self, service: str, kind: str, **request: Any) -> dict[str, Any]:
        result = self.far.call(service, kind, **request).result()
        assert result["reply"] is not None, result
        reply: dict[str, Any] = result["reply"]
        return reply

    def named(self, service: str, name: str) -> dict[str, Any]:
        return self.call(f"/sim/{service}", "midspan_msgs/Named", name=name)

    def step(self, seconds: float, *wait_for: str, patience: float = 20.0) -> dict[str, Any]:
        return self.call("/sim/step", "midspan_msgs/Step", seconds=seconds, wait_for=list(wait_for), patience=patience)

    def answer(self, worker: str = "sim") -> dict[str, Any]:
        """Wait for the simulator's status document, and check it."""
        status = super().answer(worker)
        check_document(status, "sim")
        return status


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as rig:
        yield rig


def test_steps_wait_for_the_acknowledgements_of_participants(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock, "SILENCE_SECONDS", 0.0)
    far = place.far
    subscriptions = {
        topic: far.subscribe(topic, kind)
        for topic, kind in {
            "/clock": "rosgraph_msgs/Clock",
            "/scan": "sensor_msgs/LaserScan",
            "/odom": "nav_msgs/Odometry",
            "/tf": "tf2_msgs/TFMessage",
            "/joint_states": "sensor_msgs/JointState",
            "/battery_state": "sensor_msgs/BatteryState",
            "/ground_truth": "nav_msgs/Odometry",
            "/bumper": "std_msgs/Bool",
        }.items()
    }
    place.worker.start(place.config(source="sim", speed="step", start=(3.0, 8.2, -90.0)))
    for topic in subscriptions:
        far.until_published(topic)
    velocity = far.advertise("/cmd_vel", "geometry_msgs/Twist")
    acknowledge = far.advertise("/sim/acknowledge", "std_msgs/Header")

    def go(publisher: Any, command: dict[str, Any]) -> float:
        """Step 0.1 s with a command, which may be lost until the subscription is connected."""
        far.publish(publisher, command)
        place.step(0.1)
        return float(-place.answer("sim")["truth"][1] + 8.2)

    until(lambda: go(velocity, {"linear": {"x": 0.2}}) > 0.05, "the robot drives", 30)
    last = {topic: far.wait(end, 1)[-1] for topic, end in subscriptions.items() if topic != "/battery_state"}
    assert last["/scan"]["header"]["frame_id"] == "laser"
    assert len(last["/scan"]["ranges"]) == 720
    assert last["/odom"]["child_frame_id"] == "base_link"
    assert last["/tf"]["transforms"][0]["child_frame_id"] == "base_link"
    assert last["/joint_states"]["name"] == WHEELS
    assert last["/ground_truth"]["pose"]["pose"]["position"]["x"] == pytest.approx(3.0, abs=0.01)
    assert not place.step(0.01, "planner", patience=0.1)["success"]
    waiting = far.call("/sim/step", "midspan_msgs/Step", seconds=1.0, wait_for=["planner"], patience=30.0)
    until(lambda: place.step(0.01)["message"].startswith("another step"), "the step is in progress")
    now = far.wait(subscriptions["/battery_state"], 1)[-1]["header"]["stamp"]["sec"] + 1000
    until(
        lambda: (
            far.publish(acknowledge, {"frame_id": "planner", "stamp": {"sec": now}}),
            waiting.result(0.05)["done"],
        )[1],
        "the step is acknowledged",
        20,
    )
    assert waiting.result()["reply"]["success"]
    until(lambda: far.wait(subscriptions["/clock"], 1)[-1]["clock"]["sec"] >= 1, "/clock has the time of the step")
    assert not place.answer("sim")["warnings"], "the simulator, which publishes the time, does not report it as missing"
    assert place.named("fail", "encoders_silent")["success"]
    end = place.step(0.2)["stamp"]
    until(lambda: far.wait(subscriptions["/clock"], 1)[-1]["clock"] == end, "/clock has the step's end time")
    before = {
        "sec": end["sec"] - (end["nanosec"] < 1e8),
        "nanosec": int((end["nanosec"] - 1e8) % 1e9),
    }
    for topic in ("/joint_states", "/odom"):
        last_stamp = far.wait(subscriptions[topic], 1)[-1]["header"]["stamp"]
        assert (last_stamp["sec"], last_stamp["nanosec"]) < (before["sec"], before["nanosec"]), topic
    assert place.call("/sim/reset", "std_srvs/Trigger")["success"]
    assert place.answer("sim")["truth"][:2] == [3.0, 8.2]
    stamped = far.advertise("/cmd_vel", "geometry_msgs/TwistStamped")  # the type that Nav2 of Kilted publishes
    until(lambda: go(stamped, {"twist": {"linear": {"x": 0.2}}}) > 0.05, "the robot follows stamped velocities", 30)


def test_services_change_a_simulation_in_real_time(place: Place) -> None:
    far = place.far
    scan = far.subscribe("/laser", "sensor_msgs/LaserScan")
    view = far.subscribe("/sim/view", "sensor_msgs/Image")
    place.worker.start(place.config(names="r1", drive="wheels", view=5.0, laser={"beams": 8}))
    first = far.wait(scan, 1, 20)[0]
    assert first["header"]["frame_id"] == "mobile_base_double_lidar"
    assert first["header"]["stamp"]["sec"] > 1_700_000_000
    picture = far.wait(view, 1, 20)[0]
    assert (picture["width"], picture["encoding"]) == (800, "rgb8")
    assert not far.publishers("/odometry")  # BaseControl publishes it
    assert not far.publishers("/clock")
    wheels = far.advertise("/wheel_command", "sensor_msgs/JointState")

    def drive() -> float:
        far.publish(wheels, {"name": WHEELS[::-1], "velocity": [1.0, 0.5]})
        return float(place.answer("sim")["truth"][2])

    start = place.answer("sim")["truth"][2]
    until(lambda: drive() > start + 0.05, "the robot turns to the left", 30)
    wrong = {"name": ["wheel"], "velocity": [1.0]}
    until(
        lambda: (far.publish(wheels, wrong), place.answer("sim")["refused_commands"])[1],
        "an invalid command is rejected",
    )
    text = place.answer("sim")["text"]
    assert re.search(r"; \d+ commands refused \(last: .+\)", text), text
    assert place.call("/sim/emergency_stop", "std_srvs/SetBool", data=True)["success"]
    assert place.answer("sim")["emergency_stop"]
    assert place.named("close", "kitchen_door")["success"]
    assert not place.answer("sim")["doors"]["kitchen_door"]
    assert place.named("open", "kitchen_door")["success"]
    assert "doors: kitchen_door" in place.named("open", "gate")["message"]
    spawned = {"name": "chest", "pose": {"x": 1.5, "y": 3.0}, "size": [0.4, 0.4, 0.4], "mass": 2.0}
    assert place.call("/sim/spawn", "midspan_msgs/Spawn", **spawned)["success"]
    assert "taken" in place.call("/sim/spawn", "midspan_msgs/Spawn", **spawned)["message"]
    assert "finite" in place.call("/sim/spawn", "midspan_msgs/Spawn", name="x", pose={"x": 1e9})["message"]
    assert place.named("remove", "chest")["success"]
    path = [{"x": 2.0, "y": 4.8}, {"x": 3.0, "y": 4.8}]
    assert place.call("/sim/walk", "midspan_msgs/Walk", name="anna", path=path)["success"]
    assert "people: anna" in place.call("/sim/walk", "midspan_msgs/Walk", name="bob", path=path)["message"]
    assert "links: none" in place.named("ride", "lift")["message"]
    assert place.named("fail", "encoders_silent")["success"]
    assert place.answer("sim")["faults"] == ["encoders_silent"]
    assert "laser_silent" in place.named("fail", "camera")["message"]
    assert place.named("mend", "encoders_silent")["success"]
    to = {"x": 1.6, "y": 2.4, "theta": math.pi / 2}
    assert place.call("/sim/teleport", "midspan_msgs/Teleport", pose=to)["success"]
    assert place.answer("sim")["truth"][1] == pytest.approx(2.4, abs=0.05)
    assert not place.call("/sim/teleport", "midspan_msgs/Teleport", pose={"x": 0.0, "y": 0.0})["success"]
    assert place.call("/sim/pause", "std_srvs/SetBool", data=True)["success"]
    paused = place.answer("sim")["time"]
    assert place.answer("sim")["time"] == paused
    assert place.step(0.5)["success"]
    assert place.answer("sim")["time"] == pytest.approx(paused + 0.5)
    assert place.call("/sim/pause", "std_srvs/SetBool", data=False)["success"]
    until(lambda: place.answer("sim")["time"] > paused + 0.6, "the simulation continues")


def test_an_invalid_plan_is_reported_and_corrected_by_a_reload(place: Place) -> None:
    place.worker.start(place.config(plan="castle"))
    health = place.worker.health()
    assert health.state == "waiting"
    assert "castle" in health.text
    assert place.worker.reload(place.config(plan="hall", speed="max"))
    assert place.worker.health().state == "running"
    until(lambda: place.answer("sim")["time"] > 1, "the simulation runs faster than real time")


def test_a_reload_of_the_yarp_release_does_not_restart_the_simulation(place: Place) -> None:
    """A restart would move the robot back to its start, and close all connections."""
    config = place.config(speed="max")
    place.worker.start(config)
    until(lambda: place.answer("sim")["time"] > 1, "the simulation runs")
    for changed in ({"release": "3.9"}, {"topics": [TopicPort.model_validate({"topic": "/scan", "as": "natural"})]}):
        before = place.answer("sim")
        config = config.model_copy(update={"yarp": config.yarp.model_copy(update=changed)})
        assert place.worker.reload(config)
        after = place.answer("sim")
        assert after["zid"] == before["zid"]
        assert after["time"] >= before["time"]
    assert not place.worker.reload(config.model_copy(update={"yarp": YarpSection(namespace="/other")}))


def test_depth_pictures_are_computed_only_for_subscribers(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []
    picture = DepthCamera.picture
    monkeypatch.setattr(DepthCamera, "picture", lambda *args: (taken.append(args[1]), picture(*args))[1])
    far, camera = place.far, {"rate": 10.0, "width": 32, "height": 16, "noise": 0.0}
    place.worker.start(place.config(speed="step", plan="hall", camera=camera))
    frames = far.subscribe("/tf_static", "tf2_msgs/TFMessage", latched=True)
    (message,) = far.wait(frames, 1)
    transforms = {t["child_frame_id"]: t for t in message["transforms"]}
    assert {name: t["header"]["frame_id"] for name, t in transforms.items()} == {
        "laser": "base_link", "camera_link": "base_link", "camera_depth_optical_frame": "camera_link",
        "base_footprint": "base_link",
    }  # fmt: skip
    place.step(0.5)
    assert not taken  # no image is rendered without subscribers
    subscriptions = {
        "/camera/depth/image_rect_raw": far.subscribe("/camera/depth/image_rect_raw", "sensor_msgs/Image"),
        "/camera/depth/camera_info": far.subscribe("/camera/depth/camera_info", "sensor_msgs/CameraInfo"),
        "/camera/depth/points": far.subscribe("/camera/depth/points", "sensor_msgs/PointCloud2"),
    }
    for topic in subscriptions:
        far.until_published(topic)
    until(
        lambda: (place.step(0.1), all(far.wait(end, 1, 0.2) for end in subscriptions.values()))[1],
        "all topics arrive",
        20,
    )

    def of_one_step() -> list[dict[str, Any]]:
        """Return the newest messages, once the messages of the last step have arrived on all topics."""
        newest = [far.wait(end, 1)[-1] for end in subscriptions.values()]
        return newest if newest[0]["header"] == newest[1]["header"] == newest[2]["header"] else []

    depth, info, cloud = until(of_one_step, "the messages of one step have the same header")
    assert len(taken) == len(set(taken))  # the image and the points share one rendering
    assert (depth["width"], depth["height"], info["k"][2]) == (32, 16, 15.5)
    assert cloud["row_step"] == 32 * 12


def test_depths_in_millimeters_are_zero_if_invalid() -> None:
    seen = np.array([[1.2345, np.inf, -np.inf], [np.nan, 0.0004, 64.9]], np.float32)
    image = messages.depth(5, seen, "16UC1")
    assert (image["encoding"], image["step"]) == ("16UC1", 6)
    assert image["data"].view(np.uint16).tolist() == [1234, 0, 0, 0, 0, 64900]


def test_late_zeros_stop_the_robot() -> None:
    simulator = MagicMock()
    for method in ("_try", "_drive_wheels"):
        setattr(simulator, method, partial(getattr(Simulator, method), simulator))
    motors = simulator.simulation.wheels.motors
    simulator.simulation.robot.motor_timeout, motors.names = 0.1, ("l", "r")
    simulator._now.return_value = 10_000_000_000

    def drive(x: float, rate: float) -> list[Any]:
        """Command a velocity and wheels; return the calls that passed."""
        simulator.simulation.command.reset_mock()
        motors.drive.reset_mock()
        Simulator._velocity(simulator, {"linear": {"x": x, "y": 0.0}, "angular": {"z": 0.0}})
        header = {"stamp": {"sec": 1, "nanosec": 0}}
        Simulator._wheels(simulator, {"header": header, "name": ["l", "r"], "velocity": [rate, rate]})
        return [*simulator.simulation.command.call_args_list, *motors.drive.call_args_list]

    simulator._pace.stood_still.return_value = False
    assert drive(0.1, 1.0) == [call(Twist(0.1, 0.0, 0.0))], "the wheels' command has an old stamp"
    simulator._pace.stood_still.return_value = True
    assert drive(0.1, 1.0) == []
    assert drive(0.0, 0.0) == [call(Twist(0.0, 0.0, 0.0)), call([0.0, 0.0])]
