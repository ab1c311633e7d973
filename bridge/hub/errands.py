"""Small pieces of work that a thread of zenoh must not do itself, because they may wait for zenoh."""

from __future__ import annotations

import logging
from collections.abc import Callable
from queue import SimpleQueue
from threading import Lock, Thread

_log = logging.getLogger(__name__)


class Errands:
    """A thread, made when the first piece of work comes, that does them one after the other."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._queue: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._lock = Lock()
        self._thread: Thread | None = None
        self._closed = False

    def send(self, errand: Callable[[], None]) -> None:
        """Have a piece of work done soon; none is after `close`."""
        with self._lock:
            if self._closed:
                return
            self._queue.put(errand)
            if self._thread is None:
                self._thread = Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()

    def close(self) -> None:
        """Do what waits, and end the thread. Safe to call twice."""
        with self._lock:
            self._closed = True
            self._queue.put(None)
        if self._thread is not None:
            self._thread.join(2.0)

    def _run(self) -> None:
        while (errand := self._queue.get()) is not None:
            try:
                errand()
            except Exception:
                _log.debug("%s: an errand failed", self._name, exc_info=True)
