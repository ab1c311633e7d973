"""Jumps of the system clock, simulated with injected clocks, and a simulated time that stands still."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest

from bridge import clock as clocks
from bridge.clock import RunClock, SystemClock
from tests.support.wait import until

S = 1_000_000_000
NOON = 1_790_000_000 * S
YEAR = 365 * 86_400 * S


class Clocks:
    """A system clock and a monotonic one, which tests set and advance."""

    def __init__(self, poll: float = 0.0) -> None:
        self.wall, self.steady = NOON, 5 * S
        self.pauses: list[int] = []  # ns for which the process stands still between its readings of the two clocks
        self.system = SystemClock(self._wall, lambda: self.steady, poll)
        self.jumps = 0

    def _wall(self) -> int:
        wall = self.wall
        if self.pauses:
            self.advance(self.pauses.pop())
        return wall

    def advance(self, ns: int, slewed: float = 0.0) -> None:
        """Let time pass, while slewing adds a share of it to the system clock."""
        self.steady += ns
        self.wall += ns + round(ns * slewed)

    def count(self) -> None:
        self.jumps += 1


@pytest.fixture
def watched() -> Clocks:
    clocks = Clocks()
    clocks.system.on_jump(clocks.count)
    return clocks


@pytest.mark.parametrize("jump", [-40 * S, -3600 * S, -S, -S // 4, S // 4, 40 * S, 3600 * S, 50 * YEAR, -50 * YEAR])
@pytest.mark.parametrize("passed", [0, S // 5, S])
def test_a_clock_that_is_set_is_reported_once(watched: Clocks, jump: int, passed: int) -> None:
    watched.advance(passed)
    watched.wall += jump
    assert watched.system.check() == jump
    watched.advance(S // 5)
    assert watched.system.check() == 0
    assert watched.jumps == 1


def test_each_of_several_jumps_is_reported(watched: Clocks, caplog: pytest.LogCaptureFixture) -> None:
    for jump in (-S, 3600 * S, -3600 * S):
        watched.advance(S // 5)
        watched.wall += jump
        assert watched.system.check() == jump
    assert watched.jumps == 3
    assert "set back by 1.000 s" in caplog.text
    assert "set forward by 3600.000 s" in caplog.text


@pytest.mark.parametrize("slewed", [500e-6, -500e-6, 0.0833, -0.0833, 0.1005, -0.1005])
@pytest.mark.parametrize("period", [S // 5, 3 * S, 600 * S])
def test_slewing_is_not_a_jump(watched: Clocks, slewed: float, period: int) -> None:
    for _ in range(2000):
        watched.advance(period, slewed)
        assert watched.system.check() == 0
    assert not watched.jumps


def test_suspension_and_load_do_not_count_as_jumps(watched: Clocks) -> None:
    watched.advance(8 * 3600 * S)
    assert watched.system.check() == 0
    watched.pauses = [3 * S] * 20  # every reading is interrupted
    assert watched.system.check() == 0
    watched.pauses = []
    watched.advance(S // 5)
    assert watched.system.check() == 0
    watched.pauses = [3 * S]  # the next reading counts
    watched.wall -= S
    assert watched.system.check() == -S
    assert watched.jumps == 1


def test_a_jump_before_the_first_observer_is_not_reported() -> None:
    clocks = Clocks()
    clocks.wall -= 3600 * S
    clocks.system.on_jump(clocks.count)
    assert clocks.system.check() == 0
    assert not clocks.jumps


def test_an_error_of_one_observer_does_not_affect_the_others(watched: Clocks, caplog: pytest.LogCaptureFixture) -> None:
    def fail() -> None:
        raise ValueError("no")

    clocks = Clocks()
    withdraw = clocks.system.on_jump(fail)
    clocks.system.on_jump(clocks.count)
    clocks.wall -= S
    clocks.system.check()
    assert clocks.jumps == 1
    assert "a jump of the clock was not handled" in caplog.text
    withdraw()
    withdraw()
    caplog.clear()
    clocks.wall -= S
    clocks.system.check()
    assert clocks.jumps == 2
    assert "not handled" not in caplog.text
    assert not watched.jumps


def test_the_clocks_thread_runs_while_there_is_an_observer() -> None:
    def threads() -> set[threading.Thread]:
        return {thread for thread in threading.enumerate() if thread.name == "midspan-clock"}

    others = threads()  # of earlier tests; some may be ending
    clocks = Clocks(poll=0.005)
    first, second = RunClock(system=clocks.system), RunClock(system=clocks.system)
    first.on_jump(clocks.count)
    second.on_jump(clocks.count)
    assert len(threads() - others) == 1
    clocks.wall -= 40 * S
    until(lambda: clocks.jumps == 2, "both watchers are notified")
    first.close()
    first.close()
    clocks.wall += 40 * S
    until(lambda: clocks.jumps == 3, "the other watcher is notified")
    second.close()
    until(lambda: not threads() - others, "the thread ends")
    first.on_jump(clocks.count)
    clocks.wall -= 40 * S
    until(lambda: clocks.jumps == 4, "the clock is watched again")
    first.close()
    until(lambda: not threads() - others, "the thread ends again")


def test_ages_do_not_depend_on_the_system_clock() -> None:
    clocks = Clocks()
    run = RunClock(system=clocks.system)
    assert run.now_ns() == NOON
    began = run.elapsed_ns()
    clocks.wall -= 3600 * S
    assert run.now_ns() == NOON - 3600 * S
    assert 0 <= run.elapsed_ns() - began < 60 * S


def message(seconds: int) -> bytes:
    return b"\0\1\0\0" + seconds.to_bytes(4, "little") + bytes(4)


def test_two_publishers_of_the_clock_are_reported_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now = [100.0]
    monkeypatch.setattr(clocks, "time", SimpleNamespace(monotonic=lambda: now[0]))
    run = RunClock(simulated=True)
    for step in range(1000):
        now[0] += 0.01
        run.receive(message(7 if step % 2 else 1000 + step))
    assert "several programs publish it" in run.trouble()
    assert [("was set back to 7" in m, m == run.trouble()) for m in caplog.messages if "/clock" in m] == [
        *[(True, False)] * clocks.MOST_BACK, (False, True),
    ]  # fmt: skip
    for _ in range(100):  # one of them has ended
        now[0] += 0.1
        run.receive(message(2000))
    assert run.trouble() == ""
    run.receive(message(7))
    assert [m for m in caplog.messages if "/clock" in m][-1] == "/clock was set back to 7.000 s"


def test_simulated_time_that_stands_still_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(clocks, "time", SimpleNamespace(monotonic=lambda: now[0]))
    system, run = RunClock(), RunClock(simulated=True)
    assert run.trouble() == ""
    now[0] += clocks.SILENCE_SECONDS + 0.1
    assert run.trouble().startswith("no message on /clock (clock.source: sim)")
    assert "midspan play --clock" in run.trouble()
    run.receive(message(7))
    assert run.trouble() == ""
    now[0] += clocks.SILENCE_SECONDS + 0.1
    assert "/clock is silent" in run.trouble()
    assert "7.000 s" in run.trouble()
    assert system.trouble() == ""
