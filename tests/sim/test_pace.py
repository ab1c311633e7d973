"""The pace of ticks: steady; caught up after a short delay, skipped after a long delay."""

from __future__ import annotations

import pytest

from sim.pace import Pace
from tests.support.clock import Clock


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    fake_clock = Clock()
    monkeypatch.setattr("sim.pace.time", fake_clock)
    return fake_clock


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0, 10.0])
def test_the_speed_sets_the_ticks_per_second(clock: Clock, speed: float) -> None:
    pace, count = Pace(speed), 0
    for _ in range(100):
        clock.now += 0.01
        count += pace.due()
    assert count == pytest.approx(100 * speed, abs=2)
    assert pace.late == pace.left_out == 0 or speed > 1


def test_timer_jitter_neither_skips_nor_repeats_ticks(clock: Clock) -> None:
    pace, counts = Pace(1.0), []
    for moved in (0.0099, 0.0102, 0.0095, 0.0104, 0.01):
        clock.now += moved
        counts.append(pace.due())
    assert counts[1:] == [1, 1, 1, 1]
    assert pace.late == 0


def test_a_short_delay_is_caught_up_in_parts_and_counted(clock: Clock) -> None:
    pace = Pace(1.0)
    pace.due()
    clock.now += 0.1
    first = pace.due()
    second = pace.due()
    assert first == 5
    assert first + second + pace.due() == 10
    assert 8 <= pace.late <= 9
    assert not pace.stood_still()


def test_ticks_and_messages_of_a_long_delay_are_skipped(clock: Clock) -> None:
    pace = Pace(1.0)
    pace.due()
    clock.now += 3.0
    assert pace.due() <= 2
    assert 297 <= pace.left_out <= 300
    assert pace.stood_still()
    clock.now += 0.6
    assert not pace.stood_still()
