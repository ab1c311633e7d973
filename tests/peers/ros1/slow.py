"""Subscribers of a publication whose systems accept few bytes, until they read."""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import threading
from collections.abc import Callable, Iterator

from bridge.adapters.ros1.connection_loop import ConnectionLoop, is_readable
from bridge.adapters.ros1.topics.outlet import SubscriberConnection
from bridge.adapters.ros1.topics.outputs import Outputs, Socket
from bridge.adapters.ros1.topics.publication import Publication
from bridge.adapters.ros1_peers import DeadlineSocket
from bridge.concurrency import DelayedCalls
from bridge.messages.registry import Registry
from bridge.routing.exit import Exit
from tests.peers.native import exit_to, pass_on
from tests.support.wait import until

TOPIC = "/talk"
_TYPE = Registry().ros1("std_msgs/String")


def frame(payload: bytes) -> bytes:
    """Return a message as a ROS 1 subscriber receives it."""
    return struct.pack("<I", len(payload)) + payload


class Listener:
    """A subscriber's socket. A slow one accepts only a few kB until it reads."""

    def __init__(self, *, slow: bool = False) -> None:
        with socket.socket() as server:
            if slow:
                server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
            server.bind(("127.0.0.1", 0))
            server.listen()
            self.theirs = socket.create_connection(server.getsockname())
            self.sock, _ = server.accept()
        if slow:
            self.theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
        self.sock.settimeout(40)
        self.data = bytearray()

    def read(self, count: int) -> bytes:
        """Read and return ``count`` bytes."""
        data = b""
        while len(data) < count:
            part = self.sock.recv(count - len(data))
            assert part, "the connection was closed"
            data += part
        return data

    def message(self) -> bytes:
        """Read and return one message or header."""
        (length,) = struct.unpack("<I", self.read(4))
        return self.read(length)

    def is_silent(self) -> bool:
        """Return whether nothing has arrived."""
        return not is_readable(self.sock)

    def close(self) -> None:
        self.theirs.close()
        self.sock.close()


class Talker:
    """A publication of strings with its subscribers, and an exit that sends to it in C."""

    def __init__(self) -> None:
        self.changes = 0
        self.loop, self.later = ConnectionLoop("test-talker"), DelayedCalls("test-later")
        self.publication = Publication(TOPIC, _TYPE, lambda: "/midspan", "", self.loop, self._changed, self.later)
        self.listeners: list[Listener] = []
        assert self.publication.outputs is not None
        self.outputs: Outputs = self.publication.outputs
        self.exit: Exit = exit_to(self.outputs)

    def _changed(self) -> None:
        self.changes += 1

    def listen(self, *, slow: bool = False) -> tuple[Listener, SubscriberConnection]:
        """Add a subscriber that has read the header; return it and its connection."""
        listener = Listener(slow=slow)
        self.admit(listener)
        listener.message()
        return listener, self.publication.connections[-1]

    def admit(self, listener: Listener) -> None:
        """Add a subscriber."""
        self.listeners.append(listener)
        self.publication.admit(DeadlineSocket.adopt(listener.theirs, math.inf), f"/listener{len(self.listeners)}")

    def send(self, payload: bytes) -> bool:
        """Send by C; return False if it leaves the message to Python."""
        return pass_on(self.exit, payload)

    def send_by_python(self, payload: bytes, depth: int = 100_000) -> None:
        self.publication.send(payload, "source", depth, retain=False)

    def send_as_a_route(self, payload: bytes) -> bool:
        """Send by C if possible, else by Python; return whether it was C."""
        by_c = self.send(payload)
        if not by_c:
            self.send_by_python(payload)
        return by_c

    def threads(self) -> list[threading.Thread]:
        """Return the threads that write to slow subscribers."""
        return [thread for thread in threading.enumerate() if thread.name == f"midspan-ros1-out{TOPIC}"]

    def close(self) -> None:
        self.publication.close()
        self.loop.stop()
        self.later.close()
        for listener in self.listeners:
            listener.sock.close()
        for thread in self.threads():
            thread.join(40)


def c_socket(connection: SubscriberConnection) -> Socket:
    """Return the part of a connection that sends in C."""
    assert connection.socket is not None
    return connection.socket


def cut(talker: Talker, connection: SubscriberConnection, payload: Callable[[int], bytes]) -> list[bytes]:
    """Send messages in C until one does not fit into the connection's socket; return them all."""
    sent: list[bytes] = []
    while c_socket(connection).free:
        sent.append(payload(len(sent)))
        assert talker.send(sent[-1])
        assert len(sent) < 10_000, "the socket accepts everything"
    return sent


@contextlib.contextmanager
def full_socket() -> Iterator[socket.socket]:
    """Yield a socket that accepts nothing more. TCP would accept more when the other end's system has acknowledged."""
    near, far = socket.socketpair()
    with near, far:
        with contextlib.suppress(BlockingIOError):
            while True:
                near.send(b"x", socket.MSG_DONTWAIT)
        yield near


def until_free(connection: SubscriberConnection) -> None:
    until(lambda: c_socket(connection).free, "nothing waits for the subscriber")
