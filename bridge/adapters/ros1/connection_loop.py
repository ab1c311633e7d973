"""One thread that reads many connections: topics with only small messages, and service calls.

With one thread per connection, each waiting for messages and for the interpreter lock, there are more thread switches
than messages: 500 topics at 10 Hz caused 50,000 switches per second.
"""

from __future__ import annotations

import contextlib
import logging
import select
import selectors
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import ClassVar

from typing_extensions import override

from bridge.adapters.ros1.compiled import Intake, Stream
from bridge.hub.lane.joining import Joining, flush_joined
from yarp_compat.threaded_loop import ThreadedLoop

_log = logging.getLogger(__name__)

_JOIN_SECONDS = 1.0

_KEEPALIVE = (("TCP_KEEPIDLE", 60), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 9))
"""The values of rospy's and roscpp's subscribers; the loss of a peer's machine is detected after 2.5 minutes."""


class PolledConnection(ABC):
    """A TCP connection that the loop reads.

    While ``listens`` is true, its messages are read. Otherwise the loop calls it only so that the end of the connection
    is detected, and the connection may call `ConnectionLoop.pause` if its peer sends more than it can buffer.
    """

    joins: ClassVar[bool] = False
    """Whether reading takes so little time that earlier messages may wait meanwhile (`bridge.hub.lane.joining`)."""

    stream: Stream | None = None
    """Reads the messages, while it is direct, instead of `on_ready`."""

    def __init__(self, sock: socket.socket) -> None:
        self.listens, self.paused = True, False
        keep_alive(sock)
        # with family and type, the constructor need not query them, which fails on macOS if the peer has disconnected
        self._sock = socket.socket(sock.family, sock.type, sock.proto, fileno=sock.detach())
        self._sock.settimeout(None)
        self._lock = threading.Lock()

    def fileno(self) -> int:
        """Return the socket's descriptor, which does not change while the loop reads it."""
        return self._sock.fileno()

    @abstractmethod
    def on_ready(self) -> Callable[[], None] | None:
        """Read available data without blocking; return None or, to leave the loop, a function to call afterwards."""

    @abstractmethod
    def abandon(self) -> None:
        """Close the connection, because the loop is stopping or reading has failed."""


def keep_alive(sock: socket.socket) -> None:
    """Let the system detect the loss of a peer's machine; no effect on macOS if the peer has disconnected."""
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE:
            if hasattr(socket, name):
                sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


if hasattr(socket, "MSG_DONTWAIT"):

    def receive_now(sock: socket.socket, count: int, flags: int = 0) -> bytes:
        """Receive without blocking; raises `BlockingIOError` if nothing has arrived."""
        return sock.recv(count, flags | socket.MSG_DONTWAIT)

    def send_now(sock: socket.socket, *parts: bytes) -> int:
        """Send as much as the socket accepts, and return the number of bytes; raises `BlockingIOError` if none."""
        return sock.sendmsg(parts, [], socket.MSG_DONTWAIT)

else:

    def receive_now(sock: socket.socket, count: int, flags: int = 0) -> bytes:
        """Receive without blocking; raises `BlockingIOError` if nothing has arrived. Only one thread may read it."""
        if not is_readable(sock):
            raise BlockingIOError
        return sock.recv(count, flags)

    def send_now(sock: socket.socket, *parts: bytes) -> int:
        """Send as much as the socket accepts, and return the number of bytes; raises `BlockingIOError` if none.

        No thread may block on the socket meanwhile; a thread that reads it must have checked that it is readable.
        """
        sock.setblocking(False)
        try:
            return sock.send(b"".join(parts))
        finally:
            sock.setblocking(True)


def receiver(sock: socket.socket, count: int) -> Callable[[], bytes]:
    """Return a function that works like `receive_now`, without a Python stack frame if the system allows that."""
    if hasattr(socket, "MSG_DONTWAIT"):
        return partial(sock.recv, count, socket.MSG_DONTWAIT)
    return partial(receive_now, sock, count)


def is_readable(sock: socket.socket) -> bool:
    """Return whether a read would not block: the socket has data, or its peer has closed the connection."""
    if hasattr(select, "poll"):  # unlike select, it accepts any descriptor
        poll = select.poll()
        poll.register(sock, select.POLLIN)
        return bool(poll.poll(0))
    return bool(select.select([sock], [], [], 0)[0])


class ConnectionLoop(ThreadedLoop):
    """Calls `PolledConnection.on_ready` when data is available; thread-safe. The first source starts the thread."""

    def __init__(self, name: str = "midspan-ros1-intake") -> None:
        super().__init__(name, self._abandon, _log)
        self._sources: dict[int, PolledConnection] = {}
        self._joining: Joining | None = None
        self._intake: Intake | None = None
        if Intake is not None and type(self._selector).__name__ == "EpollSelector":  # other systems lack the class
            self._intake = Intake(self._selector.fileno(), flush_joined)
            self._select = self._wait

    def add(self, source: PolledConnection) -> bool:
        """Start reading a source; return False if it is closed or the loop is stopped. Raises `OSError`."""
        with self._lock:
            number = source.fileno()
            if self._stopping or number < 0:
                return False
            self.start()
            # before `watch`, because the thread may call the source at once, and the source may use the loop
            self._sources[number] = source
            try:
                if self._intake is not None and source.stream is not None:
                    self._intake.add(number, source.stream)
                self.watch(number, partial(self._on_ready, source))
            except BaseException:
                self._forget(number)
                raise
            return True

    def listen(self, source: PolledConnection, *, data: bool) -> None:
        """Set whether a source's messages are read, or only its end is noticed."""
        source.listens = data
        if data and source.paused:
            with self._lock:
                source.paused = False
                self._watch(source, readable=True)

    def pause(self, source: PolledConnection) -> None:
        """Stop watching a source until its messages are read again; no effect while they are being read."""
        with self._lock:
            source.paused = True  # before the check: `listen`, on another thread, checks it after it has set `listens`
            if source.listens:
                source.paused = False
            else:
                self._watch(source, readable=False)

    def call_ready(self, source: PolledConnection) -> None:
        """Have the loop call a source that it still reads, although its socket may have no data."""
        self.call_soon(lambda: self._on_ready(source) if self._sources.get(source.fileno()) is source else None)

    def remove(self, source: PolledConnection) -> None:
        """Stop watching a source; call it before its descriptor is closed."""
        with self._lock:
            number = source.fileno()
            if self._sources.get(number) is source:
                self._forget(number)
                self.unwatch(number)

    def _forget(self, number: int) -> None:
        del self._sources[number]
        if self._intake is not None:
            self._intake.remove(number)

    def _wait(self, pause: float | None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait like the selector, but leave only those connections to Python that need it (``intake.c``)."""
        assert self._intake is not None
        files, ready = self._selector.get_map(), []
        for number, events in self._intake.wait(pause):
            with contextlib.suppress(KeyError):  # it was removed meanwhile
                key = files[number]
                readable = selectors.EVENT_READ if events & ~select.EPOLLOUT else 0
                writable = selectors.EVENT_WRITE if events & ~select.EPOLLIN else 0
                ready.append((key, (readable | writable) & key.events))
        return ready

    @override
    def step(self, seconds: float | None = None) -> None:
        if self._joining is None:
            self._joining = Joining()  # on this thread
        try:
            super().step(seconds)
        finally:
            self._joining.flush()

    @override
    def stop(self, seconds: float | None = _JOIN_SECONDS) -> None:
        """Stop reading, and abandon all sources. Safe to call twice."""
        super().stop(seconds)

    def _watch(self, source: PolledConnection, *, readable: bool) -> None:
        number = source.fileno()
        if self._sources.get(number) is source:
            self.watch(number, partial(self._on_ready, source) if readable else None)

    def _on_ready(self, source: PolledConnection) -> None:
        if self._joining is not None and not source.joins:
            self._joining.flush()
        try:
            then = source.on_ready()
        except Exception:
            _log.exception("reading a ROS 1 connection failed")
            then = source.abandon
        if then is not None:
            self.remove(source)
            then()

    def _abandon(self) -> None:
        for source in list(self._sources.values()):
            self._run(source.abandon)
        self._sources.clear()
