"""A process detects whether its zenoh sessions can still declare key expressions."""

from __future__ import annotations

from typing import Any, cast

import pytest
import zenoh

from bridge.hub import panics
from bridge.hub.node import Hub
from tests.peers.hub.network import HubNetwork


class PanicException(BaseException):
    """The exception that Python receives if Rust panics in a call."""


class Declaring:
    """A session that can only declare key expressions, or fails to."""

    def __init__(self, error: BaseException | None) -> None:
        self._error = error
        self.closed = False
        self.declared = 0

    def is_closed(self) -> bool:
        assert self._error is not None, "this call can block all threads for good"
        return self.closed

    def declare_keyexpr(self, key: str) -> str:
        if self.closed and self._error is None:
            raise zenoh.ZError("session closed")
        if self._error is not None:
            raise self._error
        self.declared += 1
        return key

    def undeclare(self, _: object) -> None:
        self.declared -= 1


@pytest.fixture(autouse=True)
def no_sessions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(panics, "_sessions", [])


def watch(error: BaseException | None) -> Declaring:
    session = Declaring(error)
    panics.watched(cast("Any", session))
    return session


def test_a_poisoned_session_is_a_failure_until_it_is_closed() -> None:
    sound = watch(None)
    assert panics.failure() == ""
    poisoned = watch(PanicException("called `Result::unwrap()` on an `Err` value: PoisonError { .. }"))
    assert panics.failure() == panics.FAILED
    poisoned.closed = True
    assert panics.failure() == ""
    assert panics._sessions == [sound]
    assert sound.declared == 0


def test_closed_sessions_are_forgotten() -> None:
    """In processes, too, that open sessions again and again, and never ask for a failure."""
    watch(None).closed = True
    last = watch(None)
    assert panics._sessions == [last]
    last.closed = True
    assert panics.failure() == ""
    assert panics._sessions == []


def test_other_errors_are_no_failure_of_zenoh() -> None:
    watch(zenoh.ZError("session closed"))
    assert panics.failure() == ""
    watch(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        panics.failure()


def test_sessions_of_the_hub_are_watched_until_they_are_closed(network: HubNetwork) -> None:
    with Hub.open(network.settings("one")):
        (_session,) = panics._sessions
        assert panics.failure() == ""
    assert panics.failure() == ""
    assert panics._sessions == []
