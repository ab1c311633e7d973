"""Slow jobs of a module: one at a time on a separate thread, with results on the module's thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from bridge.modules.background import Background
from bridge.modules.loop import EventLoop
from tests.support.wait import until


@pytest.fixture
def loop() -> Iterator[EventLoop]:
    loop = EventLoop("test")
    loop.start()
    yield loop
    loop.close()


class Jobs:
    """Jobs that wait to be released, and the results that were delivered."""

    def __init__(self) -> None:
        self.prepared: list[str] = []
        self.delivered: list[tuple[str, threading.Thread]] = []
        self.threads: list[threading.Thread] = []
        self.free = threading.Event()

    def prepare(self, name: str) -> Callable[[], str]:
        self.prepared.append(name)
        return partial(self._run, name)

    def _run(self, name: str) -> str:
        self.threads.append(threading.current_thread())
        assert self.free.wait(20.0)
        if name == "bad":
            raise ValueError("no solution")
        return name

    def submit(self, background: Background, *names: str) -> None:
        for name in names:
            background.submit(partial(self.prepare, name), self.deliver)

    def deliver(self, name: str) -> None:
        self.delivered.append((name, threading.current_thread()))

    @property
    def results(self) -> list[str]:
        return [name for name, _ in self.delivered]


def test_a_newer_job_replaces_the_waiting_job_and_the_loop_stays_responsive(loop: EventLoop) -> None:
    background, jobs = Background(loop, "test"), Jobs()
    loop.call(lambda: jobs.submit(background, "first", "second", "third"))
    until(lambda: jobs.threads, "the first job runs")
    assert jobs.prepared == ["first"]
    own = loop.call(threading.current_thread)  # the loop executes the call although a job runs
    jobs.free.set()
    until(lambda: len(jobs.delivered) == 2, "two results are delivered")
    assert jobs.results == jobs.prepared == ["first", "third"]
    assert all(thread is own for _, thread in jobs.delivered)
    assert own not in jobs.threads
    background.close()


def test_an_error_is_reported_until_a_job_succeeds(loop: EventLoop, caplog: pytest.LogCaptureFixture) -> None:
    background, jobs = Background(loop, "test"), Jobs()
    jobs.free.set()
    loop.call(lambda: jobs.submit(background, "bad"))
    until(lambda: "test: a background job failed" in caplog.text, "the error is logged")
    assert background.trouble == "ValueError: no solution"
    assert not jobs.delivered
    loop.call(lambda: jobs.submit(background, "good"))
    until(lambda: jobs.delivered, "the next job succeeds")
    assert background.trouble == ""
    background.close()


def test_close_waits_for_the_running_job_and_drops_its_result(loop: EventLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.modules.background._END_SECONDS", 60.0)
    background, jobs = Background(loop, "test"), Jobs()
    loop.call(lambda: jobs.submit(background, "first", "second"))
    until(lambda: jobs.threads, "the first job runs")
    threading.Timer(0.1, jobs.free.set).start()
    background.close()
    assert not jobs.threads[0].is_alive()
    loop.call(lambda: None)
    assert not jobs.delivered
    assert jobs.prepared == ["first"]
    loop.call(lambda: jobs.submit(background, "late"))
    loop.call(lambda: None)
    assert not jobs.delivered


def test_inline_jobs_run_in_order_on_the_calling_thread() -> None:
    errors: list[BaseException] = []
    loop = EventLoop("test")
    loop.failures.on_failure = errors.append
    background, jobs = Background(loop, "test", inline=True), Jobs()
    jobs.free.set()
    jobs.submit(background, "first", "bad", "third")
    assert jobs.results == ["first", "third"]
    assert set(jobs.threads) == {threading.current_thread()}
    assert [str(error) for error in errors] == ["no solution"]
    assert background.trouble == ""
