"""Small parts of the routes: classes, rate limits, ages, static transforms."""

from __future__ import annotations

import itertools
import queue
import time

import pytest
from rosbags.typesys import Stores, get_typestore

from bridge.routing import age, rate
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.priority import Priority, default_priority
from bridge.routing.route import BULK_DEPTH, STREAM_DEPTH, stream_depth
from bridge.routing.static_tf import TF_TYPE, StaticTransforms
from tests.support.wait import until

STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.mark.parametrize(
    ("topic", "type_name", "latched", "priority"),
    [
        ("/cmd_vel", "geometry_msgs/msg/Twist", False, Priority.COMMAND),
        ("/robot/cmd_vel_nav", "geometry_msgs/msg/TwistStamped", True, Priority.COMMAND),
        ("/odom_twist", "geometry_msgs/msg/Twist", False, Priority.STREAM),
        ("/cmd_vel", "std_msgs/msg/String", False, Priority.STREAM),
        ("/map", "nav_msgs/msg/OccupancyGrid", True, Priority.STATE),
        ("/map", "nav_msgs/msg/OccupancyGrid", False, Priority.STREAM),
    ],
)
def test_default_priority(topic: str, type_name: str, latched: bool, priority: Priority) -> None:
    assert default_priority(topic, type_name, latched=latched) is priority


class Clock:
    """A clock that the test turns."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1000.0
        monkeypatch.setattr(time, "monotonic", lambda: self.now)
        monkeypatch.setattr(time, "time_ns", lambda: int(self.now * 1e9))
        monkeypatch.setattr(time, "clock_gettime_ns", lambda _clock: int(self.now * 1e9))


@pytest.mark.parametrize(("source_hz", "limit", "passed"), [(100, 10, 100), (10, 10, 100), (5, 10, 50), (30, 20, 200)])
def test_rate_limit_meets_its_mean(monkeypatch: pytest.MonkeyPatch, source_hz: int, limit: int, passed: int) -> None:
    clock = Clock(monkeypatch)
    gate = rate.RateLimit(limit)
    got = 0
    for n in range(10 * source_hz):
        clock.now = 1000.0 + n / source_hz
        got += gate.passes()
    assert abs(got - passed) <= max(2, passed * 0.06)


def test_rate_limit_meets_its_mean_though_messages_come_in_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    gate = rate.RateLimit(30)
    passed = []
    for n in range(1000):
        # 100 Hz, and every half second the machine does something else for 70 ms.
        late = max(0.0, 0.07 - (n % 50) / 100)
        clock.now = 1000.0 + n / 100 + late
        if gate.passes():
            passed.append(clock.now)
    assert len(passed) == pytest.approx(300, rel=0.02)
    assert min(b - a for a, b in itertools.pairwise(passed)) >= 0.5 / 30


def test_what_carries_bytes_without_end_has_a_short_history() -> None:
    assert stream_depth("std_msgs/Header header\nuint8[] data\n") == BULK_DEPTH
    for small in ("string data\n", "float32[] ranges\n", "uint8[16] uuid\nuint8 UINT8=2 # uint8[] x\n"):
        assert stream_depth(small) == STREAM_DEPTH


def test_age_is_waiting_time_whatever_the_clock_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    gate = age.AgeGate()
    offset = -3600.0
    ages(clock, gate, offset)
    for _ in range(5):
        clock.now += 0.1
        assert gate.age(int((clock.now + offset - 0.001) * 1e9)) < 0.01
    clock.now += 2.0
    assert gate.age(int((clock.now + offset - 2.0) * 1e9)) == pytest.approx(2.0, abs=0.01)


def ages(clock: Clock, gate: age.AgeGate, offset: float, count: int = 20) -> list[float]:
    """Ages of messages at 20 Hz that come at once from a source whose clock differs so much."""
    found = []
    for _ in range(count):
        clock.now += 0.05
        found.append(gate.age(int((clock.now + offset) * 1e9)))
    return found


@pytest.mark.parametrize("jump", [-3600.0, -1.0, 3600.0])
def test_a_source_whose_clock_is_set_is_heard_again(monkeypatch: pytest.MonkeyPatch, jump: float) -> None:
    clock, gate = Clock(monkeypatch), age.AgeGate()
    ages(clock, gate, 0.0)
    after = ages(clock, gate, jump)
    held = [a for a in after if a > 0.1]
    assert len(held) <= age.HOLD / 0.05 + 1
    assert after[-1] < 0.01
    assert gate.age(int((clock.now + jump - 2.0) * 1e9)) > 1.9, "what is old is old on the new scale too"


def test_setting_this_machines_clock_makes_nothing_old(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = Clock(monkeypatch), age.AgeGate()
    ages(clock, gate, 0.0)
    monkeypatch.setattr(time, "time_ns", lambda: int((clock.now + 3600) * 1e9))
    assert max(ages(clock, gate, 0.0)) < 0.01


def test_what_piled_up_before_a_clock_was_set_back_stays_old(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = Clock(monkeypatch), age.AgeGate()
    ages(clock, gate, 0.0)
    clock.now += 3.0
    backlog = [gate.age(int((clock.now - 3600.0 - 3.0 + n * 0.05) * 1e9)) for n in range(60)]
    assert min(backlog) > age.HOLD


def test_what_piled_up_for_a_new_source_is_old(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = Clock(monkeypatch), age.AgeGate()
    backlog = [gate.age(int((clock.now - 1.3 + n * 0.05) * 1e9)) for n in range(26)]
    assert min(backlog) > age.HOLD
    assert ages(clock, gate, 0.0)[-1] < 0.01


def test_a_single_message_of_a_new_source_is_fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    assert age.AgeGate().age(int((clock.now - 0.01) * 1e9)) == 0.0
    assert age.AgeGate().age(int((clock.now + 100.0) * 1e9)) == 0.0


def test_a_message_that_was_overtaken_is_old(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = Clock(monkeypatch), age.AgeGate()
    ages(clock, gate, 0.0)
    assert gate.age(int((clock.now - 0.02) * 1e9)) > 1.0
    assert max(ages(clock, gate, 0.0)) < 0.01


def test_a_worker_that_stood_still_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    pulse = age.Pulse()
    for _ in range(5):
        clock.now += 0.1
        pulse.beat()
        assert not pulse.stood_still(0.5)
    clock.now += 3.0
    assert pulse.stood_still(0.5)
    pulse.beat()
    assert pulse.stood_still(0.5), "what piled up is still being read"
    for _ in range(6):
        clock.now += 0.1
        pulse.beat()
    assert not pulse.stood_still(0.5)


def test_the_pulse_tells_of_a_standstill_once_the_process_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, told = Clock(monkeypatch), queue.SimpleQueue[float]()
    pulse = age.Pulse(told.put)
    pulse.start()
    try:
        clock.now += 20.0
        assert told.get(timeout=40) == pytest.approx(20.0)
        assert pulse.stood_still(0.5), "what piled up is still being read"
    finally:
        pulse.stop()


def transforms(*children: str, x: float = 0.0) -> bytes:
    types = STORE.types
    time_ = types["builtin_interfaces/msg/Time"](1, 2)
    one = types["geometry_msgs/msg/Transform"](
        types["geometry_msgs/msg/Vector3"](x, 0.0, 0.0), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    header = types["std_msgs/msg/Header"](time_, "base")
    stamped = [types["geometry_msgs/msg/TransformStamped"](header, child, one) for child in children]
    return bytes(STORE.serialize_cdr(types[TF_TYPE](stamped), TF_TYPE))


def test_static_transforms_merge_by_child_frame() -> None:
    merged = StaticTransforms()
    merged.merge(transforms("a", "b"))
    whole = STORE.deserialize_cdr(merged.merge(transforms("b", "c", x=5.0)), TF_TYPE)
    assert {t.child_frame_id: t.transform.translation.x for t in whole.transforms} == {"a": 0.0, "b": 5.0, "c": 5.0}


@pytest.mark.parametrize("junk", [b"", b"\x00\x01\x00\x00", transforms("a")[:-9]])
def test_static_transforms_refuse_junk(junk: bytes) -> None:
    with pytest.raises(ValueError, match="TFMessage"):
        StaticTransforms().merge(junk)


def test_urgent_work_goes_first() -> None:
    dispatcher = Dispatcher("test")
    done: list[str] = []
    dispatcher.submit(Priority.STREAM, lambda: done.append("stream"))
    dispatcher.submit(Priority.STATE, lambda: done.append("state"))
    dispatcher.submit(Priority.COMMAND, lambda: done.append("command"))
    dispatcher.start()
    try:
        until(lambda: len(done) == 3, "all done")
        assert done == ["command", "state", "stream"]
    finally:
        dispatcher.stop()
