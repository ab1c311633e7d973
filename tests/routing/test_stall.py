"""Ages of messages, and the detection of a process that was suspended."""

from __future__ import annotations

import queue
import time

import pytest

from bridge.routing import stall
from tests.support.clock import ProcessClock
from tests.support.wait import until


def test_age_is_waiting_time_whatever_the_clock_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ProcessClock(monkeypatch)
    gate = stall.AgeGate()
    offset = -3600.0
    ages(clock, gate, offset)
    for _ in range(5):
        clock.now += 0.1
        assert gate.age(int((clock.now + offset - 0.001) * 1e9)) < 0.01
    clock.now += 2.0
    assert gate.age(int((clock.now + offset - 2.0) * 1e9)) == pytest.approx(2.0, abs=0.01)


def ages(clock: ProcessClock, gate: stall.AgeGate, offset: float, count: int = 20) -> list[float]:
    """Return the ages of messages that arrive without delay, at 20 Hz, from a source with another clock."""
    seconds = []
    for _ in range(count):
        clock.now += 0.05
        seconds.append(gate.age(int((clock.now + offset) * 1e9)))
    return seconds


@pytest.mark.parametrize("jump", [-3600.0, -1.0, 3600.0])
def test_source_is_received_again_after_its_clock_was_set(monkeypatch: pytest.MonkeyPatch, jump: float) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    after = ages(clock, gate, jump)
    held = [a for a in after if a > 0.1]
    assert len(held) <= stall.HOLD / 0.05 + 1
    assert after[-1] < 0.01
    assert gate.age(int((clock.now + jump - 2.0) * 1e9)) > 1.9, (
        "after the clock jump, an old command is still recognized as old"
    )


@pytest.mark.parametrize("offset", [0.0, 3600.0])
def test_commands_with_counted_timestamps_are_fresh(monkeypatch: pytest.MonkeyPatch, offset: float) -> None:
    """The hybrid logical clock of a zenoh session stands while the system clock, which was set back, catches up."""
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, offset)
    stands_at, after = round((clock.now + offset) * 1e9), []
    for n in range(1, 800):
        clock.now += 0.05
        after.append(gate.age(stands_at + n * 100 // 4))
    assert max(after) < 0.1
    assert ages(clock, gate, offset)[-1] < 0.01
    assert gate.age(int((clock.now + offset - 2.0) * 1e9)) > 1.9, "an old command is recognized again"


def test_backlog_with_equal_timestamps_stays_old(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    stamp = round(clock.now * 1e9) + 1_000_000
    clock.now += 3.0
    assert min(gate.age(stamp) for _ in range(60)) > 2.9


def test_setting_the_local_clock_makes_no_message_old(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    monkeypatch.setattr(time, "time_ns", lambda: int((clock.now + 3600) * 1e9))
    assert max(ages(clock, gate, 0.0)) < 0.01


@pytest.mark.parametrize(("pause", "jump"), [(60.0, -40.0), (5.0, -4.95), (60.0, -60.05), (3600.0, -1.0)])
def test_source_is_received_again_after_its_clock_was_set_back_in_a_pause(
    monkeypatch: pytest.MonkeyPatch, pause: float, jump: float
) -> None:
    """Its next time stamp is later than the last one, so no time stamp goes back."""
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    clock.now += pause
    after = ages(clock, gate, jump, 60)
    assert len([age for age in after if age > 0.1]) <= (stall.CONFIRM + 0.1) / 0.05 + 1
    assert after[-1] < 0.01
    assert gate.age(int((clock.now + jump - 2.0) * 1e9)) > 1.9, "an old command is still recognized"


def test_second_of_two_single_commands_is_fresh_after_their_clock_was_set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    for offset, fresh in ((0.0, True), (-40.0, False), (-40.0, True)):
        clock.now += 60.0
        assert (gate.age(int((clock.now + offset) * 1e9)) < 0.1) is fresh


@pytest.mark.parametrize("pause", [0.0, 60.0])
def test_clock_of_this_machine_sets_no_command_of_this_machine_back(
    monkeypatch: pytest.MonkeyPatch, pause: float
) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    clock.now += pause
    monkeypatch.setattr(time, "time_ns", lambda: int((clock.now - 40.0) * 1e9))
    assert max(ages(clock, gate, -40.0)) < 0.01
    assert gate.age(int((clock.now - 42.0) * 1e9)) > 1.9, "an old command is still recognized"


def test_commands_are_fresh_while_the_clock_of_this_machine_is_slewed_back(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate, slewed = ProcessClock(monkeypatch), stall.AgeGate(), 0.0
    ages(clock, gate, 0.0)
    monkeypatch.setattr(time, "time_ns", lambda: int((clock.now - slewed) * 1e9))
    for _ in range(800):  # chrony corrects 3.3 s in 40 s
        slewed += 0.05 * 0.083
        assert ages(clock, gate, -slewed, 1)[0] < 0.2


def test_a_set_clock_of_this_machine_makes_no_late_command_of_another_fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    monkeypatch.setattr(time, "time_ns", lambda: int((clock.now - 3.0) * 1e9))
    assert max(ages(clock, gate, 0.0)) < 0.01
    clock.now += 4.0
    assert gate.age(int((clock.now - 3.0) * 1e9)) > 2.9


@pytest.mark.parametrize("speed", [1000.0, 2.0, 1.1])
def test_backlog_after_a_pause_stays_old(monkeypatch: pytest.MonkeyPatch, speed: float) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    clock.now += 10.0
    sent = clock.now - 3.0
    while sent < clock.now - 0.5:  # commands of 20 Hz, read at several times this rate
        assert gate.age(int(sent * 1e9)) > 0.4
        sent += 0.05
        clock.now += 0.05 / speed
    clock.now = max(clock.now, sent + 0.5)
    assert ages(clock, gate, 0.0)[-1] < 0.01


def test_a_delay_that_grows_is_never_taken_for_a_set_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    for n in range(400):
        clock.now += 0.05
        age = gate.age(int((clock.now - min(n * 0.02, 2.0)) * 1e9))
    assert age > 1.9


@pytest.mark.parametrize("seconds", [0.3, 0.9])
def test_a_delay_that_grows_after_a_pause_stays_old(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """A queue in the network fills after the pause, and stays full."""
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    clock.now += 3.0
    for n in range(200):
        clock.now += 0.05
        delay = 1.0 + min(n * 0.05, 1.0) * seconds
        assert gate.age(int((clock.now - delay) * 1e9)) > 0.8
    assert ages(clock, gate, 0.0)[-1] < 0.01


def test_a_late_command_postpones_the_detection_of_a_set_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    clock.now += 10.0
    sent, seen = clock.now - 3.0, list[tuple[float, float]]()
    for n in range(100):
        sent += 0.05
        clock.now = max(clock.now, sent + (3.4 if n == 20 else 3.0))
        seen.append((gate.age(int(sent * 1e9)), clock.now))
    late = seen[20][1]
    fresh = next(arrival for age, arrival in seen if age < 0.01)
    assert late + stall.CONFIRM - 0.01 < fresh < late + stall.CONFIRM + 0.6


def test_backlog_from_before_a_clock_was_set_back_stays_old(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    clock.now += 3.0
    backlog = [gate.age(int((clock.now - 3600.0 - 3.0 + n * 0.05) * 1e9)) for n in range(60)]
    assert min(backlog) > stall.HOLD


def test_backlog_of_a_new_source_is_old(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    backlog = [gate.age(int((clock.now - 1.3 + n * 0.05) * 1e9)) for n in range(26)]
    assert min(backlog) > stall.HOLD
    assert ages(clock, gate, 0.0)[-1] < 0.01


def test_a_single_message_of_a_new_source_is_fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ProcessClock(monkeypatch)
    assert stall.AgeGate().age(int((clock.now - 0.01) * 1e9)) == 0.0
    assert stall.AgeGate().age(int((clock.now + 100.0) * 1e9)) == 0.0


def test_a_message_that_was_overtaken_is_old(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, gate = ProcessClock(monkeypatch), stall.AgeGate()
    ages(clock, gate, 0.0)
    assert gate.age(int((clock.now - 0.02) * 1e9)) > 1.0
    assert max(ages(clock, gate, 0.0)) < 0.01


def test_a_suspension_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ProcessClock(monkeypatch)
    stall_detector = stall.StallDetector()
    for _ in range(5):
        clock.now += 0.1
        stall_detector.beat()
        assert not stall_detector.stood_still(0.5)
    clock.now += 3.0
    assert stall_detector.stood_still(0.5)
    stall_detector.beat()
    assert stall_detector.stood_still(0.5), "the backlog is still being read"
    for _ in range(6):
        clock.now += 0.1
        stall_detector.beat()
    assert not stall_detector.stood_still(0.5)


def test_only_a_long_suspension_counts_as_a_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ProcessClock(monkeypatch)
    stall_detector = stall.StallDetector()
    for pause, hung in ((1.0, False), (2.0, True)):
        clock.now += pause
        assert stall_detector.hung(1.5) is hung
        stall_detector.beat()
        assert stall_detector.hung(1.5) is hung, "the backlog is still being read"
        clock.now += 0.6
        assert not stall_detector.hung(1.5)
        stall_detector.beat()


def test_pulse_reports_a_suspension_once_the_process_continues(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, reported = ProcessClock(monkeypatch), queue.SimpleQueue[float]()
    stall_detector = stall.StallDetector(reported.put)
    stall_detector.start()
    try:
        clock.now += 20.0
        assert reported.get(timeout=40) == pytest.approx(20.0)
        assert stall_detector.stood_still(0.5), "the backlog is still being read"
    finally:
        stall_detector.stop()


def test_beats_continue_after_an_error_in_the_recovery(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise each later command would count as old, and be dropped."""
    clock, reported = ProcessClock(monkeypatch), queue.SimpleQueue[float]()

    def recover(seconds: float) -> None:
        reported.put(seconds)
        raise OSError("no such directory")

    stall_detector = stall.StallDetector(recover)
    stall_detector.start()
    try:
        for _ in range(2):
            clock.now += 20.0
            assert reported.get(timeout=40) == pytest.approx(20.0)
    finally:
        stall_detector.stop()


def test_pulse_pauses_without_readers_and_resumes_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stall, "_REST_SECONDS", 0.0)
    stall_detector = stall.StallDetector()
    quick = stall_detector.pause
    stall_detector.start()
    try:
        until(lambda: stall_detector.pause > quick, "the detector beats less often")
        assert stall_detector.pause < 0.3, "a longer wait would count as a standstill"
        monkeypatch.setattr(stall, "_REST_SECONDS", 1000.0)
        stall_detector.stood_still(0.5)
        assert stall_detector.pause == quick
    finally:
        stall_detector.stop()
