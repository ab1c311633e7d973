"""How time passes: steady, caught up after a short wait, left out after a long one."""

from __future__ import annotations

import pytest

from sim import simulator
from sim.simulator import Pace


class Clock:
    """A clock that is set by hand."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(simulator, "time", made)
    return made


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0, 10.0])
def test_a_second_has_so_many_ticks(clock: Clock, speed: float) -> None:
    made, count = Pace(speed), 0
    for _ in range(100):
        clock.now += 0.01
        count += made.due()
    assert count == pytest.approx(100 * speed, abs=2)
    assert made.late == made.left_out == 0 or speed > 1


def test_a_timer_that_is_early_or_late_is_no_matter(clock: Clock) -> None:
    made, counts = Pace(1.0), []
    for moved in (0.0099, 0.0102, 0.0095, 0.0104, 0.01):
        clock.now += moved
        counts.append(made.due())
    assert counts[1:] == [1, 1, 1, 1]
    assert made.late == 0


def test_a_short_wait_is_caught_up_bit_by_bit_and_counted(clock: Clock) -> None:
    made = Pace(1.0)
    made.due()
    clock.now += 0.1
    first = made.due()
    second = made.due()
    assert first == 5
    assert first + second + made.due() == 10
    assert 8 <= made.late <= 9
    assert not made.stood_still()


def test_a_long_wait_is_left_out_and_what_was_heard_in_it_too(clock: Clock) -> None:
    made = Pace(1.0)
    made.due()
    clock.now += 3.0
    assert made.due() <= 2
    assert 297 <= made.left_out <= 300
    assert made.stood_still()
    clock.now += 0.6
    assert not made.stood_still()
