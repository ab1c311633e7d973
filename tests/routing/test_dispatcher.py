"""The dispatcher, and the order of what routes publish on whatever thread."""

from __future__ import annotations

import threading

import pytest

from bridge.routing.dispatcher import Dispatcher
from bridge.routing.limits import Priority
from tests.support.wait import until


def stuck(dispatcher: Dispatcher) -> str:
    try:
        return dispatcher.alive("publishing")
    except TimeoutError as err:
        return str(err).partition(" for ")[0]


def test_work_on_the_callers_thread_is_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    dispatcher = Dispatcher("test")
    inside, go_on = threading.Event(), threading.Event()

    def work() -> None:
        inside.set()
        go_on.wait(40)

    thread = threading.Thread(target=dispatcher.here, args=(work,))
    thread.start()
    assert inside.wait(40)
    monkeypatch.setattr("bridge.routing.dispatcher._STUCK_SECONDS", 0.01)
    until(lambda: stuck(dispatcher) == "publishing has been stuck", "the work under way is seen")
    go_on.set()
    thread.join()
    assert dispatcher.alive("publishing") == ""


def test_work_that_fails_stops_nothing() -> None:
    dispatcher = Dispatcher("test")
    dispatcher.start()
    done = threading.Event()
    try:
        dispatcher.here(lambda: 1 // 0)  # type: ignore[arg-type]
        dispatcher.submit(Priority.STREAM, lambda: 1 // 0)  # type: ignore[arg-type]
        dispatcher.submit(Priority.STREAM, done.set)
        assert done.wait(40)
    finally:
        dispatcher.stop()
