"""Sensor data waits for its pose in a bounded queue, for a bounded time."""

from __future__ import annotations

import logging

import pytest

from bridge.clock import RunClock, SystemClock
from navigation.frames import FramesError
from navigation.sensor_queue import PATIENCE_NS, SensorQueue

LIMIT = 3


class Sensor:
    """A queue of numbers, with a clock and poses that the test sets.

    Attributes:
        known: numbers whose poses are known.
        used: numbers that were used, in sequence.
    """

    def __init__(self) -> None:
        self.now_ns = 5 * PATIENCE_NS
        self.known: set[int] = set()
        self.used: list[int] = []
        clock = RunClock(system=SystemClock(lambda: self.now_ns, lambda: 0, poll=0.0))
        log = logging.getLogger("sensor")
        self.queue = SensorQueue(self.use, limit=LIMIT, what="number", clock=clock, log=log)

    def use(self, number: int) -> None:
        if number < 0:
            raise ValueError(f"{number} is negative")
        if number not in self.known:
            raise FramesError(f"the pose of {number} is unknown")
        self.used.append(number)

    def add(self, *numbers: int) -> None:
        for number in numbers:
            self.queue.add(number)


@pytest.fixture
def sensor() -> Sensor:
    return Sensor()


def test_an_item_with_a_known_pose_is_used_at_once(sensor: Sensor) -> None:
    sensor.known = {1}
    sensor.add(1)
    assert sensor.used == [1]
    assert (sensor.queue.dropped, sensor.queue.received_ns) == (0, sensor.now_ns)


def test_items_are_used_once_in_order_of_arrival_when_their_poses_arrive(sensor: Sensor) -> None:
    sensor.add(1, 2)
    sensor.queue.work()
    assert not sensor.used
    sensor.known = {1, 2, 3}
    sensor.add(3)
    sensor.queue.work()
    assert sensor.used == [1, 2, 3]


def test_an_item_of_another_sensor_does_not_wait_for_the_first(sensor: Sensor) -> None:
    sensor.known = {2}
    sensor.add(1, 2)
    assert sensor.used == [2]


def test_an_item_is_dropped_after_a_second_with_its_last_reason(sensor: Sensor) -> None:
    sensor.add(1)
    sensor.now_ns += PATIENCE_NS - 1
    sensor.queue.work()
    assert sensor.queue.dropped == 0
    sensor.now_ns += 1
    sensor.queue.work()
    assert (sensor.queue.dropped, sensor.queue.trouble) == (1, "the pose of 1 is unknown")
    sensor.known = {1}
    sensor.queue.work()
    assert not sensor.used


def test_a_full_queue_drops_the_oldest(sensor: Sensor) -> None:
    sensor.add(*range(1, LIMIT + 3))
    assert (sensor.queue.dropped, sensor.queue.trouble) == (2, "the pose of 2 is unknown")
    sensor.known = set(range(10))
    sensor.queue.work()
    assert sensor.used == [3, 4, 5]


def test_an_invalid_item_is_dropped_at_once_and_the_next_used(sensor: Sensor) -> None:
    sensor.known = {2}
    sensor.add(-1)
    assert (sensor.queue.dropped, sensor.queue.trouble) == (1, "-1 is negative")
    sensor.add(2)
    assert (sensor.used, sensor.queue.trouble) == ([2], "")


def test_a_reason_is_logged_once_until_an_item_is_used(sensor: Sensor, caplog: pytest.LogCaptureFixture) -> None:
    sensor.known = {2}
    sensor.add(-1, -1)
    sensor.queue.drop("its ranges are empty")
    sensor.add(2, -1)
    texts = ["-1 is negative", "its ranges are empty", "-1 is negative"]
    logged = [record.getMessage() for record in caplog.records if record.name == "sensor"]
    assert logged == [f"dropped a number: {text}" for text in texts]
    assert sensor.queue.dropped == 4


def test_items_from_before_a_jump_of_the_clock_are_discarded(sensor: Sensor) -> None:
    sensor.add(1)
    sensor.queue.clear()
    assert sensor.queue.received_ns is None
    sensor.known = {1}
    sensor.queue.work()
    assert (sensor.used, sensor.queue.dropped) == ([], 0)


def test_an_item_from_the_future_is_dropped(sensor: Sensor) -> None:
    """The clock was set back, and the queue has not been cleared yet."""
    sensor.add(1)
    sensor.now_ns -= 1
    sensor.queue.work()
    assert sensor.queue.dropped == 1
