"""A connection to one subscriber: writes at once if the socket has room, else queues, and never blocks."""

from __future__ import annotations

import contextlib
import logging
import socket
import struct
import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import ClassVar

from typing_extensions import override

from bridge.adapters.ros1.compiled import Socket
from bridge.adapters.ros1.connection_loop import receive_now, send_now
from bridge.adapters.ros1.topics.bus import TopicConnection

_log = logging.getLogger(__name__)

MAX_WAITING = 64 * 2**20
"""Maximum number of queued bytes for one subscriber; the newest message of each source is queued even beyond it."""

MAX_MESSAGES = 20_000
"""Maximum number of queued messages for one subscriber, over all sources."""

_LENGTH = struct.Struct("<I")
_MAX_UNEXPECTED = 64 * 1024
"""Maximum number of bytes that a subscriber may send after its header; more disconnect it. TCPROS defines no such
bytes, so they are discarded."""


class SubscriberConnection(TopicConnection):
    """Sends messages to one subscriber without ever blocking the sender.

    While the socket's buffer has room, the sender's thread writes. A slower subscriber gets a separate thread and a
    queue of at most ``depth`` messages per source and `MAX_WAITING` bytes; beyond that, the oldest messages of the same
    source are dropped. ``node`` is the subscriber's name; ``ended`` is called when reading or the separate thread
    detects that the connection has ended. ``socket`` also sends, in C, while it is ``free``: nothing waits.
    """

    direction = "o"
    native: ClassVar[bool] = True
    """Whether messages may be sent in C."""

    def __init__(
        self, sock: socket.socket, name: str, node: str = "",
        ended: Callable[[SubscriberConnection], None] | None = None,
    ) -> None:  # fmt: skip
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # if this fails, the caller still has the socket
        super().__init__(sock, node)
        self.listens = False
        self._name, self._ended = name, ended
        self._condition = threading.Condition(self._lock)
        self._queue: deque[tuple[str, bytes]] = deque()
        self._waiting: Counter[str] = Counter()
        self._bytes = self._unexpected = 0
        self._rest: bytes | memoryview = b""
        self._writing = False
        self._thread: threading.Thread | None = None
        self.socket: Socket | None = None
        if Socket is not None and self.native:
            self.socket = Socket(self._sock.fileno(), (self._lock.locked,), self._resume)

    @property
    def waiting(self) -> int:
        """Number of queued messages."""
        return len(self._queue)

    @property
    def busy(self) -> bool:
        """Whether a message waits, or has been sent in part."""
        return bool(self._writing or self._rest or self._queue or (self.socket is not None and self.socket.cut))

    def send(self, payload: bytes, source: str, depth: int) -> bool:
        """Send or queue one message; return False if the connection is broken."""
        with self._lock:
            if self.done:
                return False
            if self.busy:
                self._enqueue(payload, source, depth)
                self._set_free()
                if self._thread is None:
                    self._wake()
                return True
            header = _LENGTH.pack(len(payload))
            try:
                sent = send_now(self._sock, header, payload)
            except BlockingIOError:
                sent = 0
            except OSError:
                return False
            self.bytes += sent
            if sent < len(payload) + 4:
                self._rest = header[sent:] + payload if sent < 4 else memoryview(payload)[sent - 4 :]
                self._set_free()
                self._wake()
            else:
                self.messages += 1
            return True

    def close(self) -> None:
        """Disconnect; queued messages are dropped. Safe to call twice."""
        with self._lock:
            if self.done:
                return
            self.done = True
            self._set_free()
            self._queue.clear()
            self._waiting.clear()
            self._bytes = 0
            with contextlib.suppress(OSError):
                self._sock.shutdown(socket.SHUT_RDWR)
            if not self._writing:  # otherwise the writing thread closes the socket
                self._sock.close()
            self._condition.notify()

    @override
    def on_ready(self) -> Callable[[], None] | None:
        """Discard what the subscriber sends; if the connection has ended, return a function that handles that."""
        try:
            data = receive_now(self._sock, _MAX_UNEXPECTED)
        except BlockingIOError:
            return None
        except OSError:
            return self.abandon
        self._unexpected += len(data)
        return self.abandon if not data or self._unexpected > _MAX_UNEXPECTED else None

    @override
    def abandon(self) -> None:
        if self._ended is not None:
            self._ended(self)
        else:
            self.close()

    @override
    def counts(self) -> tuple[int, int]:
        size, messages = super().counts()
        return (size, messages) if self.socket is None else (size + self.socket.bytes, messages + self.socket.messages)

    def _set_free(self) -> None:
        """Let the socket send if nothing waits; the lock is held."""
        if self.socket is not None:
            self.socket.free = not (self.done or self.busy)

    def _resume(self) -> None:
        """Send the rest of a message that the socket has cut, or end a connection that has failed."""
        assert self.socket is not None
        if self.socket.failed:
            self.abandon()
            return
        with self._lock:
            if not self.done:
                self._wake()

    def _enqueue(self, payload: bytes, source: str, depth: int) -> None:
        while self._waiting[source] and (self._waiting[source] >= depth or self._bytes + len(payload) > MAX_WAITING):
            self._drop(next(i for i, (s, _) in enumerate(self._queue) if s == source))
        if len(self._queue) >= MAX_MESSAGES:
            self._drop(0)
        self._waiting[source] += 1
        self._bytes += len(payload)
        self._queue.append((source, payload))

    def _drop(self, position: int) -> None:
        source, payload = self._queue[position]
        del self._queue[position]
        self._bytes -= len(payload)
        self._waiting[source] -= 1
        if not self._waiting[source]:
            del self._waiting[source]
        self.dropped += 1

    def _wake(self) -> None:
        if self._thread is None:
            thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            try:
                thread.start()
            except RuntimeError as err:  # the system is out of threads; the next message tries again
                _log.debug("%s: a message waits: %s", self._name, err)
                return
            self._thread = thread
        self._condition.notify()

    def _next(self) -> bytes | memoryview | None:
        """Wait for data to write; return None once closed. The lock is held."""
        while not (self.done or self.busy):
            self._condition.wait()
        if self.done:
            return None
        if self.socket is not None and self.socket.cut:
            return self.socket.take()
        if self._rest:
            unsent, self._rest = self._rest, b""
            return unsent
        source, payload = self._queue.popleft()
        self._waiting[source] -= 1
        self._bytes -= len(payload)
        if not self._waiting[source]:
            del self._waiting[source]
        return _LENGTH.pack(len(payload)) + payload

    def _run(self) -> None:
        while True:
            with self._lock:
                data = self._next()
                if data is None:
                    return
                self._writing = True
            try:
                self._sock.sendall(data)
            except OSError as err:
                _log.debug("%s: %s", self._name, err)
                broken = True
            else:
                broken = False
            with self._lock:
                self._writing = False
                if self.done:
                    self._sock.close()
                    return
                if not broken:
                    self.bytes += len(data)
                    self.messages += 1
                    self._set_free()
            if broken:
                self.abandon()
                return
