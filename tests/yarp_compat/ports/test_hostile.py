"""Peers that vanish, are silent, or send garbage affect only their own connection."""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import threading
import time
from collections.abc import Iterator

import psutil
import pytest

from tests.support.no_threads import no_threads
from tests.support.wait import until
from tests.yarp_compat.ports.conftest import MakePort
from yarp_compat.ports import connecting, connections, datagrams, listener
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.port import PortCore
from yarp_compat.wire import framing
from yarp_compat.wire.binary import encode
from yarp_compat.wire.carriers import PROTOCOL_ERROR, framed
from yarp_compat.wire.profile import Profile

HELLO = encode(["hello"], Profile.YARP3)
TCP, FAST_TCP = b"YA\xe4\x1e\0\0RP", b"YAd\x1e\0\0RP"
WRITER = b"\x03\0\0\0/x\0"


def call(port: PortCore, *data: bytes) -> socket.socket:
    sock = socket.create_connection((port.contact.host, port.contact.port), 10)
    sock.settimeout(10)
    for part in data:
        with contextlib.suppress(OSError):
            sock.sendall(part)
    return sock


def receive_all(sock: socket.socket) -> bytes:
    """Return all bytes until the port closes the connection."""
    received = b""
    with contextlib.suppress(ConnectionError):
        while part := sock.recv(65536):
            received += part
    sock.close()
    return received


def yarp_threads() -> int:
    """Return the number of threads of ports; threads of earlier tests may still start or end."""
    return sum(thread.name.startswith("yarp") for thread in threading.enumerate())


class Works:
    """A port, and a check that it still serves a valid peer."""

    def __init__(self, make_port: MakePort) -> None:
        self.port = make_port("/r", lambda m: m.reply(m.payload), limit=1 << 20)
        self._client = make_port("/client")
        assert self._client.add_output("/r")[0]
        self.check()

    def check(self) -> None:
        assert self._client.request(HELLO, timeout=20) == HELLO


@pytest.fixture
def works(make_port: MakePort) -> Iterator[Works]:
    port = Works(make_port)
    yield port
    port.check()


@pytest.mark.parametrize(
    "data",
    [
        b"YAb\x1e\0\0RP\x03\0\0\0/w\0\x7f\0\0\1\x27\x17",  # mcast without a group
        b"YAb\x1e\0\0RP\x03\0\0\0/w\0\xe0\1\1\3\0\0",  # mcast without a port
        b"YAo\x1e\0\0RP\x03\0\0\0/w\0",  # shmem
        b"\x16\x03\x01\x02\0\1\0\1",  # TLS
        b"SSH-2.0-OpenSSH\r\n",
        bytes(8),
        b"\xff" * 8,
        b"PRI * HT",
    ],
)
def test_unsupported_carriers_are_refused(works: Works, data: bytes) -> None:
    assert receive_all(call(works.port, data)) == PROTOCOL_ERROR
    until(lambda: works.port.counters.dropped["malformed"] == 1, "the drop is counted")


@pytest.mark.parametrize(
    "data",
    [
        TCP + b"\0\0\0\0",
        TCP + b"\xff\xff\xff\xff",
        TCP + b"\xff\xff\xff\x7f",
        TCP + b"\x03\0\0\0\xff\xfe\0",
        TCP + b"\x04\0\0\0/\n\r\0",
        b"CONNECT \xff\xff\r\n",
        b"CONNECT " + b"a" * 3000,
    ],
)
def test_invalid_names_are_refused(works: Works, data: bytes) -> None:
    assert receive_all(call(works.port, data)).endswith(PROTOCOL_ERROR)


@pytest.mark.parametrize(
    "data",
    [
        b"garbage that is no index at all.....",
        b"YA\x0a\0\0\0RP\xff\xff" + b"\xff" * 8 + b"\xff\xff\xff\x7f" * 510,
        b"YA\x0a\0\0\0RP\2\1" + b"\xff" * 8 + struct.pack("<iii", 8, -5, 0),
        b"YA\x0a\0\0\0RP\2\1" + b"\xff" * 8 + struct.pack("<iii", 8, (1 << 20) + 1, 0) + b"\0\0\0\0~D\0\1",
        b"YA\x0a\0\0\0RP\0\0" + b"\xff" * 8,
        b"YA\x0a\0\0\0RP\1\1" + b"\xff" * 8 + struct.pack("<ii", 4, 0) + b"abcd",
        b"YA\x0a\0\0\0RP\1\1" + b"\xff" * 8 + struct.pack("<ii", 12, 0) + b"\x04\0\0\0~\0\0\1abcd",
        b"YA\x0b\0\0\0RP\2\1" + b"\xff" * 20,
    ],
)
@pytest.mark.parametrize("carrier", [TCP, FAST_TCP])
def test_invalid_messages_close_the_connection(works: Works, carrier: bytes, data: bytes) -> None:
    answer = receive_all(call(works.port, carrier + WRITER, data))
    assert framed(answer) is not None, "the introduction was answered"
    reason = "large" if struct.pack("<i", (1 << 20) + 1) in data or b"\xff\x7f" in data else "malformed"
    until(lambda: works.port.counters.dropped[reason] == 1, "the drop is counted")
    until(lambda: len(works.port.inputs()) == 1, "the connection is closed")


def test_announced_size_reserves_no_memory(make_port: MakePort) -> None:
    """Fifty peers announce 64 MB each, and send none of these bytes."""
    port = make_port("/r")
    before = psutil.Process().memory_info().rss
    index = b"YA\x0a\0\0\0RP\2\1" + b"\xff" * 8 + struct.pack("<iii", 8, 64 << 20, 0) + b"\0\0\0\0~D\0\1"
    socks = [call(port, FAST_TCP + b"\x06\0\0\0anon%d\0" % (n % 10), index) for n in range(50)]
    until(lambda: len(port.inputs()) == 50, "all peers are connected")
    until(
        lambda: sum(t.name.startswith("yarp anon") for t in threading.enumerate()) == 50,
        "all connections have a reading thread",
    )
    time.sleep(0.2)
    assert psutil.Process().memory_info().rss - before < 120 << 20
    for sock in socks:
        sock.close()
    until(lambda: not port.inputs(), "all connections are closed")


def test_text_without_a_line_end_closes_the_connection(works: Works) -> None:
    sock = call(works.port, b"CONNACK x\r\n")
    assert sock.recv(100) == b"Welcome x\r\n"
    with contextlib.suppress(OSError):
        for _ in range(40):
            sock.sendall(b"a" * 65536)
    assert receive_all(sock) == b""


def test_a_long_line_of_data_closes_the_connection(works: Works) -> None:
    sock = call(works.port, b"CONNACK x\r\nd\r\n")
    with contextlib.suppress(OSError):
        for _ in range(40):
            sock.sendall(b"a" * 65536)
    assert receive_all(sock) in (b"Welcome x\r\n", b"")


@pytest.mark.parametrize("depth", [300, 1_000_000 // 8])
def test_deeply_nested_lists_are_harmless(works: Works, depth: int) -> None:
    """The lists arrive as a message in text, and as administrative commands in text and in binary."""
    text = b"(" * depth
    receive_all(call(works.port, b"CONNACK x\r\nd\r\n" + text + b"\r\nq\r\n"))
    works.check()
    receive_all(call(works.port, b"CONNACK x\r\na\r\n" + text + b"\r\nq\r\n"))
    works.check()
    nested = struct.pack("<ii", 256, 1) * depth
    answer = receive_all(call(works.port, TCP + WRITER, framing.prefix(len(nested), "a") + nested, framing.QUIT))
    assert b"send [help]" in answer


def test_a_thousand_silent_connections_do_not_block_a_valid_peer(make_port: MakePort) -> None:
    """Silent connections do not block a valid peer; the oldest are closed, and none has a thread."""
    works = Works(make_port)
    silent = []
    threads = yarp_threads()
    for _ in range(1000):
        with contextlib.suppress(OSError):
            silent.append(call(works.port))
    other = make_port("/other")
    start = time.monotonic()
    assert other.add_output("/r")[0]
    assert other.request(HELLO, timeout=20) == HELLO
    assert time.monotonic() - start < 15
    assert yarp_threads() <= threads + 2
    assert len(silent) > listener.MOST_SILENT
    closed = 0
    for sock in silent:
        sock.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            closed += sock.recv(1) == b""
        sock.close()
    assert closed >= len(silent) - listener.MOST_SILENT
    works.check()


def test_introduced_peers_that_are_silent_have_no_thread(make_port: MakePort, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "MOST_INPUTS", 50)
    works = Works(make_port)
    threads = yarp_threads()
    silent = [call(works.port, FAST_TCP + b"\x04\0\0\0%03d\0" % n) for n in range(200)]
    until(lambda: len(works.port.inputs()) == 50, "at most fifty connections stay open")
    assert yarp_threads() <= threads + 2, "no silent connection has a thread"
    works.check()
    assert make_port("/other").add_output("/r")[0]
    for sock in silent:
        sock.close()


def test_introductions_have_a_time_limit(make_port: MakePort, monkeypatch: pytest.MonkeyPatch) -> None:
    works = Works(make_port)
    monkeypatch.setattr(listener, "PATIENCE", 0.2)
    assert receive_all(call(works.port, TCP)) == b""
    works.check()


def test_tools_check_that_a_port_exists(works: Works) -> None:
    for _ in range(20):
        call(works.port).close()
    works.check()
    assert works.port.counters.dropped.total() == 0


def test_connections_changed_at_random_leave_the_port_working(works: Works) -> None:
    """Beginnings of real connections, changed at random."""
    chance = random.Random(7)
    payload = encode(["a", 1, [2.5, b"x"]], Profile.YARP3)
    real = [
        TCP + WRITER + framing.prefix(len(payload), "d") + payload + framing.QUIT,
        TCP + WRITER + framing.prefix(len(payload), "a") + payload + framing.QUIT,
        b"CONNACK x\r\nd\r\nhello (1 2)\r\na\r\n[list] [in]\r\n*\r\n?\r\nq\r\n",
        b"CONNECT x\r\nD 1 2.5\r\nhello\r\n~/y\r\n!/z\r\nq\r\n",
        b"NAME_SERVER query /x\r\nNAME_SERVER list\r\n",
        b"GET /?data=hello+1&format=json HTTP/1.1\r\nHost: x\r\n\r\n",
        b"POST /form HTTP/1.1\r\nContent-Length: 10\r\n\r\ndata=hello",
    ]
    for _ in range(300):
        data = bytearray(chance.choice(real))
        for _ in range(chance.randrange(1, 6)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        sock = call(works.port, bytes(data[: chance.randrange(1, len(data) + 1)]))
        sock.shutdown(socket.SHUT_WR)
        sock.close()
    works.check()
    until(lambda: len(works.port.inputs()) == 1, "all changed connections are closed")


def test_datagrams_from_other_senders_and_garbage_are_dropped(make_port: MakePort) -> None:
    got: list[bytes] = []
    port = make_port("/r", lambda m: got.append(bytes(m.payload)))
    writer = make_port("/w")
    writer.add_output("udp://r")
    until(port.inputs, "the port is connected")
    address = port.connections.inputs[0].sock.getsockname()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for garbage in (b"", b"a", bytes(8), bytes(100), b"\xff" * 1000):
            sock.sendto(garbage, address)
        writer.write(HELLO)
        until(lambda: got == [HELLO], "the message has arrived")
    assert port.connections.inputs[0].counters.dropped["checksum"] >= 3


def test_slow_owner_delays_only_its_writer(make_port: MakePort) -> None:
    """Another connection to the same port and administrative commands are served meanwhile."""
    free = threading.Event()

    def on_message(incoming: PortMessage) -> None:
        if incoming.peer.route.source == "/slow":
            free.wait(20)
        incoming.reply(HELLO)

    port = make_port("/r", on_message)
    slow, quick = make_port("/slow"), make_port("/quick")
    slow.add_output("/r")
    quick.add_output("/r")
    slow.write(HELLO)
    assert quick.request(HELLO, timeout=10) == HELLO
    assert b"[ver] 1 2 3" in receive_all(call(port, b"CONNACK admin\r\na\r\n[ver]\r\nq\r\n"))
    free.set()


def test_a_thousand_connections_leak_nothing(make_port: MakePort) -> None:
    """The numbers of threads, sockets and connections do not grow."""
    got: list[int] = []
    reader = make_port("/r", lambda _: got.append(1))
    writer = make_port("/w")
    process = psutil.Process()

    def cycle(carrier: str) -> None:
        assert writer.add_output(f"{carrier}://r")[0]
        assert writer.write(HELLO, wait=True, timeout=10) == 1
        assert writer.remove_output("/r")[0]

    for carrier in ("tcp", "fast_tcp", "udp", "text", "text_ack", "local"):
        cycle(carrier)
    until(lambda: not reader.inputs() and not reader.connections.leaving, "the first connections have ended")
    # may include those of the first connections, which are still ending
    files, threads = process.num_fds(), yarp_threads()
    got.clear()
    for i in range(1000):
        cycle(("tcp", "fast_tcp", "text_ack", "local")[i % 4])
    until(lambda: not reader.inputs() and not writer.outputs(), "all connections are closed")
    until(lambda: not reader.connections.leaving, "all connections have delivered their messages")
    until(lambda: process.num_fds() <= files and yarp_threads() <= threads, "nothing is leaked", 20)
    assert len(got) == 1000


def test_the_datagram_socket_of_a_peer_that_left_is_closed(
    make_port: MakePort, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The peer leaves before it has received the number of the port for its datagrams."""
    made: list[socket.socket] = []

    def datagram_socket(like: socket.socket) -> socket.socket:
        made.append(datagrams.datagram_socket(like))
        like.shutdown(socket.SHUT_RDWR)
        return made[-1]

    monkeypatch.setattr(connecting, "datagram_socket", datagram_socket)
    works = Works(make_port)
    assert not make_port("/w").add_output("udp://r")[0]
    until(lambda: [sock.fileno() for sock in made] == [-1], "the datagram socket is closed", 10)
    works.check()


def test_a_peer_is_disconnected_if_no_thread_can_read_it(make_port: MakePort) -> None:
    works = Works(make_port)
    with no_threads("yarp /x > /r"):
        assert not receive_all(call(works.port, TCP, WRITER, HELLO)).endswith(HELLO)
    until(lambda: not any(i.route.source == "/x" for i in works.port.connections.inputs), "the connection is removed")
    works.check()


def test_a_peer_whose_introduction_fails_unexpectedly_is_disconnected(
    make_port: MakePort, monkeypatch: pytest.MonkeyPatch
) -> None:
    works = Works(make_port)

    def fail(*_: object) -> None:
        raise RuntimeError("broken")

    listening = works.port._listener
    assert listening is not None
    with monkeypatch.context() as failures:
        failures.setattr(listening, "opened", fail)
        assert receive_all(call(works.port, TCP, WRITER)) == b""
    works.check()
