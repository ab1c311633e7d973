"""``midspan tf`` on a real hub: frames from a side and from a hub node, and problems with frames."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from bridge.cli.frames.tf import connecting_frames
from bridge.client.transforms import FrameMeter
from bridge.messages.registry import Registry
from bridge.tf.buffer import TransformBuffer
from bridge.tf.stamped import Stamped, write
from bridge.tf.transform import angles_of
from tests.cli.conftest import Midspan, Outcome
from tests.peers.daemon.workers import EngineWorker, FakeWorker
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

TF = "tf2_msgs/msg/TFMessage"
UNIT = (0.0, 0.0, 0.0, 1.0)
QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))


@contextmanager
def published_frames(worker: EngineWorker, topic: str, *frames: tuple[str, str], delay: float = 0.0) -> Iterator[None]:
    """A program on the side that publishes frames, 1 m apart, fifty times a second."""
    stop = threading.Event()
    writer = worker.advertise(topic, TF)

    def talk() -> None:
        while not stop.wait(0.02):
            at = time.time_ns() - round(delay * 1e9)
            transforms = [Stamped(a, b, at + n, (1.0, 0.0, 0.0), QUARTER) for n, (a, b) in enumerate(frames)]
            worker.side.write(writer, write(transforms))

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def wait_for_route(worker: EngineWorker, topic: str) -> None:
    until(
        lambda: any((r.topic, r.direction) == (topic, "in") for r in worker.engine.status().routes),
        f"{topic} has its route to the hub",
        20,
    )


@pytest.fixture
def robot(network: HubNetwork, registry: Registry, closing: list[Any]) -> Iterator[EngineWorker]:
    """A side with a moving base, and a hub node that publishes a laser's frame on the base."""
    worker = EngineWorker(network, registry)
    closing.append(worker)
    fixed = FakeWorker(network, "mounts")
    closing.append(fixed)
    cdr = write([Stamped("base_link", "laser", 0, (0.0, 2.0, 0.0), UNIT)])
    fixed.publish("/tf_static", TF, registry.ros2(TF).type_id, cdr)
    with published_frames(worker, "/tf", ("map", "odom"), ("odom", "base_link"), delay=0.5):
        wait_for_route(worker, "/tf")
        yield worker


ALL = ["base_link", "laser", "map", "odom"]


def run_until(midspan: Midspan, *words: str, fits: Callable[[Outcome], object]) -> Outcome:
    """Repeat a command until its output meets a condition: on a busy machine, some frames arrive too late."""
    return until(lambda: (done := midspan("tf", *words)).code == 0 and fits(done) and done, f"{words} succeeds", 30)  # type: ignore[return-value]


@pytest.mark.usefixtures("robot")
def test_tree_shows_the_frames_of_all_nodes(midspan: Midspan) -> None:
    run_until(midspan, "list", "--duration", "0.2", fits=lambda done: done.out.split() == ALL)
    listed = run_until(
        midspan, "list", "--duration", "0.2", "--side", "ros1", fits=lambda done: len(done.out.split()) == 3
    )
    assert "laser" not in listed.out
    tree = run_until(midspan, "tree", "--duration", "0.2", fits=lambda done: len(done.out.splitlines()) == 4)
    lines = tree.out.splitlines()
    assert [line.partition("  (")[0] for line in lines] == ["map", "  odom", "    base_link", "      laser"]
    assert lines[3].endswith("(static, /midspan_mounts)")
    assert lines[1].endswith("ROS 1 by robot1)")
    dot = run_until(midspan, "tree", "--duration", "0.2", "--dot", fits=lambda done: "laser" in done.out)
    assert dot.out.startswith("digraph G {")
    assert '"base_link" -> "laser"' in dot.out
    entries = run_until(midspan, "tree", "--duration", "0.2", "--json", fits=lambda done: len(done.json()) == 3).json()
    frames = {frame["frame"]: frame for frame in entries}
    assert frames["laser"]["static"]
    assert frames["odom"]["parent"] == "map"
    assert frames["odom"]["sources"][0]["authority"] == "ROS 1 by robot1"


def test_tree_waits_for_every_publisher(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    nodes = FakeWorker(network, "one"), FakeWorker(network, "two")
    closing.extend(nodes)
    for node, (parent, child) in zip(nodes, ("ab", "bc"), strict=True):
        cdr = write([Stamped(parent, child, 0, (0.0, 0.0, 0.0), UNIT)])
        node.publish("/tf_static", TF, registry.ros2(TF).type_id, cdr)
    until(
        lambda: all(len(node.hub.graph.publishers("/tf_static")) == 2 for node in nodes),
        "the router knows both publishers",
    )
    done = run_until(midspan, "list", fits=lambda done: "listened for 0." in done.err)
    assert done.out.split() == ["a", "b", "c"]


@pytest.mark.usefixtures("robot")
def test_tree_waits_longer_for_transforms_from_a_side(midspan: Midspan) -> None:
    """A side has one publisher on the hub for all of its programs, some of which may publish late."""
    assert "listened for" not in run_until(midspan, "list", fits=lambda done: done.out.split() == ALL).err


@pytest.mark.usefixtures("robot")
def test_echo_prints_the_pose_of_a_frame(midspan: Midspan) -> None:
    done = midspan("tf", "echo", "map", "laser", "--count", "2", "--rate", "50", "--json", "--timeout", "20")
    first, second = done.lines()
    assert (first["reference"], first["frame"]) == ("map", "laser")
    assert first["translation"] == {"x": pytest.approx(1), "y": pytest.approx(-1), "z": 0}
    assert abs(first["rotation"]["z"]) == pytest.approx(1)
    assert second["time_ns"] >= first["time_ns"]
    assert 0.4 < first["age"] < 20
    text = midspan("tf", "echo", "odom", "base_link", "--count", "1", "--timeout", "20").out
    assert "1.000, 0.000, 0.000 m" in text
    assert "0.00, -0.00, 90.00 degrees" in text.replace(" 0.00, 90", " -0.00, 90")
    assert midspan("tf", "echo", "base_link", "laser", "--count", "1", "--timeout", "20").out.startswith("static\n")


@pytest.mark.usefixtures("robot")
def test_monitor_prints_rates_delays_and_publishers(midspan: Midspan) -> None:
    done = run_until(
        midspan, "monitor", "--duration", "0.5", "--json",
        fits=lambda done: len(done.lines()[-1]) == 3 and done.lines()[-1][0]["rate"] > 0,
    )  # fmt: skip
    frames = {frame["frame"]: frame for frame in done.lines()[-1]}
    base, laser = frames["base_link"], frames["laser"]
    assert base["authorities"] == ["ROS 1 by robot1"]
    assert base["rate"] > 0
    assert 0.5 < base["delay"] <= base["longest_delay"] < 20
    assert (laser["static"], laser["delay"], laser["count"]) == (True, None, 1)
    table = run_until(
        midspan, "monitor", "odom", "laser", "--duration", "0.2", fits=lambda done: "odom to laser: newest" in done.out
    ).out
    assert "base_link" in table
    assert "map" not in table


def test_errors_are_reported(
    midspan: Midspan,
    network: HubNetwork,
    registry: Registry,
    closing: list[Any],
    robot: EngineWorker,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    other = FakeWorker(network, "other")
    closing.append(other)
    flawed = [Stamped("base_link", "wheel", time.time_ns(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))]
    for topic, frames in (("/tf", flawed), ("/r2/tf_static", [Stamped("a", "b", 0, (0.0, 0.0, 0.0), UNIT)])):
        other.publish(topic, TF, registry.ros2(TF).type_id, write(frames))
    unknown = '"wheel" passed to lookupTransform argument source_frame does not exist.'

    def is_reported() -> bool:
        """Return whether only the frame is unknown; on a busy machine, no transform may arrive in time."""
        done = midspan("tf", "echo", "map", "wheel", "--timeout", "0.5")
        assert done.code == 1
        return unknown in done.err

    until(is_reported, "the unknown frame is named")
    assert midspan("tf", "echo", "map", "", "--timeout", "30").err.strip().endswith("frame_ids cannot be empty")
    tree = "tree", "--namespace", "r2", "--duration", "0.1"
    run_until(midspan, *tree, fits=lambda done: done.out.splitlines()[:1] == ["a"])
    assert midspan("tf", "monitor", "map").err == "midspan: name two frames, or none\n"
    run_until(
        midspan, "list", "--duration", "0.1", fits=lambda done: "refused: TF_DENORMALIZED_QUATERNION 1" in done.err
    )
    with published_frames(robot, "/r4/tf", ("map", "base"), ("odom", "base")):
        wait_for_route(robot, "/r4/tf")
        command = "list", "-v", "--namespace", "/r4", "--duration", "0.2"
        run_until(midspan, *command, fits=lambda done: "map, odom" in done.out)
    monkeypatch.setattr("bridge.client.transforms.PATIENCE", 0.1)
    none = midspan("tf", "list", "--namespace", "r3")
    assert (none.code, none.out) == (1, "")
    assert "no transform arrived on /r3/tf or /r3/tf_static" in none.err
    assert "transforms are on /r2/tf_static" in none.err


def test_transforms_that_are_not_bridged_are_echoed(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    worker = EngineWorker(network, registry, rules=[{"topic": "/tf", "deny": True}])
    closing.append(worker)
    with published_frames(worker, "/tf", ("map", "odom")):
        until(lambda: worker.engine.explain("/tf"), "the engine knows /tf")
        done = midspan("tf", "echo", "map", "odom", "--count", "1", "--timeout", "20")
    assert done.code == 0, done.err


def test_angles_are_about_fixed_axes() -> None:
    assert angles_of(QUARTER) == pytest.approx((0, 0, math.pi / 2))
    assert angles_of((0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)))[1] == pytest.approx(math.pi / 2)
    assert angles_of((0.5, 0.5, 0.5, 0.5)) == pytest.approx((math.pi / 2, 0, math.pi / 2))


def test_the_path_between_two_frames_leads_through_their_common_ancestor() -> None:
    buffer = TransformBuffer()
    for parent, child in ("ab", "bc", "bd", "de", "xy"):
        buffer.set_transform(parent, child, 1, (0, 0, 0), UNIT)
    frames = {info.name: info for info in buffer.frames()}
    assert connecting_frames(frames, "c", "e") == ["c", "e", "d"]
    assert connecting_frames(frames, "a", "c") == ["c", "b"]
    assert connecting_frames(frames, "c", "c") == []
    for parent, child in ("za", "az"):
        buffer.set_transform(parent, child, 2, (0, 0, 0), UNIT)
    assert connecting_frames({info.name: info for info in buffer.frames()}, "c", "nowhere")[:2] == ["c", "b"]


def test_a_meter_counts_the_last_five_seconds() -> None:
    meter = FrameMeter()
    assert (meter.rate(0.0), meter.delay, meter.longest) == (0.0, None, None)
    for n in range(2000):
        meter.add(n / 100, 10_000_000 * (n % 3))
    assert meter.rate(20.0) == pytest.approx(100)
    assert meter.delay == pytest.approx(0.01, rel=0.01)
    assert meter.longest == 0.02
    assert meter.rate(100.0) == 0.0
    assert meter.count == 2000
