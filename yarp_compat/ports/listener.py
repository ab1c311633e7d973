"""A port's listening socket, and the connections whose peers have not introduced themselves yet."""

from __future__ import annotations

import contextlib
import errno
import logging
import math
import socket
import time
from collections.abc import Callable

from yarp_compat.ports.loop import PortLoop
from yarp_compat.ports.sockets import closed_on_failure, tune
from yarp_compat.wire import carriers
from yarp_compat.wire.carriers import Opening
from yarp_compat.wire.errors import WireError

_log = logging.getLogger("yarp.ports")

PATIENCE = 10.0  # seconds within which a connection must introduce itself
MOST_SILENT = 200
"""Maximum connections of one port that have not introduced themselves; a further one closes the oldest."""
_PER_TURN = 32  # maximum connections to accept at a time
_PAUSE = 0.2  # seconds without accepting connections after the system has run out of resources
_WARNING_PERIOD = 60.0  # least seconds between two warnings of one port
_TOO_MANY_FILES = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)

Opened = Callable[[socket.socket, Opening, bytes, tuple[str, int]], None]
Refused = Callable[[str, WireError], None]


class Listener:
    """Accepts connections on the shared thread, from `start` to `close`, and reads their introductions.

    ``opened`` receives the connection, its introduction, the bytes that followed and the peer's address; ``refused`` is
    called for an invalid introduction. Both are called on the shared thread.
    """

    def __init__(self, loop: PortLoop, sock: socket.socket, opened: Opened, refused: Refused) -> None:
        self.loop = loop
        self._sock = sock
        self.opened = opened
        self.refused = refused
        self.silent: dict[socket.socket, _Introduction] = {}
        self._closed = False
        self._warned_at = -math.inf
        sock.setblocking(False)

    def start(self) -> None:
        """Listen; raises `OSError` if the system cannot watch one more socket."""
        if not self._closed:
            self.loop.watch(self._sock, self._accept)

    def close(self) -> None:
        """Stop listening; connections passed to ``opened`` stay open."""
        if self.loop.is_own_thread:
            self._close()
            return
        self.loop.run(self._close)

    def abandon(self) -> None:
        """Close the sockets in a forked child process, which lacks the shared thread."""
        for sock in (self._sock, *self.silent):
            sock.close()

    def _close(self) -> None:
        self._closed = True
        self.loop.unwatch(self._sock)
        self._sock.close()
        for introduction in list(self.silent.values()):
            introduction.drop()

    def _accept(self) -> None:
        for _ in range(_PER_TURN):
            try:
                sock, address = self._sock.accept()
            except BlockingIOError:
                return
            except OSError as error:
                if error.errno in _TOO_MANY_FILES:
                    self._make_room(error)
                return  # the peer left before it was accepted
            sock.setblocking(False)
            tune(sock)
            if len(self.silent) >= MOST_SILENT:
                next(iter(self.silent.values())).drop()
            try:
                self.silent[sock] = _Introduction(self, sock, address[:2])
            except OSError as error:  # the system cannot watch more sockets
                self._warn(error)
                sock.close()

    def _make_room(self, error: OSError) -> None:
        """Free a socket: close the connection that was silent longest, or pause accepting."""
        self._warn(error)
        if self.silent:
            next(iter(self.silent.values())).drop()
            return
        self.loop.unwatch(self._sock)
        self.loop.call_later(_PAUSE, self._resume)

    def _warn(self, error: OSError) -> None:
        if time.monotonic() - self._warned_at >= _WARNING_PERIOD:  # the peers of an open port try again and again
            self._warned_at = time.monotonic()
            _log.warning("cannot accept a connection: %s", error)

    def _resume(self) -> None:
        try:
            self.start()
        except OSError:
            self.loop.call_later(_PAUSE, self._resume)


class _Introduction:
    """A connection whose introduction is being read."""

    def __init__(self, listener: Listener, sock: socket.socket, address: tuple[str, int]) -> None:
        self._listener = listener
        self._sock = sock
        self._address = address
        self._received = bytearray()
        listener.loop.watch(sock, self._read)
        self._timer = listener.loop.call_later(PATIENCE, self.drop)

    def drop(self) -> None:
        self._release()
        self._sock.close()

    def _release(self) -> None:
        self._listener.loop.unwatch(self._sock)
        self._listener.loop.cancel(self._timer)
        self._listener.silent.pop(self._sock, None)

    def _read(self) -> None:
        try:
            data = self._sock.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.drop()  # this is how tools check that a port exists
            return
        self._received += data
        try:
            opened = carriers.parse_opening(self._received)
        except WireError as error:
            with contextlib.suppress(OSError):
                self._sock.send(carriers.PROTOCOL_ERROR)
            self._listener.refused(f"{self._address[0]}:{self._address[1]}", error)
            self.drop()
            return
        if opened is not None:
            self._release()
            with closed_on_failure(self._sock):
                self._listener.opened(self._sock, opened, bytes(self._received[opened.size :]), self._address)
