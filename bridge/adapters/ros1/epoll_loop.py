"""One thread that reads many connections: those with only small messages, and those of service calls.

With one thread per connection, waiting for messages and for the interpreter, thread switches outnumber messages: 500
topics at 10 Hz caused 50,000 switches per second.
"""

from __future__ import annotations

import logging
import os
import select
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable

_log = logging.getLogger(__name__)

_AT_ONCE = 64
_JOIN_SECONDS = 1.0
_LISTEN = select.EPOLLIN | select.EPOLLRDHUP
_WATCH = select.EPOLLRDHUP

_KEEPALIVE = (("TCP_KEEPIDLE", 60), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 9))
"""Same values as rospy's and roscpp's subscribers: the loss of a peer's machine is noticed after 2.5 minutes."""


class PolledConnection(ABC):
    """A TCP connection that the loop reads; without ``listens``, it only watches for the end of the connection."""

    def __init__(self, sock: socket.socket) -> None:
        self.listens = True
        keep_alive(sock)
        self._sock = socket.socket(fileno=sock.detach())
        self._sock.settimeout(None)
        self._lock = threading.Lock()

    def fileno(self) -> int:
        """Return the socket's descriptor, which does not change while the loop reads it."""
        return self._sock.fileno()

    @abstractmethod
    def on_ready(self) -> Callable[[], None] | None:
        """Read available data without blocking; return a function for the loop to call after removing this, or None."""

    @abstractmethod
    def abandon(self) -> None:
        """Close the connection, as the loop ends."""


def keep_alive(sock: socket.socket) -> None:
    """Let the system detect the loss of a peer's machine."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in _KEEPALIVE:
        if hasattr(socket, name):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


class EpollLoop:
    """Calls `PolledConnection.on_ready` when data is available; thread-safe."""

    def __init__(self, name: str = "midspan-ros1-intake") -> None:
        self._epoll = select.epoll()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC)
        self._epoll.register(self._wake, select.EPOLLIN)
        self._sources: dict[int, PolledConnection] = {}
        self._lock = threading.Lock()
        self._stopped = False
        self._name = name
        self._thread: threading.Thread | None = None

    def add(self, source: PolledConnection) -> bool:
        """Start to read a source; return False if it is closed or the loop is stopped. Raises `OSError`."""
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

    def listen(self, source: PolledConnection, *, data: bool) -> None:
        """Set whether a source's data is read, or only its end is watched for."""
        with self._lock:
            source.listens = data
            number = source.fileno()
            if self._sources.get(number) is source:
                self._epoll.modify(number, _LISTEN if data else _WATCH)

    def remove(self, source: PolledConnection) -> None:
        """Stop watching a source; call it before its descriptor is closed."""
        with self._lock:
            number = source.fileno()
            if self._sources.get(number) is source:
                del self._sources[number]
                self._epoll.unregister(number)

    def stop(self) -> None:
        """Stop reading, and abandon all sources. Safe to call twice."""
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
                if source is not None and (then := source.on_ready()) is not None:
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
            _log.exception("the callback after the end of a ROS 1 connection failed")
