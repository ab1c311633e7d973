"""Messages off a TCPROS connection."""

import contextlib
import socket
import struct
import threading

import pytest

from bridge.adapters.ros1 import reader as module
from bridge.adapters.ros1.deadline import DeadlineSocket
from bridge.adapters.ros1.reader import Reader


class Connection:
    """A publisher's end, and a reader at the other one."""

    def __init__(self) -> None:
        listener = socket.create_server(("127.0.0.1", 0))
        with listener:
            ours = socket.create_connection(listener.getsockname())
            self.publisher, _ = listener.accept()
        self.messages: list[bytes] = []
        self.trouble = ""
        self.over = threading.Event()
        self.reader = Reader(DeadlineSocket(fileno=ours.detach()), "/t", "http://x/", self.messages.append, self.ended)
        self.reader.start()

    def ended(self, trouble: str) -> None:
        self.trouble = trouble
        self.over.set()

    def finish(self) -> list[bytes]:
        """All messages, once the publisher has gone."""
        self.publisher.close()
        assert self.over.wait(10)
        return self.messages


@pytest.fixture
def connection():
    made = Connection()
    yield made
    made.reader.close()
    made.publisher.close()
    made.reader._thread.join(10)


def frame(payload):
    return struct.pack("<I", len(payload)) + payload


SIZES = [
    [0, 1, 4, 100],
    [5] * 20000,
    [40_000, 3, 40_000, 0, 70_000, 70_000],
    [1_000_000, 1_000_000, 10, 6_000_000, 1],
    [32 * 1024, 32 * 1024 + 1, 64 * 1024 - 4, 64 * 1024],
]


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("piece", [1_000_000_000, 1449, 65537])
def test_whole_messages_in_order(connection, sizes, piece):
    expected = [bytes([n % 251]) * size for n, size in enumerate(sizes)]
    stream = b"".join(frame(m) for m in expected)
    for at in range(0, len(stream), piece):
        connection.publisher.sendall(stream[at : at + piece])
    assert connection.finish() == expected
    assert connection.reader.stat_num_msg == len(expected)
    assert connection.reader.stat_bytes == len(stream)
    assert "closed" in connection.trouble


def test_byte_by_byte(connection):
    connection.publisher.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for byte in frame(b"abc") + frame(b"") + frame(b"d"):
        connection.publisher.sendall(bytes([byte]))
    assert connection.finish() == [b"abc", b"", b"d"]


def test_a_message_cut_short_is_not_delivered(connection):
    connection.publisher.sendall(frame(b"whole") + frame(b"x" * 100_000)[:-1])
    assert connection.finish() == [b"whole"]


def test_a_message_that_is_too_long_ends_the_connection(connection, monkeypatch):
    monkeypatch.setattr(module, "MAX_MESSAGE", 1000)
    connection.publisher.sendall(frame(b"a" * 1000) + struct.pack("<I", 1001))
    assert connection.over.wait(10)
    assert connection.messages == [b"a" * 1000]
    assert "1001 bytes" in connection.trouble


def test_nothing_is_told_after_close(connection):
    connection.reader.close()
    with contextlib.suppress(OSError):
        connection.publisher.sendall(frame(b"late"))
    connection.reader._thread.join(10)
    assert not connection.over.is_set()
    assert connection.messages == []
