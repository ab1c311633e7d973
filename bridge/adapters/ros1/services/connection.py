"""Connections for service calls: the loop reads them, and any thread may write to them.

After its header a connection to a service carries one call at a time (https://wiki.ros.org/ROS/TCPROS,
https://wiki.ros.org/roscpp/Overview/Services): the request is a little-endian 32-bit length and the bytes; the reply is
a success byte, a length, and the response or the error's text.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import struct
import threading
from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import ClassVar

from typing_extensions import override

from bridge.adapters.ros1.connection_loop import ConnectionLoop, PolledConnection, receive_now, send_now

_log = logging.getLogger(__name__)

LENGTH = struct.Struct("<I")

_CHUNK = 64 * 1024
"""Size limit of messages that the loop's thread reads; larger ones would delay other connections."""

_MAX_AHEAD = 4096
"""Maximum number of bytes that are read from a peer during a call, before the reply; the rest stays in the socket."""

_TRUSTED = 16 * 2**20
"""Maximum number of bytes that are allocated when a length is announced; more are allocated only as they arrive."""

_STOPS = "was closed because the bridge is stopping"


class ServiceConnection(PolledConnection):
    """One connection. Only the reading thread closes its descriptor; other threads shut the connection down instead."""

    head: ClassVar[int]
    """Bytes before a message's body; the last four of them are the body's length."""

    def __init__(self, sock: socket.socket, loop: ConnectionLoop, limit: int) -> None:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        super().__init__(sock)
        self._loop, self._limit = loop, limit
        self._over = False
        self._buffer = self._ahead = b""
        self._size = 0
        self._skip = 0
        self._sending = False

    @abstractmethod
    def _message(self, head: bytes, body: bytes) -> None:
        """Handle a whole message, on the reading thread."""

    @abstractmethod
    def _too_large(self, size: int) -> bool:
        """Handle the announcement of a message above the limit; return whether to skip it and continue."""

    def _skipped(self, size: int) -> None:
        """Handle the end of a skipped message."""

    @abstractmethod
    def _ended(self, trouble: str) -> None:
        """Handle the end of the connection, once, on the reading thread; ``trouble`` completes "the peer ..."."""

    def _sent(self) -> None:
        """Handle the completion of a send, on any thread."""

    def start(self) -> None:
        """Start reading; called on the thread that has been reading so far."""
        try:
            trouble = "" if self._loop.add(self) else _STOPS
        except OSError as err:
            trouble = f"cannot be read: {err}"
        if trouble:
            self.end(trouble)

    def cut(self) -> None:
        """Shut the connection down; the system still sends what the socket has accepted. Safe to call twice.

        Thread-safe.
        """
        with self._lock:
            if not self._over:
                with contextlib.suppress(OSError):
                    self._sock.shutdown(socket.SHUT_RDWR)

    def end(self, trouble: str) -> None:
        """Close the connection; called only on the reading thread."""
        with self._lock:
            if self._over:
                return
            self._over = True
            self._loop.remove(self)
            with contextlib.suppress(OSError):
                self._sock.shutdown(socket.SHUT_RDWR)
            self._sock.close()
        self._ended(trouble)

    def send(self, *parts: bytes) -> bool:
        """Send without blocking; a thread sends what the socket does not accept at once. Return False if that fails."""
        with self._lock:
            if self._over:
                return False
            try:
                sent = send_now(self._sock, *parts)
            except BlockingIOError:
                sent = 0
            except OSError:
                return False
            unsent = memoryview(b"".join(parts))[sent:] if sent < sum(map(len, parts)) else None
            if unsent is not None:
                try:
                    copy = self._sock.dup()
                except OSError:  # no descriptor left
                    return False
                self._sending = True
        if unsent is None:
            self._sent()
            return True
        sending = threading.Thread(target=self._send_rest, args=(copy, unsent), name="midspan-ros1-send", daemon=True)
        try:
            sending.start()
        except RuntimeError as err:  # the system is out of threads
            _log.warning("a large message cannot be sent: %s", err)
            copy.close()
            return False
        return True

    def _send_rest(self, copy: socket.socket, unsent: memoryview) -> None:
        try:
            with copy:
                copy.sendall(unsent)
        except OSError:
            self.cut()
        else:
            with self._lock:
                self._sending = False
            self._sent()

    def is_at_rest(self) -> bool:
        """Return whether all output is sent, and nothing is waiting to be read; called on the reading thread."""
        with self._lock:
            if self._sending:
                return False
        try:
            receive_now(self._sock, 1, socket.MSG_PEEK)
        except BlockingIOError:
            return True
        except OSError:
            pass
        return False

    @override
    def on_ready(self) -> None:
        try:
            self.ready()
        except Exception as err:
            _log.exception("a call failed unexpectedly")
            self.end(f"failed here: {type(err).__name__}: {err}")

    @override
    def abandon(self) -> None:
        self.end(_STOPS)

    def ready(self) -> None:
        """Read available data, up to the end of one message; called on the reading thread."""
        wanted = self._skip or (self._size if len(self._buffer) >= self.head else self.head) - len(self._buffer)
        data = self._available(self._receive, min(wanted, _CHUNK), "closed the connection")
        if not data:
            return
        if self._skip:
            self._skip -= len(data)
            if not self._skip:
                self._skipped(self._size - self.head)
                self._buffer = b""
        else:
            self._buffer += data
            self._advance()

    def read_ahead(self) -> None:
        """Buffer what the peer sends during a call, so that the end of the connection after that data is noticed."""
        data = self._available(partial(receive_now, self._sock), _MAX_AHEAD - len(self._ahead), "left")
        if not data:
            return
        self._ahead += data
        if len(self._ahead) == _MAX_AHEAD:
            self._loop.pause(self)
        if self.listens:  # the reply was sent meanwhile, so messages are read again
            self.ready()

    def _available(self, receive: Callable[[int], bytes], count: int, at_end: str) -> bytes:
        """Return available data; b"" if nothing has arrived, or if the connection has ended, which is handled here."""
        try:
            data = receive(count)
        except BlockingIOError:
            return b""
        except OSError as err:
            self.end(f"broke off: {err}")
            return b""
        if not data:
            self.end(at_end)
        return data

    def resume(self) -> None:
        """Read messages again. Thread-safe."""
        self._loop.listen(self, data=True)
        if self._ahead:
            self._loop.call_ready(self)

    def _receive(self, count: int) -> bytes:
        if not self._ahead:
            return receive_now(self._sock, count)
        data, self._ahead = self._ahead[:count], self._ahead[count:]
        return data

    def _advance(self) -> None:
        if len(self._buffer) == self.head:
            (size,) = LENGTH.unpack_from(self._buffer, self.head - 4)
            self._size = self.head + size
            if size > self._limit:
                if self._too_large(size):
                    self._skip = size
                return
            if size > _CHUNK:
                self._loop.remove(self)
                threading.Thread(target=self._read_large, name="midspan-ros1-large", daemon=True).start()
                return
            if size:
                self.ready()
                return
        if len(self._buffer) >= self.head and len(self._buffer) == self._size:
            self._whole(self._buffer[: self.head], self._buffer[self.head :])

    def _whole(self, head: bytes, body: bytes) -> None:
        self._buffer = b""
        self._message(head, body)

    def _read_large(self) -> None:
        """Read one large body, and return the connection to the loop."""
        parts = [self._receive(self._size - self.head)] if self._ahead else []
        left = self._size - self.head - sum(map(len, parts))
        try:
            while left:
                data = self._sock.recv(min(left, _TRUSTED), socket.MSG_WAITALL)
                if not data:
                    self.end("closed the connection")
                    return
                parts.append(data)
                left -= len(data)
            self._whole(self._buffer, parts[0] if len(parts) == 1 else b"".join(parts))
        except OSError as err:
            self.end(f"broke off: {err}")
            return
        except Exception as err:
            _log.exception("a large message failed unexpectedly")
            self.end(f"failed here: {type(err).__name__}: {err}")
            return
        if not self._over:
            self.start()
