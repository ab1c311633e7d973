"""Time, on the system's clock and on a network clock."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator

import pytest

import yarp_compat as yarp
from tests.support.wait import until


def test_now_is_the_time_since_1970() -> None:
    assert abs(yarp.now() - time.time()) < 1
    assert abs(yarp.Time.now() - time.time()) < 1
    assert yarp.Time.isSystemClock()
    assert yarp.Time.clockTypeToString(yarp.Time.getClockType()) == "YARP_CLOCK_SYSTEM"


def test_delay_waits() -> None:
    begin = time.monotonic()
    yarp.delay(0.02)
    yarp.Time.delay(-1)
    assert time.monotonic() - begin >= 0.02


class Clock:
    """A simulator's clock."""

    def __init__(self) -> None:
        self.port = yarp.Port()
        assert self.port.open("/clock")

    def say(self, seconds: int, nanoseconds: int = 0) -> None:
        self.port.write(yarp.Bottle([seconds, nanoseconds]))


@pytest.fixture
def clock(name_server: object) -> Iterator[Clock]:
    made = Clock()
    try:
        yield made
    finally:
        yarp.Time.useSystemClock()
        made.port.close()


def follow(clock: Clock, seconds: int = 100) -> None:
    """Use the clock, and hear it."""
    yarp.Time.useNetworkClock("/clock")
    until(lambda: (clock.say(seconds), yarp.Time.isValid())[1], "the clock is heard")


def test_a_network_clock_is_followed(clock: Clock) -> None:
    yarp.Time.useNetworkClock("")
    assert yarp.Time.isNetworkClock()
    assert not yarp.Time.isValid()
    assert yarp.now() == 0
    until(lambda: (clock.say(12, 500_000_000), yarp.Time.isValid())[1], "the clock is heard")
    assert yarp.now() == 12.5
    assert yarp.Time.clockTypeToString(yarp.Time.getClockType()) == "YARP_CLOCK_NETWORK"
    stamp = yarp.Stamp()
    stamp.update()
    assert stamp.getTime() == 12.5
    yarp.Time.useSystemClock()
    assert abs(yarp.now() - time.time()) < 1


def waits(thread: threading.Thread) -> bool:
    """Whether a thread has come to wait for another one."""
    frame = sys._current_frames().get(thread.ident or 0)
    return frame is not None and (frame.f_code.co_filename, frame.f_code.co_name) == (threading.__file__, "wait")


def test_a_delay_is_in_the_clocks_time_and_no_longer_when_it_is_set_back(clock: Clock) -> None:
    follow(clock)
    done = threading.Event()
    thread = threading.Thread(target=lambda: (yarp.delay(5), done.set()))
    thread.start()
    until(lambda: waits(thread), "the delay has begun")
    clock.say(104, 999_999_999)
    assert not done.wait(0.2)
    clock.say(10)  # begins anew: five seconds less a nanosecond were over
    until(lambda: (clock.say(10, 100), done.is_set())[1], "the delay is over", every=0.05)
    thread.join()


def test_a_periodic_thread_keeps_the_clocks_period(clock: Clock) -> None:
    class Counter(yarp.PeriodicThread):
        def run(self) -> None:
            pass

    follow(clock)
    counter = Counter(1.0)
    assert counter.start()
    try:
        until(lambda: counter.getIterations() == 1, "the first round")
        for second in range(101, 106):
            until(lambda s=second: (clock.say(s), counter.getIterations() == s - 99)[1], "one round a second")
    finally:
        counter.stop()


def test_a_wait_counts_from_when_the_caller_looked(clock: Clock) -> None:
    """The clock may go on between a thread's look and its wait; a periodic thread then lost a round."""
    follow(clock, 100)
    never = threading.Event()
    assert not yarp.os.time.wait(never, 1.0, since=99.0)
    since = yarp.os.time.steady()
    until(lambda: (clock.say(101), yarp.now() == 101)[1], "the clock goes on")
    done = threading.Event()
    thread = threading.Thread(target=lambda: (yarp.os.time.wait(never, 1.5, since), done.set()))
    thread.start()
    try:
        until(lambda: (clock.say(101, 500_000_000), done.is_set())[1], "the wait is over")
    finally:
        yarp.Time.useSystemClock()
        thread.join()


def test_the_variable_names_the_clock(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("YARP_CLOCK", "/clock")
    yarp.Network.fini()
    yarp.Network.init()
    assert yarp.Time.isNetworkClock()


def test_a_clock_that_comes_later_and_returns_is_heard(name_server: object) -> None:
    yarp.Time.useNetworkClock("/clock")
    try:
        for seconds in (7, 8):
            clock = Clock()
            until(lambda c=clock, s=seconds: (c.say(s), yarp.now() == s)[1], "the clock is heard", 20)
            clock.port.close()
    finally:
        yarp.Time.useSystemClock()


def test_what_says_no_time_is_left_out(clock: Clock, caplog: pytest.LogCaptureFixture) -> None:
    follow(clock)
    clock.port.write(yarp.Bottle("noon"))
    until(lambda: "invalid time from" in caplog.text, "it is logged")
    assert yarp.now() == 100
