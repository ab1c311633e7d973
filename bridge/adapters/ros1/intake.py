"""One thread reads all connections on which only small messages come.

Hundreds of threads that each wait for a message of their own, and then for the interpreter, take turns more often than
messages come: 500 topics at 10 Hz had the worker's threads switch 50,000 times a second.
"""

from __future__ import annotations

import logging
import os
import select
import threading
from collections.abc import Callable
from typing import Protocol

_log = logging.getLogger(__name__)

_AT_ONCE = 64
_JOIN_SECONDS = 2.0


class Source(Protocol):
    """What is read here."""

    def fileno(self) -> int:
        """Its socket's descriptor, which stays the same until `Source.take` has returned another thing than None."""

    def take(self) -> Callable[[], None] | None:
        """Take what has come, without waiting; None, or what is to be done once it is read here no more."""

    def abandon(self) -> None:
        """It is read no more, since reading ends here."""


class Intake:
    """Calls `Source.take` whenever something has come; methods may be called from any thread."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC)
        self._epoll.register(self._wake, select.EPOLLIN)
        self._sources: dict[int, Source] = {}
        self._lock = threading.Lock()
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="midspan-ros1-intake", daemon=True)
        self._thread.start()

    @staticmethod
    def available() -> bool:
        """Whether the system has what it takes (Linux)."""
        return hasattr(select, "epoll") and hasattr(os, "eventfd")

    def add(self, source: Source) -> bool:
        """Read a source from now on; False where it is closed or once stopped.

        Raises:
            OSError: the system cannot watch it.
        """
        with self._lock:
            number = source.fileno()
            if self._stopped or number < 0:
                return False
            self._epoll.register(number, select.EPOLLIN)
            self._sources[number] = source
            return True

    def stop(self) -> None:
        """Read nothing more, and abandon all sources. Safe to call twice."""
        with self._lock:
            if self._stopped:
                return
            self._stopped = True
            os.eventfd_write(self._wake, 1)  # with the lock: the thread closes it
        if self._thread is not threading.current_thread():
            self._thread.join(_JOIN_SECONDS)

    def _run(self) -> None:
        while not self._stopped:
            for number, _ in self._epoll.poll(maxevents=_AT_ONCE):
                source = self._sources.get(number)
                if source is not None and (then := source.take()) is not None:
                    self._drop(number, source)
                    self._do(then)
        for source in self._sources.values():
            source.abandon()
        self._sources.clear()
        with self._lock:
            self._epoll.close()
            os.close(self._wake)

    @staticmethod
    def _do(then: Callable[[], None]) -> None:
        try:
            then()
        except Exception:
            _log.exception("what follows the end of a ROS 1 connection failed")

    def _drop(self, number: int, source: Source) -> None:
        with self._lock:
            if self._sources.get(number) is source:
                del self._sources[number]
                self._epoll.unregister(number)
