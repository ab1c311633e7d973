"""Messages are read from a TCPROS connection."""

import contextlib
import socket
import struct
import subprocess
import sys
import threading

import pytest

from bridge.adapters.ros1.connection_loop import ConnectionLoop, is_readable
from bridge.adapters.ros1.topics import connection as module
from bridge.adapters.ros1.topics.connection import PublisherConnection
from bridge.adapters.ros1_peers import DeadlineSocket
from tests.support.wait import until


class Connection:
    """A publisher's end of a connection, and a reader at the other end."""

    def __init__(self, loop, limit=module.MAX_MESSAGE) -> None:
        listener = socket.create_server(("127.0.0.1", 0))
        with listener:
            ours = socket.create_connection(listener.getsockname())
            self.publisher, _ = listener.accept()
        self.messages: list[bytes] = []
        self.refusals: list[tuple[str, str]] = []
        self.trouble = ""
        self.over = threading.Event()
        self.reader = PublisherConnection(
            DeadlineSocket(fileno=ours.detach()),
            "/t",
            "http://x/",
            lambda payload, _source, _time: self.messages.append(payload),
            "the publisher",
            self.ended,
            self.refused,
            limit=limit,
            loop=loop,
        )
        self.reader.start()

    def refused(self, reason: str, why: str) -> None:
        self.refusals.append((reason, why))

    def ended(self, trouble: str) -> None:
        self.trouble = trouble
        self.over.set()

    def finish(self) -> list[bytes]:
        """Return all messages, once the publisher has disconnected."""
        self.publisher.close()
        assert self.over.wait(40)
        return self.messages

    def until_closed(self) -> None:
        until(lambda: self.reader.fileno() == -1, "the reader's socket is closed", 40)


@pytest.fixture
def limit():
    """Size limit of messages in bytes, which a test may override."""
    return module.MAX_MESSAGE


@pytest.fixture(params=[False, True], ids=["alone", "intake"])
def connection(request, limit):
    loop = ConnectionLoop() if request.param else None
    connection = Connection(loop, limit)
    yield connection
    connection.reader.close()
    connection.publisher.close()
    connection.until_closed()
    if loop is not None:
        loop.stop()


def frame(payload):
    return struct.pack("<I", len(payload)) + payload


@pytest.mark.parametrize("reads", ["alone", "intake without a compiler"])
def test_a_message_is_unread_from_its_arrival_to_its_delivery(monkeypatch, reads):
    """A request to cancel all goals, which arrives in between, has to find its client's goal."""
    found: list[bool] = []
    opened: list[Connection] = []

    class Spy(socket.socket):
        def recv(self, count, flags=0) -> bytes:
            data = super().recv(count, flags)
            if data == frame(b"a goal") and not flags & socket.MSG_PEEK:
                found.append(opened[0].reader.unread)
            return data

    monkeypatch.setattr(socket, "socket", Spy)
    monkeypatch.setattr(module, "Stream", None)
    loop = None if reads == "alone" else ConnectionLoop()
    connection = Connection(loop)
    opened.append(connection)
    for number in range(1, 4):
        connection.publisher.sendall(frame(b"a goal"))
        until(lambda number=number: len(connection.messages) == number, "the message is delivered")
        until(lambda: not connection.reader.unread, "nothing is unread")
    connection.finish()
    connection.until_closed()
    if loop is not None:
        loop.stop()
    assert found == [True] * 3


SIZES = [
    [0, 1, 4, 100],
    [5] * 20000,
    [40_000, 3, 40_000, 0, 70_000, 70_000],
    [1_000_000, 1_000_000, 10, 6_000_000, 1],
    [32 * 1024, 32 * 1024 + 1, 64 * 1024 - 4, 64 * 1024],
]


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("piece", [1_000_000_000, 1449, 65537])
def test_messages_arrive_complete_and_in_order(connection, sizes, piece):
    expected = [bytes([n % 251]) * size for n, size in enumerate(sizes)]
    stream = b"".join(frame(m) for m in expected)
    for at in range(0, len(stream), piece):
        connection.publisher.sendall(stream[at : at + piece])
    assert connection.finish() == expected
    assert connection.reader.counts() == (len(stream), len(expected))
    assert "closed" in connection.trouble


def test_messages_that_arrive_byte_by_byte_are_joined(connection):
    connection.publisher.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for byte in frame(b"abc") + frame(b"") + frame(b"d"):
        connection.publisher.sendall(bytes([byte]))
    assert connection.finish() == [b"abc", b"", b"d"]


def test_a_truncated_message_is_not_delivered(connection):
    connection.publisher.sendall(frame(b"whole") + frame(b"x" * 100_000)[:-1])
    assert connection.finish() == [b"whole"]


def test_a_message_that_is_too_long_ends_the_connection(connection, monkeypatch):
    monkeypatch.setattr(module, "MAX_MESSAGE", 1000)
    connection.publisher.sendall(frame(b"a" * 1000) + struct.pack("<I", 1001))
    assert connection.over.wait(40)
    assert connection.messages == [b"a" * 1000]
    assert "1001 bytes" in connection.trouble
    assert connection.refusals == [("bad", connection.trouble)]


@pytest.mark.parametrize("limit", [1000])
@pytest.mark.parametrize("size", [1001, 70_000, 3_000_000])
def test_a_message_over_the_limit_is_skipped(connection, size, limit):
    connection.publisher.sendall(frame(b"before") + frame(b"x" * size) + frame(b"a" * 1000) * 2)
    assert connection.finish() == [b"before", b"a" * 1000, b"a" * 1000]
    assert connection.refusals == [("large", f"message of {size} bytes, limits.message allows 1000")]


def test_an_announced_length_allocates_no_memory():
    """The publisher announces 500 MB, and then sends nothing."""
    code = (
        "import resource, socket, struct\n"
        "from bridge.adapters.ros1_peers import DeadlineSocket\n"
        "from bridge.adapters.ros1.topics.connection import PublisherConnection\n"
        "with socket.create_server(('127.0.0.1', 0)) as listener:\n"
        "    ours = socket.create_connection(listener.getsockname())\n"
        "    publisher, _ = listener.accept()\n"
        "sock = DeadlineSocket(fileno=ours.detach())\n"
        "reader = PublisherConnection(sock, '/t', 'http://x/', print, '', print, print)\n"
        "pages = int(open('/proc/self/statm').read().split()[0])\n"
        "resource.setrlimit(resource.RLIMIT_AS, (pages * 4096 + (64 << 20), resource.RLIM_INFINITY))\n"
        "publisher.sendall(struct.pack('<I', 500 << 20) + b'x')\n"
        "publisher.close()\n"
        "reader._read()\n"
        "print('read')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert done.stdout == "read\n", done.stderr


def test_nothing_is_reported_after_close(connection):
    connection.reader.close()
    if connection.reader.stream is not None:
        connection.reader.stream.direct = True  # as by the loop's thread, which was reading
    with contextlib.suppress(OSError):
        connection.publisher.sendall(frame(b"late"))
    connection.until_closed()
    assert not connection.over.is_set()
    assert connection.messages == []


def test_an_undelivered_message_is_unread(connection):
    """The order between two connections of one publisher depends on this."""
    reader, publisher = connection.reader, connection.publisher
    assert not reader.unread
    publisher.sendall(frame(b"one"))
    until(lambda: connection.messages == [b"one"], "the message is delivered", 40)
    until(lambda: not reader.unread, "nothing is left to read", 40)
    publisher.sendall(frame(b"two")[:5])
    until(lambda: reader.unread and not is_readable(reader._sock), "half a message has been read", 40)
    publisher.sendall(frame(b"two")[5:] + frame(b"x" * 100_000)[:50_000])
    until(lambda: connection.messages == [b"one", b"two"], "the other half has arrived", 40)
    until(lambda: reader.unread and not is_readable(reader._sock), "half of a large message has been read", 40)
    publisher.sendall(frame(b"x" * 100_000)[50_000:])
    until(lambda: len(connection.messages) == 3, "the message is delivered", 40)
    until(lambda: not reader.unread, "nothing is left to read", 40)
    reader.close()
    assert not reader.unread


def test_a_reader_that_has_not_been_started_has_unread_messages():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        ours = socket.create_connection(listener.getsockname())
        sock = DeadlineSocket(fileno=ours.detach())
        reader = PublisherConnection(sock, "/t", "http://x/", print, "", str, lambda *_: None)
        assert reader.unread
        reader.close()
