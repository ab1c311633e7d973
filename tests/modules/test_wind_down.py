"""Before a module stops, it brings its robot to rest, within the time that the host allows."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.worker import DRAIN_SECONDS
from bridge.config.sections.section import Section
from bridge.daemon.worker_run import Timing
from bridge.modules import worker as modules_worker
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.worker import Running
from tests.peers.hub.modules import STRING, Place
from tests.support.wait import until

ECHO = {"name": "echo", "factory": "tests.peers.hub.echo:Echo"}


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a module's thread begin late to stop the module; after the usual time, its last step would be dropped."""
    monkeypatch.setattr(modules_worker, "STOP_SECONDS", 60.0)


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as running:
        running.worker.start(running.config(ECHO))
        yield running


class WindDown:
    """Replaces a module's `begin_stop` and `stop`, and records the order of events."""

    def __init__(self, module: Module, monkeypatch: pytest.MonkeyPatch) -> None:
        self.events: list[str] = []
        self.done: Callable[[], None] | None = None
        self.begun = threading.Event()
        monkeypatch.setattr(module, "begin_stop", self._begin)
        monkeypatch.setattr(module, "stop", lambda: self.events.append("stopped"))

    def _begin(self, done: Callable[[], None]) -> None:
        self.events.append("winding down")
        self.done = done
        self.begun.set()


class Stopping:
    """Stops a module on another thread."""

    def __init__(self, running: Running) -> None:
        self.began = time.monotonic()
        self.seconds = 0.0
        self._thread = threading.Thread(target=self._run, args=(running,))
        self._thread.start()

    def _run(self, running: Running) -> None:
        running.stop()
        self.seconds = time.monotonic() - self.began

    @property
    def stopped(self) -> bool:
        return not self._thread.is_alive()

    def join(self) -> None:
        self._thread.join(60)
        assert self.stopped, "the module does not stop"


def test_a_module_is_stopped_once_it_has_wound_down(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modules_worker, "WIND_DOWN_SECONDS", 60.0)
    running = place.worker.running("echo")
    module: Any = running.module
    received = place.far.subscribe("/said", STRING)
    winding = WindDown(module, monkeypatch)
    stopping = Stopping(running)
    assert winding.begun.wait(20)
    assert winding.done is not None
    place.until_replied("one more", received, "one more")  # the module's endpoints work meanwhile
    assert not stopping.stopped
    assert winding.events == ["winding down"]
    winding.done()
    stopping.join()
    assert winding.events == ["winding down", "stopped"]
    assert stopping.seconds < 60.0
    until(lambda: not place.far.hub.graph.publishers("/said"), "the module's endpoints are closed")


def test_a_module_whose_thread_is_busy_winds_down_later(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modules_worker, "WIND_DOWN_SECONDS", 60.0)
    running, free = place.worker.running("echo"), threading.Event()
    running.host.loop.post(lambda: free.wait(40))
    winding = WindDown(running.module, monkeypatch)
    stopping = Stopping(running)
    until(lambda: time.monotonic() - stopping.began > 1.5, "the first request has failed")
    free.set()
    assert winding.begun.wait(20)
    assert winding.done is not None
    assert not stopping.stopped
    winding.done()
    stopping.join()
    assert winding.events == ["winding down", "stopped"]


def test_a_module_whose_thread_is_busy_does_not_delay_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(modules_worker, "WIND_DOWN_SECONDS", 60.0)
    with Place(tmp_path) as place:
        place.worker.start(place.config(ECHO, {**ECHO, "name": "last"}))  # modules stop in the reverse order
        free = threading.Event()
        place.worker.running("last").host.loop.post(lambda: free.wait(40))
        winding = WindDown(place.worker.running("echo").module, monkeypatch)
        stopping = threading.Thread(target=place.worker.stop)
        stopping.start()
        assert winding.begun.wait(20)
        assert not free.is_set()
        assert winding.done is not None
        free.set()
        winding.done()
        stopping.join(60)
        assert not stopping.is_alive()
        assert winding.events == ["winding down", "stopped"]


def test_a_module_that_does_not_wind_down_is_stopped_after_the_time_limit(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(modules_worker, "WIND_DOWN_SECONDS", 0.3)
    running = place.worker.running("echo")
    winding = WindDown(running.module, monkeypatch)
    stopping = Stopping(running)
    stopping.join()
    assert winding.events == ["winding down", "stopped"]
    assert 0.3 <= stopping.seconds < 40.0, "the module had its whole time, but no more"
    assert winding.done is not None
    winding.done()  # too late, but harmless


def test_a_module_that_has_nothing_to_wind_down_is_stopped_at_once(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(modules_worker, "WIND_DOWN_SECONDS", 120.0)
    stopping = Stopping(place.worker.running("echo"))
    stopping.join()
    assert stopping.seconds < 60.0


def test_a_module_that_fails_to_wind_down_is_closed(
    place: Place, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_done: Callable[[], None]) -> None:
        raise ValueError("no base")

    monkeypatch.setattr(modules_worker, "WIND_DOWN_SECONDS", 120.0)
    running = place.worker.running("echo")
    monkeypatch.setattr(running.module, "begin_stop", fail)
    Stopping(running).join()
    assert "no base" in caplog.text
    until(lambda: not place.far.hub.graph.publishers("/said"), "the module's endpoints are closed")


class Unready(Module):
    """Fails to start before it has what it stops."""

    name = "unready"

    def start(self, _host: Host, _section: Section) -> None:
        raise RuntimeError("no wheels")

    def stop(self) -> None:
        raise AttributeError("_wheels")


def test_a_module_that_fails_to_start_gives_its_reason_without_the_errors_of_its_stop(
    place: Place, caplog: pytest.LogCaptureFixture
) -> None:
    running = place.worker.running("echo")
    running.stop()
    running._kind = Unready
    running.start()
    assert "echo cannot start: no wheels" in caplog.text
    assert "error while stopping" not in caplog.text


def test_the_workers_of_the_sides_wait_longer_than_a_module_winds_down_and_the_daemon_waits_longest() -> None:
    """The daemon kills workers that have not exited within its time limit, and their last replies are lost."""
    assert modules_worker.WIND_DOWN_SECONDS < DRAIN_SECONDS < Timing().stop
