"""Stamps of a simulation in real time: one tick apart even in bursts, and never ahead of the system clock."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from sim import stamps
from sim.base import TICK_NS
from sim.pace import Pace
from sim.stamps import WallStamps
from tests.sim.test_hub import Place
from tests.support.clock import Clock
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Reader


class Clocks(Clock):
    """A machine's system clock and monotonic clock, set by the test."""

    wall = 1_760_000_000.0

    def monotonic_ns(self) -> int:
        return round(self.now * 1e9)

    def time_ns(self) -> int:
        return round((self.wall + self.now) * 1e9)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clocks:
    fake_clocks = Clocks()
    monkeypatch.setattr("sim.pace.time", fake_clocks)
    monkeypatch.setattr(stamps, "time", fake_clocks)
    return fake_clocks


def stamped(pace: Pace, wall: WallStamps) -> list[int]:
    return [wall.stamp(pace.moment()) for _ in range(pace.due())]


def test_stamps_of_a_burst_are_one_tick_apart_and_never_ahead(clock: Clocks) -> None:
    pace, wall = Pace(1.0), WallStamps()
    stamps_ns: list[int] = []
    for passed in (0.01, 0.0085, 0.01, 0.047, 0.0004, 0.01, 0.1, 0.01, 0.01, 0.01, 0.2, 0.01, 0.01, 0.01, 0.01, 0.01):
        clock.now += passed
        stamps_ns += stamped(pace, wall)
        assert 0 <= clock.time_ns() - stamps_ns[-1] <= 250_000_000
    assert {round((after - before) / 10) for before, after in itertools.pairwise(stamps_ns)} == {TICK_NS // 10}
    assert len(stamps_ns) > 40


def test_skipped_time_is_a_gap_of_whole_ticks(clock: Clocks) -> None:
    pace, wall = Pace(1.0), WallStamps()
    clock.now += 0.01
    stamps_ns = stamped(pace, wall)
    clock.now += 3.0
    stamps_ns += stamped(pace, wall)
    assert (stamps_ns[1] - stamps_ns[0]) % TICK_NS in (0, 1, TICK_NS - 1)
    assert 0 <= clock.time_ns() - stamps_ns[-1] <= 250_000_000


def test_a_pause_ends_with_a_later_stamp(clock: Clocks) -> None:
    pace, wall = Pace(1.0), WallStamps()
    stamps_ns: list[int] = []
    for _ in range(20):
        clock.now += 0.0083  # as early as a tick may be
        stamps_ns += stamped(pace, wall)
        pace.begin()
    assert all(after - before >= TICK_NS - 1 for before, after in itertools.pairwise(stamps_ns))


@pytest.mark.parametrize("step", [-3600.0, 3600.0, 0.3])
def test_stamps_follow_steps_of_the_system_clock(clock: Clocks, step: float) -> None:
    pace, wall = Pace(1.0), WallStamps()
    clock.wall += step
    clock.now += 0.01
    (stamp,) = stamped(pace, wall)
    assert abs(clock.time_ns() - stamp) < 10_000_000


def test_errors_of_reading_the_clocks_do_not_change_stamps(clock: Clocks) -> None:
    pace, wall = Pace(1.0), WallStamps()
    clock.now += 0.01
    first = stamped(pace, wall)[0]
    clock.wall += 0.03
    clock.now += 0.01
    assert stamped(pace, wall)[0] - first == pytest.approx(TICK_NS, abs=1)


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as rig:
        yield rig


TOPICS = {
    "/joint_states": ("sensor_msgs/JointState", 1),
    "/odom": ("nav_msgs/Odometry", 2),
    "/ground_truth": ("nav_msgs/Odometry", 2),
    "/tf": ("tf2_msgs/TFMessage", 2),
    "/scan": ("sensor_msgs/LaserScan", 5),
    "/camera/depth/camera_info": ("sensor_msgs/CameraInfo", 10),
    "/camera/depth/image_rect_raw": ("sensor_msgs/Image", 10),
    "/camera/depth/points": ("sensor_msgs/PointCloud2", 10),
}
"""Types of the stamped topics, and ticks between two messages."""


def hold_up(place: Place) -> None:
    """Block the simulation's thread for 45 of every 60 ms, like a busy machine, so that it ticks in bursts."""
    running = place.worker._running
    assert running is not None
    never = threading.Event()
    running.host.loop.call(lambda: running.host.loop.every(0.06, lambda: never.wait(0.045)))


def stamp_ns(message: dict[str, Any]) -> int:
    header = message["transforms"][0]["header"] if "transforms" in message else message["header"]
    return int(header["stamp"]["sec"]) * 1_000_000_000 + int(header["stamp"]["nanosec"])


def evenly(stamps_ns: list[int], every: int) -> bool:
    """Return whether stamps (ns) are apart by whole ticks, at least by a period, and at least half exactly by a period.

    Messages may be lost. Time is skipped where the machine left the simulation no processor for a quarter of a second:
    these steps do not count for the half.
    """
    steps = [(after - before) / TICK_NS for before, after in itertools.pairwise(stamps_ns)]
    whole = all(abs(step - round(step)) < 1e-3 for step in steps)
    exact = sum(abs(step - every) < 1e-3 for step in steps)
    unbroken = sum(step * TICK_NS < 250e6 for step in steps)
    return whole and min(steps) > every - 1e-3 and exact >= max(1, unbroken / 2)


def test_evenly_needs_a_period_between_half_of_the_stamps() -> None:
    ticks = [0, 2, 4, 8, 12, 16]
    assert evenly([tick * TICK_NS for tick in [*ticks, 18, 20]], 2)
    assert not evenly([tick * TICK_NS for tick in ticks], 2)


def test_stamps_of_all_topics_are_a_period_apart_in_bursts(place: Place) -> None:
    far = place.far
    camera = {"rate": 10.0, "width": 32, "height": 16, "noise": 0.0}
    subscriptions = {topic: far.subscribe(topic, kind, depth=1000) for topic, (kind, _) in TOPICS.items()}
    place.worker.start(place.config(plan="hall", camera=camera, laser={"beams": 8, "rate": 20.0}))
    for topic, end in subscriptions.items():
        until(lambda end=end: far.wait(end, 1, 0.2), f"{topic} arrives", 20)
    first = {topic: len(far.wait(end, 1)) for topic, end in subscriptions.items()}
    hold_up(place)
    for topic, (_, every) in TOPICS.items():
        count = max(10, 200 // every)
        messages = far.wait(subscriptions[topic], first[topic] + count, 30)[first[topic] :]
        assert len(messages) >= count, topic
        stamps_ns = [stamp_ns(message) for message in messages]
        assert evenly(stamps_ns, every), (topic, stamps_ns)
        assert -1.0 < time.time() - stamps_ns[-1] / 1e9 < 60.0, topic


def test_yarp_envelopes_are_a_period_apart(place: Place) -> None:
    names = NameClient(Address("127.0.0.1", place.port), namespace="/root")
    with NameServer(port=place.port, gc_seconds=0):
        place.worker.start(place.config(plan="hall", yarp="/cer"))
        until(lambda: names.query("/cer/odometry:o"), "the port is registered", 20)
        stamps_ns: list[int] = []
        # strict and without acknowledgments, so that no message of a burst replaces another
        with Reader("/test/odometry:i", strict=True, naming=names) as reader:
            connections.connect(names, "/cer/odometry:o", "/test/odometry:i", "fast_tcp")
            reader.read()
            hold_up(place)
            while len(stamps_ns) < 60:
                envelope = reader.read().envelope
                assert envelope is not None
                stamps_ns.append(round(float(envelope.split()[1]) * 1e9))
        place.worker.stop()
    assert evenly(stamps_ns[1:], 2)


def test_a_step_in_real_time_lasts_its_duration(place: Place) -> None:
    far = place.far
    joints = far.subscribe("/joint_states", "sensor_msgs/JointState", depth=1000)
    place.worker.start(place.config(plan="hall"))
    until(lambda: far.wait(joints, 1, 0.2), "joint states arrive", 20)
    assert place.call("/sim/pause", "std_srvs/SetBool", data=True)["success"]
    paused = place.answer("sim")["time"]
    until(lambda: stamp_ns({"header": place.step(0.3)}) < time.time_ns(), "a step ends with a stamp in the past")
    assert place.answer("sim")["time"] == pytest.approx(paused + 0.3)
    assert place.call("/sim/pause", "std_srvs/SetBool", data=False)["success"]
    until(lambda: place.answer("sim")["time"] > paused + 0.5, "the simulation continues")
    stamps_ns = [stamp_ns(message) for message in far.wait(joints, 1)]
    assert min(after - before for before, after in itertools.pairwise(stamps_ns)) >= TICK_NS - 1000
