"""Threads for conversations with other nodes, so that dead and slow ones delay nobody else."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable

_log = logging.getLogger(__name__)

Job = Callable[[], None]


class Lanes:
    """Two groups of threads: one for addresses that answered or were not yet asked, one for those that failed lately.

    A job of an address that failed waits in the second lane, so a hundred dead nodes keep only each other waiting.
    """

    def __init__(self, fresh: int = 12, doubtful: int = 4) -> None:
        self._queues: tuple[queue.SimpleQueue[Job | None], ...] = (queue.SimpleQueue(), queue.SimpleQueue())
        self._counts = (fresh, doubtful)
        self._threads: list[threading.Thread] = []
        self._lock = threading.Lock()
        self._failed: set[str] = set()

    def submit(self, address: str, job: Job) -> None:
        """Run a job that talks to ``address`` soon."""
        with self._lock:
            lane = 1 if address in self._failed else 0
            if not self._threads:
                self._start()
        self._queues[lane].put(job)

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
        """End all threads once they have ended what they are at; does not wait."""
        with self._lock:
            for lane, count in enumerate(self._counts):
                for _ in range(count):
                    self._queues[lane].put(None)

    def _start(self) -> None:
        for lane, count in enumerate(self._counts):
            for number in range(count):
                name = f"midspan-ros1-{'doubtful' if lane else 'fresh'}-{number}"
                thread = threading.Thread(target=self._run, args=(self._queues[lane],), name=name, daemon=True)
                thread.start()
                self._threads.append(thread)

    @staticmethod
    def _run(jobs: queue.SimpleQueue[Job | None]) -> None:
        while (job := jobs.get()) is not None:
            try:
                job()
            except Exception:
                _log.exception("a conversation with a ROS 1 node failed in an unforeseen way")
