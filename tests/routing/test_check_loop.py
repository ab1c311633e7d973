"""The thread that checks an engine's graphs."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.routing import check_loop
from bridge.routing.check_loop import CheckLoop
from tests.support.recorded_waits import recorded_waits
from tests.support.wait import until


@contextmanager
def running(
    check: Callable[[], bool], tick: Callable[[], None] | None = None, failed: Callable[[str], None] = pytest.fail
) -> Iterator[CheckLoop]:
    loop = CheckLoop("test", check, failed, tick)
    loop.start()
    try:
        yield loop
    finally:
        loop.stop()


def test_checks_at_the_start_and_when_woken_but_not_when_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_loop, "POLL", 1000.0)
    monkeypatch.setattr(check_loop, "TICK", 0.01)
    checks, ticks = list[None](), list[None]()
    with running(lambda: bool(checks.append(None)), lambda: ticks.append(None)) as loop:
        until(lambda: len(checks) == 1, "the first check has run")
        loop.wake()
        until(lambda: len(checks) == 2, "a check has run after the wake-up")
        assert loop.alive() == ""
        before = len(ticks)
        until(lambda: len(ticks) > before + 1, "the loop waits again")
    assert len(checks) == 2


def test_loop_without_ticks_sleeps_until_the_next_check_and_does_not_count_as_hanging(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each wake-up of an idle process takes up to a millisecond of processor time."""
    monkeypatch.setattr(check_loop, "POLL", 1000.0)
    monkeypatch.setattr(check_loop, "_STEP_SECONDS", 0.0)
    wake, pauses = recorded_waits()
    monkeypatch.setattr(check_loop, "threading", SimpleNamespace(Event=wake, Thread=threading.Thread))
    with running(lambda: False) as loop:
        until(lambda: pauses and (pauses[-1] or 0.0) > 900.0, "the loop waits for the next check")
        assert loop.alive() == ""
    assert len(pauses) <= 4


def test_wake_up_during_a_check_leads_to_another_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_loop, "POLL", 1000.0)
    checks, inside, proceed = list[None](), threading.Event(), threading.Event()

    def check() -> bool:
        checks.append(None)
        inside.set()
        return not proceed.wait(40)

    with running(check) as loop:
        assert inside.wait(40)
        loop.wake()
        proceed.set()
        until(lambda: len(checks) == 2, "another check has run")


@pytest.mark.parametrize("again", [True, False])
def test_check_with_refused_routes_is_repeated_soon(monkeypatch: pytest.MonkeyPatch, again: bool) -> None:
    monkeypatch.setattr(check_loop, "_RETRY", 0.01)
    monkeypatch.setattr(check_loop, "TICK", 0.01)
    checks, ticks = list[None](), list[None]()

    def check() -> bool:
        checks.append(None)
        return again

    with running(check, lambda: ticks.append(None)):
        until(lambda: len(ticks) > 10, "ten ticks have run")
    assert (len(checks) > 3) is again


def test_missed_notification_is_recovered_after_the_poll_period(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_loop, "POLL", 0.05)
    checks = list[None]()
    with running(lambda: bool(checks.append(None))):
        until(lambda: len(checks) > 3, "checks run without a wake-up")


@pytest.mark.parametrize("part", ["check", "tick"])
def test_failed_check_or_tick_ends_the_thread_with_its_reason(part: str) -> None:
    reasons = list[str]()

    def fail() -> bool:
        raise ValueError("no such graph")

    parts: dict[str, Any] = {"check": lambda: False, "tick": lambda: None, part: fail}
    with running(**parts, failed=reasons.append):
        until(lambda: reasons, "the failure is reported")
        until(lambda: all(t.name != "midspan-test-engine" for t in threading.enumerate()), "the thread has ended")
    assert reasons == ["following the graphs failed: no such graph"]


def test_hanging_check_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_loop, "_STEP_SECONDS", 0.1)
    inside, proceed = threading.Event(), threading.Event()

    def check() -> bool:
        inside.set()
        return not proceed.wait(40)

    with running(check) as loop:
        assert inside.wait(40)

        def hangs() -> bool:
            try:
                loop.alive()
            except TimeoutError as err:
                return "the test engine's loop hangs" in str(err)
            return False

        until(hangs, "the hang is reported")
        proceed.set()
