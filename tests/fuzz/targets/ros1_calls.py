"""ROS 1 services: requests from clients to Midspan's server, and replies to Midspan's client."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from types import SimpleNamespace
from typing import Any

from bridge.hub.endpoints.calls import CallError
from tests.fuzz.target import Subject, Target

_LIMIT = 80_000
_SIZES = [struct.pack("<I", n) for n in (0, 1, 5, 65_536, 65_537, _LIMIT, _LIMIT + 1, 2**31, 2**32 - 1)]


class _Plain(socket.socket):
    """One end of a socket pair, on which TCP options are ignored."""

    def setsockopt(self, *_: Any) -> None:
        pass


class _Loop:
    """Stands in for the thread that reads all connections; here, the target reads one connection."""

    def __init__(self) -> None:
        self.reads = threading.Event()
        self.over = threading.Event()

    def add(self, _connection: Any) -> bool:
        self.reads.set()
        return True

    def remove(self, _connection: Any) -> None:
        self.reads.clear()

    def listen(self, connection: Any, *, data: bool) -> None:
        connection.listens = data
        if data and connection.paused:
            connection.paused = False
            self.reads.set()

    def pause(self, connection: Any) -> None:
        connection.paused = not connection.listens
        if connection.paused:
            self.reads.clear()


def _drive(connection: Any, loop: _Loop, peer: socket.socket) -> bytes:
    """Read a connection to its end, like the shared thread, and return what the peer receives meanwhile.

    A separate thread may read large messages. The peer must receive, because a send to a full socket would block
    forever.
    """
    received = bytearray()
    connection.start()
    while not loop.over.is_set():
        if loop.reads.wait(0.001) and not loop.over.is_set():
            connection.ready()
        with contextlib.suppress(BlockingIOError, ConnectionResetError):
            received += peer.recv(1 << 20, socket.MSG_DONTWAIT)
    with contextlib.suppress(ConnectionResetError):  # the connection was closed with unread data
        while data := peer.recv(1 << 20):
            received += data
    return bytes(received)


def _connection(data: bytes) -> tuple[socket.socket, socket.socket]:
    """Return a connection on which a peer has sent these bytes and then closed, and the peer's socket."""
    ours, theirs = socket.socketpair()
    theirs.sendall(data)
    theirs.shutdown(socket.SHUT_WR)
    return _Plain(fileno=ours.detach()), theirs


def _frame(body: bytes, head: bytes = b"") -> bytes:
    return head + struct.pack("<I", len(body)) + body


def _requests() -> Subject:
    """A client's requests on a persistent connection; each is answered before the next is read."""
    from bridge.adapters.ros1.services.server import Traffic, _ClientConnection

    def parse(data: bytes) -> None:
        requests: list[bytes] = []

        def call(request: bytes, done: Any) -> Any:
            requests.append(request)
            done(b"ok" if _succeeds(request) else CallError("no"))
            return lambda: None

        loop = _Loop()
        server = SimpleNamespace(
            is_open=True,
            call=call,
            name="/s",
            closed_reason="",
            traffic=Traffic(),
            remove=lambda _client: loop.over.set(),
        )
        ours, theirs = _connection(data)
        with theirs:
            connection = _ClientConnection(ours, server, loop, _LIMIT, persistent=True)  # type: ignore[arg-type]
            replies = _drive(connection, loop, theirs)
        if all(size <= _LIMIT for size in _announced(data)):
            assert data.startswith(b"".join(map(_frame, requests)))
            assert b"".join(map(_reply, requests)).startswith(replies)

    seeds = [_frame(b"\1") * 3, _frame(b""), _frame(bytes(5000)) + _frame(b"x"), _frame(bytes(66_000))]
    return Subject(parse, seeds, (), _SIZES)


def _succeeds(request: bytes) -> bool:
    return len(request) % 2 == 1


def _reply(request: bytes) -> bytes:
    return _frame(b"ok", b"\1") if _succeeds(request) else _frame(b"no", b"\0")


def _announced(data: bytes) -> list[int]:
    """Return the lengths of the frames that are read, including those above the limit."""
    sizes, at = [], 0
    while at + 4 <= len(data):
        (size,) = struct.unpack_from("<I", data, at)
        sizes.append(size)
        at += 4 + size
    return sizes


def _replies() -> Subject:
    """A server's reply to a request; the call ends exactly once."""
    from bridge.adapters.ros1.services.caller import _Pending, _ServerConnection

    def parse(data: bytes) -> None:
        ends: list[bytes | CallError] = []
        loop = _Loop()
        owner = SimpleNamespace(freed=lambda _line, **_: None, lost=lambda _line, _trouble: loop.over.set())
        ours, theirs = _connection(data)
        with theirs:
            line = _ServerConnection(ours, SimpleNamespace(node="/server"), owner, loop, _LIMIT)  # type: ignore[arg-type]
            line.begin(_Pending(b"request", ends.append, lambda _pending: None))
            _drive(line, loop, theirs)
        (end,) = ends
        whole = len(data) >= 5 and 5 + (size := struct.unpack_from("<I", data, 1)[0]) <= len(data) and size <= _LIMIT
        assert isinstance(end, bytes) == bool(whole and data[0])
        assert not isinstance(end, bytes) or end == data[5 : 5 + size]

    seeds = [
        _frame(b"yes", b"\1"),
        _frame(b"the arm is stuck", b"\0"),
        _frame(b"", b"\1") + b"more",
        _frame(bytes(66_000), b"\1"),
    ]
    return Subject(parse, seeds, (), _SIZES)


TARGETS = (
    Target("ros1_requests", 3_000, _requests),
    Target("ros1_replies", 4_000, _replies),
)
