"""Silent, slow and hostile peers do not prevent the TCPROS server from admitting others."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
import threading
import time
from collections.abc import Iterator, Mapping

import pytest

from bridge.adapters.ros1 import connection_loop
from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.handshake import MAX_HEADER, encode, read_header
from bridge.adapters.ros1.node import greeting
from bridge.adapters.ros1.node.greeting import TcprosServer
from bridge.adapters.ros1_peers import DeadlineSocket, Ros1ProtocolError
from bridge.concurrency import DelayedCalls
from tests.support.no_threads import no_threads
from tests.support.wait import until


class Bench:
    """A server that replies with the received header, and rejects peers whose header has the field ``reject``."""

    def __init__(self) -> None:
        self.loop, self.timer = ConnectionLoop("test-greet"), DelayedCalls("test-later")
        self.server = TcprosServer(socket.create_server(("127.0.0.1", 0)), self.loop, self.timer, self.admit)
        self.peers = contextlib.ExitStack()

    def admit(self, sock: DeadlineSocket, header: Mapping[str, str]) -> str:
        if "reject" in header:
            return header["reject"]
        if "fail" in header:
            raise RuntimeError(header["fail"])
        self.peers.enter_context(sock)  # stored before the reply, because the test may end after it
        sock.sendall(encode(header))
        return ""

    def connect(self, data: bytes = b"") -> DeadlineSocket:
        plain = socket.create_connection(("127.0.0.1", self.server.port), 20)
        sock = self.peers.enter_context(DeadlineSocket(fileno=plain.detach()))
        sock.deadline = time.monotonic() + 20
        sock.sendall(data)
        return sock

    def greet(self, **fields: str) -> dict[str, str]:
        return read_header(self.connect(encode(fields)))

    def close(self) -> None:
        self.server.close()
        self.loop.stop()
        self.timer.close()
        self.peers.close()


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(greeting, "_SECONDS", 60.0)  # peers that wait for others must not expire on a busy machine
    bench = Bench()
    yield bench
    bench.close()


def test_a_peer_is_admitted_with_its_header(bench: Bench) -> None:
    assert bench.greet(topic="/a", md5sum="*") == {"topic": "/a", "md5sum": "*"}


def test_bytes_after_the_header_stay_in_the_socket(bench: Bench) -> None:
    received = []

    def admit(sock: DeadlineSocket, _header: Mapping[str, str]) -> str:
        received.append(sock.recv(100))
        return "enough"

    bench.server._admit = admit
    assert read_header(bench.connect(encode({"service": "/s"}) + b"request")) == {"error": "enough"}
    assert received == [b"request"]


def test_a_header_may_arrive_byte_by_byte(bench: Bench) -> None:
    sock = bench.connect()
    for byte in encode({"topic": "/slow"}):
        sock.sendall(bytes([byte]))
    assert read_header(sock) == {"topic": "/slow"}


def test_the_reason_of_a_rejection_is_sent(bench: Bench) -> None:
    assert bench.greet(reject="not here") == {"error": "not here"}


@pytest.mark.parametrize("failing", ["keep_alive", "after"])
def test_a_connection_that_fails_at_once_leaves_the_listener_open(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    """On macOS, a socket's options cannot be set once its peer has reset the connection."""
    error = OSError(errno.EINVAL, "Invalid argument") if failing == "keep_alive" else RuntimeError("no new thread")

    def fail(*_: object) -> None:
        raise error

    with monkeypatch.context() as failures:
        failures.setattr(connection_loop if failing == "keep_alive" else bench.timer, failing, fail)
        assert bench.connect().recv(1) == b""
    assert bench.greet(topic="/a") == {"topic": "/a"}


def test_keep_alive_ignores_a_disconnected_socket() -> None:
    sock = socket.socket()
    sock.close()
    connection_loop.keep_alive(sock)
    assert sock.fileno() == -1, "the socket is closed, so its options cannot be set"


def test_an_exception_closes_only_its_connection(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(Ros1ProtocolError, match="closed the connection"):
        bench.greet(fail="broken")
    assert "could not be admitted" in caplog.text
    assert bench.greet(topic="/a") == {"topic": "/a"}


@pytest.mark.parametrize(
    "data", [struct.pack("<I", MAX_HEADER), b"\xff" * 8, struct.pack("<II", 8, 100) + b"abcd"], ids=str
)
def test_a_malformed_header_closes_the_connection(bench: Bench, data: bytes) -> None:
    sock = bench.connect(data)
    with contextlib.suppress(ConnectionResetError):
        assert sock.recv(1) == b""
    assert bench.greet(topic="/a") == {"topic": "/a"}


def test_500_silent_clients_cost_no_thread_and_delay_no_other_client(bench: Bench) -> None:
    before = threading.active_count()
    silent = [bench.connect(b"\x10\0\0\0half"[: n % 9]) for n in range(500)]
    until(lambda: len(bench.server._open) == 500, "all peers are connected")
    assert bench.greet(topic="/a") == {"topic": "/a"}
    assert threading.active_count() <= before + 3, "only the loop, the timer and one admitting thread run"
    for sock in silent:
        sock.close()
    until(lambda: not bench.server._open, "the disconnections are noticed")
    until(lambda: bench.server._bytes == 0, "the bytes of the last connection are counted out")


def test_500_clients_at_once_are_all_admitted(bench: Bench) -> None:
    clients = [bench.connect(encode({"topic": f"/{n}"})) for n in range(500)]
    assert [read_header(sock)["topic"] for sock in clients] == [f"/{n}" for n in range(500)]


def test_a_silent_client_is_disconnected(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(greeting, "_SECONDS", 0.05)
    assert bench.connect(b"\x10\0\0\0half").recv(1) == b""
    until(lambda: not bench.server._open, "the peer is removed")


def test_a_header_that_arrived_in_time_may_be_read_late(bench: Bench) -> None:
    """After a suspension of this process the timer may run first; rospy never retries a connection without a header."""
    peer = bench.connect()
    (opened,) = until(lambda: list(bench.server._open), "the connection is accepted")
    busy, free = threading.Event(), threading.Event()

    def block() -> None:
        busy.set()
        free.wait(60)

    bench.loop.call_soon(block)
    assert busy.wait(60)
    peer.sendall(encode({"topic": "/a"}))
    until(lambda: connection_loop.is_readable(opened._sock), "the header arrives")
    opened.expire()
    free.set()
    assert read_header(peer) == {"topic": "/a"}


def test_further_silent_clients_are_rejected(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(greeting, "_MAX_OPEN", 3)
    kept = [bench.connect() for _ in range(3)]
    until(lambda: len(bench.server._open) == 3, "the peers are connected")
    assert bench.connect().recv(1) == b""
    kept[0].close()
    until(lambda: len(bench.server._open) == 2, "one peer has left")
    assert bench.greet(topic="/a") == {"topic": "/a"}


def test_the_bytes_of_all_incomplete_headers_are_limited(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(greeting, "_MAX_BYTES", 100_000)
    part = struct.pack("<I", 500_000) + bytes(90_000)
    bench.connect(part)
    until(lambda: bench.server._bytes == len(part), "the first part is received")
    with contextlib.suppress(ConnectionResetError):
        assert bench.connect(part).recv(1) == b""
    until(lambda: bench.server._bytes == len(part), "the second connection's bytes are dropped")
    assert bench.greet(topic="/a") == {"topic": "/a"}


def test_accepting_pauses_without_descriptors(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(greeting, "_PAUSE", 0.05)
    listener, attempts = bench.server._sock, []

    class Scarce:
        fileno = listener.fileno
        close = listener.close

        @staticmethod
        def accept() -> tuple[socket.socket, object]:
            attempts.append(1)
            if len(attempts) < 3:
                raise OSError(errno.EMFILE, "too many open files")
            return listener.accept()

    bench.server._sock = Scarce()  # type: ignore[assignment]
    assert bench.greet(topic="/a") == {"topic": "/a"}
    assert len(attempts) >= 3


def test_a_closed_server_accepts_no_connection(bench: Bench) -> None:
    bench.server.close()
    bench.server.close()
    with pytest.raises(ConnectionRefusedError):
        bench.connect()


def test_peers_that_wait_for_admission_are_disconnected_when_the_server_closes(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on = threading.Semaphore(0), threading.Event()

    def hang(*_: object) -> str:
        begun.release()
        go_on.wait(20)
        return "closed"

    monkeypatch.setattr(bench.server, "_admit", hang)
    waiting = []
    for _ in range(greeting._ADMITTED_AT_ONCE + 1):
        near, far = socket.socketpair()
        bench.peers.enter_context(far)
        bench.server.complete(near, b"")
        waiting.append(near)
    for _ in range(greeting._ADMITTED_AT_ONCE):
        assert begun.acquire(timeout=20)
    bench.server.close()
    late, far = socket.socketpair()
    bench.peers.enter_context(far)
    bench.server.complete(late, b"")
    go_on.set()
    assert waiting[-1].fileno() == late.fileno() == -1


def test_a_peer_is_disconnected_if_no_thread_can_admit_it(bench: Bench) -> None:
    near, far = socket.socketpair()
    with far, no_threads("midspan-ros1-greet"):
        bench.server.complete(near, b"")
    assert near.fileno() == -1
    assert bench.greet(topic="/a") == {"topic": "/a"}
