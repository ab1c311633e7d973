"""One thread reads many connections: all on which only small messages come, and all that carry calls.

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
_JOIN_SECONDS = 1.0
_LISTEN = select.EPOLLIN | select.EPOLLRDHUP
_WATCH = select.EPOLLRDHUP


class Source(Protocol):
    """What is read here.

    Attributes:
        listens: whether what comes is read, or only its end is noticed; see `Intake.listen`.
    """

    listens: bool

    def fileno(self) -> int:
        """Its socket's descriptor, which stays the same as long as it is read here."""

    def take(self) -> Callable[[], None] | None:
        """Take what has come, without waiting; None, or what is to be done once it is read here no more."""

    def abandon(self) -> None:
        """It is read no more, since reading ends here."""


class Intake:
    """Calls `Source.take` whenever something has come; methods may be called from any thread.

    Args:
        name: of its thread, which starts with the first source.
    """

    def __init__(self, name: str = "midspan-ros1-intake") -> None:
        self._epoll = select.epoll()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC)
        self._epoll.register(self._wake, select.EPOLLIN)
        self._sources: dict[int, Source] = {}
        self._lock = threading.Lock()
        self._stopped = False
        self._name = name
        self._thread: threading.Thread | None = None

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
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()
            self._epoll.register(number, _LISTEN if source.listens else _WATCH)
            self._sources[number] = source
            return True

    def listen(self, source: Source, *, data: bool) -> None:
        """Whether what a source brings is read, or only its end is noticed."""
        with self._lock:
            source.listens = data
            number = source.fileno()
            if self._sources.get(number) is source:
                self._epoll.modify(number, _LISTEN if data else _WATCH)

    def remove(self, source: Source) -> None:
        """Leave a source alone. Before its descriptor is closed."""
        with self._lock:
            number = source.fileno()
            if self._sources.get(number) is source:
                del self._sources[number]
                self._epoll.unregister(number)

    def stop(self) -> None:
        """Read nothing more, and abandon all sources. Safe to call twice."""
        with self._lock:
            if self._stopped:
                return
            self._stopped = True
            if self._thread is None:
                self._close()
                return
            os.eventfd_write(self._wake, 1)  # with the lock: the thread closes it
        if self._thread is not threading.current_thread():
            self._thread.join(_JOIN_SECONDS)

    def _run(self) -> None:
        while not self._stopped:
            for number, _ in self._epoll.poll(maxevents=_AT_ONCE):
                source = self._sources.get(number)
                if source is not None and (then := source.take()) is not None:
                    self.remove(source)
                    self._do(then)
        for source in list(self._sources.values()):
            self._do(source.abandon)
        with self._lock:
            self._sources.clear()
            self._close()

    def _close(self) -> None:
        self._epoll.close()
        os.close(self._wake)

    @staticmethod
    def _do(then: Callable[[], None]) -> None:
        try:
            then()
        except Exception:
            _log.exception("what follows the end of a ROS 1 connection failed")
