"""The TCPROS server: accepts connections, and reads each peer's header (https://wiki.ros.org/ROS/TCPROS).

The headers are read by the loop that reads all small messages, so that any number of silent peers costs no thread. A
header must be complete within `_SECONDS`. A peer with a complete header is admitted on a thread, since the reply may
block for that long, too.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import struct
import time
from collections.abc import Callable, Mapping

from typing_extensions import override

from bridge.adapters.ros1.connection_loop import ConnectionLoop, PolledConnection, is_readable, receive_now
from bridge.adapters.ros1.handshake import MAX_HEADER, decode, encode
from bridge.adapters.ros1_peers import DeadlineSocket, Ros1ProtocolError
from bridge.concurrency import DelayedCalls, WorkerPool

_log = logging.getLogger(__name__)

_SECONDS = 5.0
_MAX_OPEN = 1000
"""Maximum number of connections without a complete header; beyond it, new connections are closed."""

_MAX_BYTES = 32 * 2**20
"""Maximum total size of the incomplete headers of all connections, in bytes."""

_ACCEPTED_AT_ONCE = 64
_ADMITTED_AT_ONCE = 16
_PAUSE = 0.5
_LENGTH = struct.Struct("<I")

Admit = Callable[[DeadlineSocket, Mapping[str, str]], str]
"""Adopts a peer with its header; returns "" or why it is rejected. Raises `OSError` and `Ros1ProtocolError`."""


class TcprosServer(PolledConnection):
    """Listens on a socket, and calls ``admit`` with each peer that has sent its header."""

    def __init__(self, listener: socket.socket, loop: ConnectionLoop, timer: DelayedCalls, admit: Admit) -> None:
        self.port = int(listener.getsockname()[1])
        super().__init__(listener)
        self._sock.setblocking(False)
        self._loop, self._timer, self._admit = loop, timer, admit
        self._pool = WorkerPool(_ADMITTED_AT_ONCE, "midspan-ros1-greet")
        self._closed = False
        self._open: set[_Greeting] = set()
        self._bytes = 0
        loop.add(self)

    @override
    def on_ready(self) -> Callable[[], None] | None:
        """Accept waiting connections; if the system is out of descriptors, return a function that pauses accepting."""
        for _ in range(_ACCEPTED_AT_ONCE):
            try:
                sock, _ = self._sock.accept()
            except (BlockingIOError, ConnectionAbortedError):
                return None
            except OSError as err:
                if not self._closed:
                    _log.warning("ROS 1 nodes cannot connect: %s", err)
                return self._pause
            self._greet(sock)
        return None

    @override
    def abandon(self) -> None:
        self.close()

    def close(self) -> None:
        """Stop listening. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._loop.remove(self)
        self._sock.close()
        self._pool.close()

    def _pause(self) -> None:
        self._timer.after(_PAUSE, self._resume)

    def _resume(self) -> None:
        if not self._closed:
            self._loop.add(self)

    def _greet(self, sock: socket.socket) -> None:
        if len(self._open) >= _MAX_OPEN:
            sock.close()
            return
        try:
            greeting = _Greeting(sock, self)
        except OSError as err:  # the peer has disconnected
            _log.debug("a ROS 1 peer was not admitted: %s", err)
            sock.close()
            return
        self._open.add(greeting)
        try:
            self.watch(greeting)
            added = self._loop.add(greeting)
        except (OSError, RuntimeError) as err:  # out of descriptors, memory or threads
            _log.warning("a ROS 1 peer cannot be admitted: %s", err)
            added = False
        if not added:
            greeting.abandon()

    def watch(self, greeting: _Greeting) -> None:
        """Limit the time for a header, or for the rest of it."""
        self._timer.after(_SECONDS, greeting.expire)

    # -- called by the greetings, on the loop's thread -----------------------------------------------------------------

    def has_room(self, count: int) -> bool:
        """Count received bytes of a header; return False if all incomplete headers together are too large."""
        self._bytes += count
        return self._bytes <= _MAX_BYTES

    def ended(self, greeting: _Greeting, count: int) -> None:
        """Count out a greeting that has ended, with its ``count`` received bytes."""
        self._open.discard(greeting)
        self._bytes -= count

    def complete(self, sock: socket.socket, body: bytes) -> None:
        """Admit a peer that has sent its header; disconnect it if the server closes first or no thread can start."""
        admission = self._pool.submit(lambda: self._complete(sock, body))
        admission.add_done_callback(lambda future: sock.close() if future.cancelled() else None)

    def _complete(self, plain: socket.socket, body: bytes) -> None:
        sock = DeadlineSocket.adopt(plain, time.monotonic() + _SECONDS)
        try:
            error = self._admit(sock, decode(body))
            if error:
                sock.sendall(encode({"error": error}))
                sock.close()
        except (OSError, Ros1ProtocolError) as err:
            _log.debug("a ROS 1 peer was rejected: %s", err)
            sock.close()
        except Exception:
            _log.exception("a ROS 1 peer could not be admitted")
            sock.close()


class _Greeting(PolledConnection):
    """A connection whose header is being received."""

    def __init__(self, sock: socket.socket, server: TcprosServer) -> None:
        super().__init__(sock)
        self._server = server
        self._buffer = bytearray()
        self._size = _LENGTH.size
        self._over = False

    @override
    def on_ready(self) -> Callable[[], None] | None:
        """Receive a part of the header, but no byte after it."""
        try:
            data = receive_now(self._sock, min(self._size - len(self._buffer), 65536))
        except BlockingIOError:
            return None
        except OSError:
            return self.abandon
        if not data or not self._server.has_room(len(data)):
            self._buffer += data
            return self.abandon
        self._buffer += data
        if len(self._buffer) == _LENGTH.size:
            self._size += _LENGTH.unpack(self._buffer)[0]
            if self._size > MAX_HEADER:
                return self.abandon
        return self._complete if len(self._buffer) == self._size else None

    def expire(self) -> None:
        """Disconnect a peer that has not sent its header in time; called on any thread."""
        with self._lock:
            if self._over:
                return
            # if the peer has sent something, the loop's thread was busy, or this process suspended
            late = is_readable(self._sock)
            if not late:
                with contextlib.suppress(OSError):
                    self._sock.shutdown(socket.SHUT_RDWR)
        if late:
            self._server.watch(self)

    @override
    def abandon(self) -> None:
        self._end()
        self._sock.close()

    def _complete(self) -> None:
        body = bytes(self._buffer[_LENGTH.size :])
        self._end()
        self._server.complete(self._sock, body)

    def _end(self) -> None:
        with self._lock:
            self._over = True
        self._server.ended(self, len(self._buffer))
        self._buffer.clear()
