"""Waits in steps, as on Windows."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest

from yarp_compat import interruptible as waits

SYSTEMS = ("linux", "win32")


@pytest.fixture(params=SYSTEMS, autouse=True)
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waits, "sys", SimpleNamespace(platform=request.param))


def test_a_set_event_ends_the_wait() -> None:
    event = threading.Event()
    thread = threading.Timer(0.05, event.set)
    thread.start()
    assert waits.interruptible(event.wait)
    assert waits.interruptible(event.wait, 0.0)
    thread.join()


@pytest.mark.parametrize("seconds", [-1.0, 0.0, 0.3])
def test_the_wait_ends_after_its_time(seconds: float) -> None:
    assert not waits.interruptible(threading.Event().wait, seconds)
