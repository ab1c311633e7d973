"""Calls that wait for the lease: their order, their limits, and their end."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

import pytest

from bridge.routing.limits import QUEUE_BYTES
from bridge.routing.peer_watch import Lease
from bridge.routing.services import held
from bridge.routing.services.held import HeldCalls
from tests.support.wait import until


class Calls:
    """Records which calls began and which were refused; the lease has just expired."""

    def __init__(self) -> None:
        self.lease = Lease()
        self.lease.until = time.monotonic()
        self.held = HeldCalls("fake", self.lease)
        self.events: list[str] = []

    def admit(self, name: str, size: int = 10) -> None:
        begin, refuse = (partial(self.events.append, f"{name} {event}") for event in ("begins", "is refused"))
        self.held.admit(name, size, begin, refuse)

    def extend(self) -> None:
        self.lease.extend(time.monotonic() + 60.0)


@pytest.fixture
def calls() -> Iterator[Calls]:
    calls = Calls()
    yield calls
    calls.held.close()


def test_held_calls_begin_in_order_when_the_lease_is_back(calls: Calls) -> None:
    for name in ("goal", "result", "cancel"):
        calls.admit(name)
    assert calls.events == []
    calls.extend()
    until(lambda: len(calls.events) == 3, "all calls begin")
    calls.admit("next")
    assert calls.events == ["goal begins", "result begins", "cancel begins", "next begins"]


def test_newer_call_does_not_overtake_a_held_one(calls: Calls) -> None:
    """The newer call arrives on another thread while the held call begins."""
    began: list[str] = []

    def begin() -> None:
        calls.admit("cancel")
        began.extend(["goal", *calls.events])

    calls.held.admit("goal", 10, begin, lambda: None)
    calls.extend()
    until(lambda: calls.events == ["cancel begins"], "the newer call begins")
    assert began == ["goal"]


def test_call_of_a_client_that_has_left_does_not_begin(calls: Calls) -> None:
    calls.admit("goal", QUEUE_BYTES)
    calls.held.drop("goal")
    calls.admit("other", QUEUE_BYTES)
    calls.extend()
    until(lambda: calls.events == ["other begins"], "only the other call begins")


def test_call_is_refused_after_a_few_seconds_without_the_lease(calls: Calls, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(held, "HOLD_SECONDS", 0.1)
    calls.admit("goal")
    calls.admit("cancel")
    until(lambda: calls.events == ["goal is refused", "cancel is refused"], "both calls are refused")


def test_full_queue_refuses_further_calls(calls: Calls, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(held, "MOST_HELD", 2)
    for name in "abc":
        calls.admit(name)
    assert calls.events == ["c is refused"]


def test_large_calls_are_limited_by_their_bytes(calls: Calls) -> None:
    calls.admit("a", QUEUE_BYTES)
    calls.admit("b", 1)
    assert calls.events == ["b is refused"]


def test_calls_are_refused_at_once_after_a_long_suspension(calls: Calls) -> None:
    calls.lease.until -= held.LATE_SECONDS + 1.0
    calls.admit("goal")
    assert calls.events == ["goal is refused"]


def test_lease_that_was_ended_is_over_since_then() -> None:
    lease = Lease()
    before = time.monotonic()
    lease.extend(before + 60.0)
    lease.end()
    assert before <= lease.until <= time.monotonic()
    lease.until = before - 9.0
    lease.end()
    assert lease.until == before - 9.0
