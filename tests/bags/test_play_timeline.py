"""When messages are due, with a clock that the test advances."""

from __future__ import annotations

import threading

import pytest

from bridge.bags.play.timeline import LATE, Due, Timeline

NS = 1_000_000_000
START = 1_700_000_000 * NS


class Clock:
    """A monotonic clock on which only waits take time; each wait takes ``over`` seconds too long."""

    def __init__(self, over: float = 0.0) -> None:
        self.seconds, self.over = 5000.0, over
        self.waits: list[float | None] = []

    def now(self) -> float:
        return self.seconds

    def wait(self, _condition: threading.Condition, seconds: float | None) -> None:
        assert seconds is not None, "nothing is due, and nothing would end the wait"
        assert seconds > 0.0
        self.waits.append(seconds)
        self.seconds += seconds + self.over


def timeline(clock: Clock, rate: float = 1.0, *, paused: bool = False, clock_hz: float = 0.0) -> Timeline:
    timeline_ = Timeline(rate, paused=paused, clock_hz=clock_hz, now=clock.now, wait=clock.wait)
    timeline_.begin(START)
    return timeline_


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_messages_are_due_by_the_rate_and_waits_that_are_too_long_do_not_add_up(rate: float) -> None:
    clock = Clock(over=0.003)
    played = timeline(clock, rate)
    for number in range(1, 101):
        assert played.next(START + number * NS // 10) is Due.MESSAGE
        assert clock.seconds - 5000.0 == pytest.approx(number * 0.1 / rate + 0.003, abs=1e-6)
        assert played.late == pytest.approx(0.003, abs=1e-6)
    assert played.behind == 0.0


def test_the_latest_possible_time_is_waited_for() -> None:
    clock = Clock()
    played = timeline(clock, 0.01)
    assert played.next((1 << 64) - 1) is Due.MESSAGE
    assert max(seconds for seconds in clock.waits if seconds) <= threading.TIMEOUT_MAX


def test_the_bags_time_never_passes_a_message_that_has_not_been_played() -> None:
    clock = Clock()
    played = timeline(clock)
    assert played.next(START + NS) is Due.MESSAGE
    clock.seconds += 5.0  # the next message is not requested
    assert played.now_ns() == START + NS
    assert played.next(START + 2 * NS) is Due.MESSAGE
    assert played.late == pytest.approx(4.0)
    assert played.behind == pytest.approx(4.0)
    # the bag time was set back, so the interval to the next message is kept
    before = clock.seconds
    assert played.next(START + 3 * NS) is Due.MESSAGE
    assert clock.seconds - before == pytest.approx(1.0)
    assert played.late == 0.0


def test_a_short_lag_is_caught_up() -> None:
    clock = Clock()
    played = timeline(clock)
    played.next(START + NS)
    clock.seconds += 0.1 + LATE / 2
    assert played.next(START + NS + NS // 10) is Due.MESSAGE
    assert played.late == pytest.approx(LATE / 2)
    played.next(START + 2 * NS)
    assert clock.seconds == pytest.approx(5002.0)
    assert played.behind == 0.0


def test_a_pause_stops_the_time_and_a_resume_continues_it() -> None:
    clock = Clock()
    played = timeline(clock)
    played.next(START + NS)
    clock.seconds += 0.25
    played.next(START + NS + NS // 4)
    played.pause(True)
    assert played.next(START + 2 * NS) is Due.PAUSED
    clock.seconds += 100.0
    assert played.now_ns() == START + NS + NS // 4
    played.pause(False)
    before = clock.seconds
    assert played.next(START + 2 * NS) is Due.MESSAGE
    assert clock.seconds - before == pytest.approx(0.75)
    assert (played.late, played.behind) == (0.0, 0.0)


def test_a_step_plays_one_message_and_moves_the_time_to_it() -> None:
    clock = Clock()
    played = timeline(clock, paused=True)
    assert played.step()
    assert played.step()
    assert played.next(START + 3 * NS) is Due.STEP
    assert played.now_ns() == START + 3 * NS
    assert played.next(START + 4 * NS) is Due.STEP
    with pytest.raises(AssertionError, match="nothing is due"):
        played.next(START + 5 * NS)
    assert clock.seconds == 5000.0


def test_steps_apply_only_during_the_current_pause() -> None:
    clock = Clock()
    played = timeline(clock, paused=True)
    assert played.step()
    played.pause(False)
    assert not played.step()
    assert played.next(START + NS) is Due.MESSAGE
    played.pause(True)
    assert played.next(START + 2 * NS) is Due.PAUSED
    with pytest.raises(AssertionError, match="nothing is due"):
        played.next(START + 2 * NS)


def test_the_clock_is_due_in_real_time_also_while_paused() -> None:
    clock = Clock()
    played = timeline(clock, rate=2.0, clock_hz=10.0)
    clocks = []
    while (due := played.next(START + NS)) is Due.CLOCK:
        clocks.append(played.now_ns() - START)
    assert due is Due.MESSAGE
    assert clocks == pytest.approx([0, *(number * NS // 5 for number in range(1, 6))][: len(clocks)], abs=1000)
    assert len(clocks) in (5, 6)  # at the end, either the message or the clock is first
    played.pause(True)
    assert played.next(START + 2 * NS) is Due.PAUSED
    before = clock.seconds
    dues = [played.next(START + 2 * NS) for _ in range(20)]
    assert set(dues) == {Due.CLOCK}
    assert clock.seconds - before == pytest.approx(2.0, abs=0.15)
    assert played.now_ns() == START + NS


def test_a_late_clock_is_not_published_in_a_burst() -> None:
    clock = Clock()
    played = timeline(clock, clock_hz=100.0, paused=True)
    assert played.next(START) is Due.CLOCK
    clock.seconds += 10.0
    assert played.next(START) is Due.CLOCK
    before = clock.seconds
    for _ in range(5):
        assert played.next(START) is Due.CLOCK
    assert clock.seconds - before >= 0.039


def test_a_loop_starts_again() -> None:
    clock = Clock()
    played = timeline(clock)
    played.next(START + 10 * NS)
    played.begin(START)
    assert played.now_ns() == START
    before = clock.seconds
    assert played.next(START + NS) is Due.MESSAGE
    assert clock.seconds - before == pytest.approx(1.0)


def test_a_stop_ends_a_wait_at_once() -> None:
    played = Timeline()
    played.begin(START)
    dues: list[Due] = []
    thread = threading.Thread(target=lambda: dues.append(played.next(START + 3600 * NS)))
    thread.start()
    played.stop()
    thread.join(60.0)
    assert dues == [Due.STOPPED]
    assert played.stopped


def test_pause_step_and_resume_end_a_wait() -> None:
    played = Timeline(1000.0, paused=True)
    played.begin(START)
    dues: list[Due] = []

    def ask() -> None:
        dues.extend(played.next(START + number * NS) for number in (1, 2))

    thread = threading.Thread(target=ask)
    thread.start()
    played.step()
    played.pause(False)
    thread.join(60.0)
    assert not thread.is_alive()
    assert dues[-1] is Due.MESSAGE
