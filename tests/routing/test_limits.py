"""Priorities, rate limits and the depth of histories."""

from __future__ import annotations

import itertools

import pytest

from bridge.routing.limits import BULK_DEPTH, STREAM_DEPTH, Priority, RateLimit, default_priority, stream_depth
from tests.support.clock import ProcessClock


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
def test_a_topic_has_a_default_priority_by_name_and_type(
    topic: str, type_name: str, latched: bool, priority: Priority
) -> None:
    assert default_priority(topic, type_name, latched=latched) is priority


@pytest.mark.parametrize(("source_hz", "limit", "passed"), [(100, 10, 100), (10, 10, 100), (5, 10, 50), (30, 20, 200)])
def test_rate_limit_meets_its_mean(monkeypatch: pytest.MonkeyPatch, source_hz: int, limit: int, passed: int) -> None:
    clock = ProcessClock(monkeypatch)
    gate = RateLimit(limit)
    got = 0
    for n in range(10 * source_hz):
        clock.now = 1000.0 + n / source_hz
        got += gate.passes()
    assert abs(got - passed) <= max(2, passed * 0.06)


def test_rate_limit_meets_its_mean_though_messages_come_in_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ProcessClock(monkeypatch)
    gate = RateLimit(30)
    passed = []
    for n in range(1000):
        # 100 Hz, but every half second the machine is busy with something else for 70 ms.
        late = max(0.0, 0.07 - (n % 50) / 100)
        clock.now = 1000.0 + n / 100 + late
        if gate.passes():
            passed.append(clock.now)
    assert len(passed) == pytest.approx(300, rel=0.02)
    assert min(b - a for a, b in itertools.pairwise(passed)) >= 0.5 / 30


def test_types_of_unbounded_size_have_a_short_history() -> None:
    assert stream_depth("std_msgs/Header header\nuint8[] data\n") == BULK_DEPTH
    for small in ("string data\n", "float32[] ranges\n", "uint8[16] uuid\nuint8 UINT8=2 # uint8[] x\n"):
        assert stream_depth(small) == STREAM_DEPTH
