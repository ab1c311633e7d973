"""Velocities from encoders with jittering, repeated or missing stamps, bursts, wraparounds, restarts and stops."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator, Sequence

import pytest

from navigation.base_control.base import DrivenBase
from navigation.base_control.encoders import PATIENCE, WINDOW, ReadingTimes
from navigation.base_control.kinematics import Traveled, WheelOdometry, kinematics
from navigation.base_control.section import BaseControlSection
from navigation.base_control.settings import resolved

RADIUS, DISTANCE = 0.16416, 0.338
SPEED, TURN = 0.3, 0.4
TOLERATED = 1.1
BASE = kinematics("cer", RADIUS, DISTANCE)
FASTEST = 1.5 * math.radians(100.0)
START = 1_760_000_000.0


def angles(seconds: float, speed: float = SPEED, turn: float = TURN) -> list[float]:
    return [(speed - turn * DISTANCE / 2) / RADIUS * seconds, (speed + turn * DISTANCE / 2) / RADIUS * seconds]


def late(delay: float, period: float, count: int = 1000) -> Iterator[tuple[float, float]]:
    """Yield (stamp, time of measurement): each stamp is late by up to ``delay``, and stamps never decrease."""
    random_delay = random.Random(1)
    last = 0.0
    for reading in range(count):
        stamp = max(last, reading * period + random_delay.uniform(0.0, delay))
        last = stamp
        yield stamp, reading * period


def bursts(longest: int, count: int = 1000) -> Iterator[tuple[float, float]]:
    """Yield 100 Hz readings stamped in bursts, 0.4 ms apart, as by a simulator that catches up on its ticks."""
    size, reading = random.Random(2), 0
    while reading < count:
        burst = size.randint(1, longest)
        end = (reading + burst) * 0.01
        for place in range(burst):
            yield end + place * 0.0004, (reading + place + 1) * 0.01
        reading += burst


def coarse(resolution: float, period: float, count: int = 1000) -> Iterator[tuple[float, float]]:
    for reading in range(count):
        yield math.floor(reading * period / resolution) * resolution, reading * period


STREAMS = {
    "even": [(0.01 * i, 0.01 * i) for i in range(1000)],
    "5 ms late": [*late(0.005, 0.01)],
    "20 ms late": [*late(0.02, 0.01)],
    "bursts of 4": [*bursts(4)],
    "bursts of 5": [*bursts(5)],
    "whole 20 ms": [*coarse(0.02, 0.01)],
    "1 kHz": [*late(0.003, 0.001, 3000)],
    "50 Hz": [*late(0.01, 0.02)],
    "20 Hz": [*late(0.01, 0.05)],
    "5 Hz": [*late(0.01, 0.2, 100)],
}


def driven(stream: Sequence[tuple[float, float]], *, measured: bool = False) -> list[Traveled]:
    odometry = WheelOdometry(BASE, FASTEST)
    rates = angles(1.0) if measured else None
    return [odometry.update(angles(at), START + stamp, rates) for stamp, at in stream]


@pytest.mark.parametrize("stream", STREAMS.values(), ids=STREAMS)
def test_velocities_from_angles_stay_near_the_true_ones(stream: list[tuple[float, float]]) -> None:
    readings = driven(stream)
    assert max(traveled.velocity.speed for traveled in readings) <= TOLERATED * SPEED
    assert max(abs(traveled.velocity.turn) for traveled in readings) <= TOLERATED * TURN
    settled = readings[len([stamp for stamp, _ in stream if stamp < 2 * WINDOW]) :]
    assert min(traveled.velocity.x for traveled in settled) >= 0.8 * SPEED
    assert readings[-1].distance == pytest.approx(SPEED * stream[-1][1], rel=0.02)


@pytest.mark.parametrize("stream", STREAMS.values(), ids=STREAMS)
def test_measured_velocities_are_used_unchanged(stream: list[tuple[float, float]]) -> None:
    for traveled in driven(stream, measured=True)[1:]:
        assert traveled.velocity == pytest.approx((SPEED, 0.0, TURN))


@pytest.mark.parametrize("rates", [None, [], [0.0, 0.0], [math.nan, 1.0], [math.inf, 1.0], [1.0]], ids=str)
def test_angles_are_differentiated_without_measured_velocities(rates: list[float] | None) -> None:
    odometry = WheelOdometry(BASE, FASTEST)
    for reading in range(100):
        odometry.update(angles(reading * 0.01), reading * 0.01, rates)
    assert odometry.now.velocity == pytest.approx((SPEED, 0.0, TURN))


@pytest.mark.parametrize("stream", [STREAMS[name] for name in ("even", "20 ms late", "bursts of 5", "20 Hz")])
@pytest.mark.parametrize("noise", [None, 0.01], ids=["angles", "noisy velocities"])
def test_a_stop_gives_exactly_zero_immediately(stream: list[tuple[float, float]], noise: float | None) -> None:
    odometry = WheelOdometry(BASE, FASTEST)
    stop = stream[len(stream) // 2][1]
    zero_after = math.inf
    for stamp, at in stream:
        rates = None if noise is None else angles(1.0) if at <= stop else [noise, -noise]
        traveled = odometry.update(angles(min(at, stop)), stamp, rates)
        if at > stop and traveled.velocity == (0.0, 0.0, 0.0):
            zero_after = min(zero_after, at - stop)
        if at > stop + 0.25:
            assert traveled.velocity == (0.0, 0.0, 0.0)
    assert zero_after <= 0.2


def test_a_gap_in_readings_gives_the_mean_and_no_peak() -> None:
    odometry = WheelOdometry(BASE, FASTEST)
    for reading in [*range(100), *range(250, 400)]:
        odometry.update(angles(reading * 0.01), reading * 0.01)
        assert odometry.now.velocity.x <= SPEED + 1e-9
    assert odometry.now.velocity.x == pytest.approx(SPEED)
    assert odometry.now.distance == pytest.approx(SPEED * 3.99)


@pytest.mark.parametrize("low", [-math.pi, 0.0])
@pytest.mark.parametrize("rate", [20, 100])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_encoders_that_wrap_within_one_turn_are_unwrapped(low: float, rate: int, direction: float) -> None:
    base = DrivenBase(resolved(BaseControlSection())[0])
    for reading in range(10 * rate):
        at = direction * reading / rate
        wrapped = [(angle - low) % math.tau + low for angle in angles(at, 0.25, 0.2)]
        traveled = base.measured(wrapped, START + reading / rate)
        assert traveled.velocity.speed <= 0.25 + 1e-6
    assert base.odometry.now.distance == pytest.approx(0.25 * abs(at), rel=1e-6)
    assert base.odometry.now.theta == pytest.approx(0.2 * at, rel=1e-6)


@pytest.mark.parametrize("before", [-1.5, 0.0, 3.0, 30.0])
def test_restarted_encoders_count_as_not_turned(before: float) -> None:
    base = DrivenBase(resolved(BaseControlSection())[0])
    for reading in range(400):
        at = reading * 0.01
        counted = angles(at + before if at < 2.0 else at - 2.0, 0.25, 0.0)
        assert base.measured(counted, START + at).velocity.speed <= 0.25 + 1e-6
    assert base.odometry.now.distance == pytest.approx(0.25 * 3.98, rel=1e-3)


def test_a_fast_push_is_tracked() -> None:
    base = DrivenBase(resolved(BaseControlSection())[0])
    for reading in range(100):
        base.measured(angles(reading * 0.05, 1.5, 0.0), START + reading * 0.05)
    assert base.odometry.now.distance == pytest.approx(1.5 * 99 * 0.05)
    assert base.odometry.now.velocity.x == pytest.approx(1.5, rel=1e-6)


NOW = 1_760_000_000_000_000_000
TICK = 10_000_000


def times(stamps: Sequence[int]) -> list[tuple[int, float] | None]:
    """Return the times of readings that arrive every 10 ms."""
    clock = ReadingTimes()
    return [clock.add(stamp, 5.0 + i * 0.01, NOW + i * TICK) for i, stamp in enumerate(stamps)]


def assert_steady(readings: Sequence[tuple[int, float] | None]) -> None:
    seconds = [reading[1] for reading in readings if reading is not None]
    assert all(0.0 < after - before <= 2 * PATIENCE for before, after in itertools.pairwise(seconds))


def test_running_stamps_are_used() -> None:
    readings = times([NOW + i * TICK for i in range(100)])
    assert [reading and reading[0] for reading in readings] == [NOW + i * TICK for i in range(100)]
    assert_steady(readings)


def test_readings_without_a_newer_stamp_are_dropped() -> None:
    assert times([NOW, NOW + TICK, NOW + TICK, NOW + TICK // 2, NOW + 2 * TICK])[2:4] == [None, None]


@pytest.mark.parametrize("hours", [-1, 1])
def test_readings_continue_after_the_drivers_clock_is_set(hours: int) -> None:
    jump = hours * 3_600_000_000_000
    readings = times([NOW + i * TICK + (jump if i >= 50 else 0) for i in range(200)])
    assert_steady(readings)
    assert readings[-1] is not None
    assert readings[-1][0] == NOW + jump + 199 * TICK
    assert sum(reading is None for reading in readings) <= 100 * PATIENCE


def test_a_simulation_step_counts_in_full_even_if_it_arrives_at_once() -> None:
    clock, base = ReadingTimes(simulated=True), DrivenBase(resolved(BaseControlSection())[0])
    for reading in range(20):  # only the last reading of each one-second step arrives, sometimes before /clock
        at = clock.add((reading + 1) * 100 * TICK, 2.0 * (reading // 2), 0)
        assert at is not None
        base.measured(angles(at.seconds, 0.25, 0.1), at.seconds)
    assert base.odometry.now.distance == pytest.approx(0.25 * 19)


@pytest.mark.parametrize("stamp", [0, NOW - 10**12], ids=["no stamp", "a stopped clock"])
def test_readings_without_a_usable_stamp_get_their_arrival_time(stamp: int) -> None:
    readings = times([stamp] * 200)
    assert_steady(readings)
    assert readings[-1] is not None
    assert readings[-1][0] == NOW + 199 * TICK
    assert sum(reading is None for reading in readings) <= 100 * PATIENCE


def test_stamps_are_used_again_once_a_stopped_clock_runs() -> None:
    readings = times([NOW] * 100 + [NOW + i * TICK for i in range(101, 200)])
    assert_steady(readings)
    assert readings[-1] is not None
    assert readings[-1][0] == NOW + 199 * TICK
