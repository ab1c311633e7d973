"""Threads for conversations with other nodes, so that dead and slow ones delay nobody else."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable

_log = logging.getLogger(__name__)

_IDLE_SECONDS = 10.0

Job = Callable[[], None]


class Lanes:
    """Two lanes of threads: one for addresses that answered or were not yet asked, one for those that failed lately.

    A job whose address has failed since it was queued changes lanes, so dead nodes keep only each other waiting.
    """

    def __init__(self, fresh: int = 48, doubtful: int = 4) -> None:
        self._fresh = Lane("midspan-ros1-fresh", fresh)
        self._doubtful = Lane("midspan-ros1-doubtful", doubtful)
        self._lock = threading.Lock()
        self._failed: set[str] = set()

    def submit(self, address: str, job: Job) -> None:
        """Run a job that talks to ``address`` soon."""
        if self._is_doubtful(address):
            self._doubtful.submit(job)
        else:
            self._fresh.submit(lambda: self._doubtful.submit(job) if self._is_doubtful(address) else job())

    def failed(self, address: str) -> None:
        """An address did not answer."""
        with self._lock:
            self._failed.add(address)

    def answered(self, address: str) -> None:
        """An address did answer."""
        with self._lock:
            self._failed.discard(address)

    def forget(self, alive: set[str]) -> None:
        """Drop what is remembered of addresses that left the graph."""
        with self._lock:
            self._failed &= alive

    def stop(self) -> None:
        """Run nothing more; what is under way ends by its own deadlines, and is not waited for."""
        self._fresh.stop()
        self._doubtful.stop()

    def _is_doubtful(self, address: str) -> bool:
        with self._lock:
            return address in self._failed


class Lane:
    """Threads that come with the work, up to a limit, and go when there is none."""

    def __init__(self, name: str, limit: int) -> None:
        self._name, self._limit = name, limit
        self._condition = threading.Condition()
        self._jobs: deque[Job] = deque()
        self._threads = 0
        self._idle = 0
        self._stopped = False

    def submit(self, job: Job) -> None:
        """Run a job as soon as a thread is free."""
        with self._condition:
            if self._stopped:
                return
            self._jobs.append(job)
            if len(self._jobs) > self._idle and self._threads < self._limit:
                self._threads += 1
                threading.Thread(target=self._run, name=self._name, daemon=True).start()
            else:
                self._condition.notify()

    def stop(self) -> None:
        """Run nothing more."""
        with self._condition:
            self._stopped = True
            self._jobs.clear()
            self._condition.notify_all()

    def _run(self) -> None:
        while (job := self._next()) is not None:
            try:
                job()
            except Exception:
                _log.exception("a conversation with a ROS 1 node failed in an unforeseen way")

    def _next(self) -> Job | None:
        with self._condition:
            self._idle += 1
            self._condition.wait_for(lambda: self._jobs or self._stopped, _IDLE_SECONDS)
            self._idle -= 1
            if self._jobs:
                return self._jobs.popleft()
            self._threads -= 1
            return None
