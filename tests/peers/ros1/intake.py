"""An intake with publishers on socket pairs."""

from __future__ import annotations

import select
import socket
import struct
from collections.abc import Callable

from bridge.adapters.ros1.intake import Intake, Stream

LIMIT = 1000
"""Maximum size in bytes of a message that a stream delivers."""


def frame(payload: bytes) -> bytes:
    """Return a message as a ROS 1 publisher sends it."""
    return struct.pack("<I", len(payload)) + payload


class StreamPublisher:
    """A publisher's socket, and the stream of its messages."""

    def __init__(self, desk: Desk, deliver: Callable[[bytes], object] | None) -> None:
        self.received: list[bytes] = []
        self.sock, self.ours = socket.socketpair()
        self._deliver = deliver or self.received.append
        self.stream = Stream(lambda payload, _source, _time: self._deliver(payload), "", LIMIT)
        self.number = self.ours.fileno()
        desk.epoll.register(self.number, select.EPOLLIN)
        desk.intake.add(self.number, self.stream)

    def send(self, *payloads: bytes) -> None:
        self.sock.sendall(b"".join(map(frame, payloads)))

    def take(self) -> bytes:
        """Return what is left to Python, first what the stream has received."""
        return self.stream.take() or self.ours.recv(1 << 20, socket.MSG_DONTWAIT)


class Desk:
    """An intake with its publishers; ``flushed`` counts the calls before a wait."""

    def __init__(self) -> None:
        self.epoll = select.epoll()
        self.flushed = 0
        self.intake = Intake(self.epoll.fileno(), self.flush)
        self.publishers: list[StreamPublisher] = []

    def flush(self) -> None:
        self.flushed += 1

    def publisher(self, deliver: Callable[[bytes], object] | None = None) -> StreamPublisher:
        self.publishers.append(StreamPublisher(self, deliver))
        return self.publishers[-1]

    def close(self) -> None:
        for publisher in self.publishers:
            publisher.sock.close()
            publisher.ours.close()
        self.epoll.close()
