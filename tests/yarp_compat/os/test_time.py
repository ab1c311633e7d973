"""Time by the system's clock and by a network clock."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest

import yarp_compat as yarp
from tests.support.wait import until


def is_system_time(now: Callable[[], float]) -> bool:
    """Return whether a clock shows the system's time, however long this process stands still meanwhile."""
    return time.time() - 1.0 < now() < time.time() + 1.0


def test_now_is_in_seconds_since_1970() -> None:
    assert is_system_time(yarp.now)
    assert is_system_time(yarp.Time.now)
    assert yarp.Time.isSystemClock()
    assert yarp.Time.clockTypeToString(yarp.Time.getClockType()) == "YARP_CLOCK_SYSTEM"


def test_a_delay_waits_at_least_its_time() -> None:
    begin = time.monotonic()
    yarp.delay(0.02)
    yarp.Time.delay(-1)
    assert time.monotonic() - begin >= 0.02


class Clock:
    """A simulator's clock."""

    def __init__(self) -> None:
        self.port = yarp.Port()
        assert self.port.open("/clock")

    def publish(self, seconds: int, nanoseconds: int = 0) -> None:
        self.port.write(yarp.Bottle([seconds, nanoseconds]))


@pytest.fixture
def clock(name_server: object) -> Iterator[Clock]:
    clock = Clock()
    try:
        yield clock
    finally:
        yarp.Time.useSystemClock()
        clock.port.close()


def follow(clock: Clock, seconds: int = 100) -> None:
    """Use the clock, and wait until its time is received."""
    yarp.Time.useNetworkClock("/clock")
    until(lambda: (clock.publish(seconds), yarp.Time.isValid())[1], "a time is received")


def test_network_clock_is_followed(clock: Clock) -> None:
    yarp.Time.useNetworkClock("")
    assert yarp.Time.isNetworkClock()
    assert not yarp.Time.isValid()
    assert yarp.now() == 0
    until(lambda: (clock.publish(12, 500_000_000), yarp.Time.isValid())[1], "a time is received")
    assert yarp.now() == 12.5
    assert yarp.Time.clockTypeToString(yarp.Time.getClockType()) == "YARP_CLOCK_NETWORK"
    stamp = yarp.Stamp()
    stamp.update()
    assert stamp.getTime() == 12.5
    yarp.Time.useSystemClock()
    assert is_system_time(yarp.now)


def waits(thread: threading.Thread) -> bool:
    """Return whether a thread is waiting for another one."""
    frame = sys._current_frames().get(thread.ident or 0)
    return frame is not None and (frame.f_code.co_filename, frame.f_code.co_name) == (threading.__file__, "wait")


def test_delay_uses_the_clocks_time_and_does_not_grow_when_it_is_set_back(clock: Clock) -> None:
    follow(clock)
    done = threading.Event()
    thread = threading.Thread(target=lambda: (yarp.delay(5), done.set()))
    thread.start()
    until(lambda: waits(thread), "the delay has begun")
    clock.publish(104, 999_999_999)
    assert not done.wait(0.2)
    clock.publish(10)  # the clock is set back one nanosecond before the end of the five-second delay
    until(lambda: (clock.publish(10, 100), done.is_set())[1], "the delay is over", every=0.05)
    thread.join()


def test_periodic_thread_uses_the_clocks_time(clock: Clock) -> None:
    class Counter(yarp.PeriodicThread):
        def run(self) -> None:
            pass

    follow(clock)
    counter = Counter(1.0)
    assert counter.start()
    try:
        until(lambda: counter.getIterations() == 1, "the first cycle has run")
        for second in range(101, 106):
            until(
                lambda s=second: (clock.publish(s), counter.getIterations() == s - 99)[1],
                "one cycle has run per second",
            )
    finally:
        counter.stop()


def test_wait_starts_at_the_time_that_the_caller_read(clock: Clock) -> None:
    """Otherwise, a periodic thread could lose a cycle if the clock advances between its reading and its wait."""
    follow(clock, 100)
    never = threading.Event()
    assert not yarp.os.time.wait(never, 1.0, since=99.0)
    since = yarp.os.time.steady()
    until(lambda: (clock.publish(101), yarp.now() == 101)[1], "the clock advances")
    done = threading.Event()
    thread = threading.Thread(target=lambda: (yarp.os.time.wait(never, 1.5, since), done.set()))
    thread.start()
    try:
        until(lambda: (clock.publish(101, 500_000_000), done.is_set())[1], "the wait is over")
    finally:
        yarp.Time.useSystemClock()
        thread.join()


def test_environment_variable_selects_the_clock(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("YARP_CLOCK", "/clock")
    yarp.Network.fini()
    yarp.Network.init()
    assert yarp.Time.isNetworkClock()


def test_clock_that_starts_later_and_restarts_is_followed(name_server: object) -> None:
    yarp.Time.useNetworkClock("/clock")
    try:
        for seconds in (7, 8):
            clock = Clock()
            until(lambda c=clock, s=seconds: (c.publish(s), yarp.now() == s)[1], "a time is received", 20)
            clock.port.close()
    finally:
        yarp.Time.useSystemClock()


def test_invalid_time_is_ignored(clock: Clock, caplog: pytest.LogCaptureFixture) -> None:
    follow(clock)
    clock.port.write(yarp.Bottle("noon"))
    until(lambda: "invalid time from" in caplog.text, "the invalid time is logged")
    assert yarp.now() == 100
