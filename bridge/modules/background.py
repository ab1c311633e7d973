"""Runs the slow jobs of a module on a separate thread, and delivers their results on the module's thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any, TypeVar

from bridge.concurrency import WorkerPool
from bridge.modules.loop import EventLoop

_END_SECONDS = 1.0

T = TypeVar("T")

Prepare = Callable[[], Callable[[], T]]
"""Called on the module's thread just before a job starts; returns the job, which holds copies of all mutable data."""


class Background:
    """Runs one job at a time; a job submitted meanwhile replaces the waiting job. Use it only on the module's thread.

    Args:
        loop: the module's thread.
        name: name of the module, for the thread.
        inline: run each job on the module's thread, so that results do not depend on timing.

    Attributes:
        trouble: why the last job failed, "" if it succeeded.
    """

    def __init__(self, loop: EventLoop, name: str, *, inline: bool = False) -> None:
        self._loop, self._inline = loop, inline
        self._pool = WorkerPool(1, f"midspan-{name}-background")
        self._waiting: list[tuple[Prepare[Any], Callable[[Any], object]]] = []
        self._running = self._closed = False
        self.trouble = ""

    def submit(self, prepare: Prepare[T], deliver: Callable[[T], object]) -> None:
        """Run a job as soon as no other runs, and deliver its result on the module's thread.

        If the job fails, nothing is delivered; the error is stored as ``trouble``, and reported like a callback's.
        """
        self._waiting = [(prepare, deliver)]
        if not self._running:
            self._begin()

    def close(self) -> None:
        """Drop the waiting job, wait up to a second for the running one, and drop its result. Safe to call twice."""
        self._closed = True
        self._waiting = []
        self._pool.close(_END_SECONDS)

    def _begin(self) -> None:
        (prepare, deliver), self._waiting = self._waiting[0], []
        future: Future[Any] = Future()
        try:
            job = prepare()
            if not self._inline:
                future = self._pool.submit(job)
                self._running = True
                future.add_done_callback(lambda done: self._loop.post(partial(self._end, done, deliver)))
                return
            future.set_result(job())
        except Exception as err:
            future.set_exception(err)
        self._end(future, deliver)

    def _end(self, future: Future[Any], deliver: Callable[[Any], object]) -> None:
        self._running = False
        if self._closed or future.cancelled():
            return
        error = future.exception()
        if error is None:
            self.trouble = ""
            deliver(future.result())
        else:
            self.trouble = f"{type(error).__name__}: {error}"
            self._loop.failures.add(error, "a background job")
        if self._waiting and not self._running:
            self._begin()
