"""ROS 1 clients are served: valid, slow, malformed and leaving ones."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.handshake import decode, encode
from bridge.adapters.ros1.services import connection
from bridge.adapters.ros1.services.server import MAX_CLIENTS, ServiceServers
from bridge.adapters.ros1_peers import DeadlineSocket
from bridge.hub.endpoints.calls import CallError
from bridge.messages.errors import MessageTypeError
from bridge.messages.transcode.conversion import SideType
from tests.support.no_threads import no_threads
from tests.support.wait import until

TYPE = SideType("pkg/Serve", "5e7e", "")
LIMIT = 1_000_000


class Handler:
    """Replies to calls: at once, later, or never."""

    def __init__(self) -> None:
        self.requests: list[bytes] = []
        self.dones: list[Any] = []
        self.abandoned: list[int] = []
        self.at_once = True

    def __call__(self, request: bytes, done: Any) -> Any:
        self.requests.append(request)
        self.dones.append(done)
        number = len(self.dones) - 1
        if self.at_once:
            done(request[::-1])
        return lambda: self.abandoned.append(number)

    def wait(self, count: int) -> None:
        until(lambda: len(self.dones) >= count, f"{count} requests have arrived", every=0.001)


class Bench:
    """A node's services, and clients of them over real sockets."""

    def __init__(self, limit: int) -> None:
        self.loop, self.changes, self.handler = ConnectionLoop("test-serving"), 0, Handler()
        context: Any = SimpleNamespace(loop=self.loop, node=lambda: "/midspan", origin="robot", limit=limit)
        self.servers = ServiceServers(context, self.changed)
        self.server = self.servers.open("/serve", TYPE, self.handler)
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=256)
        self._clients = contextlib.ExitStack()

    def changed(self) -> None:
        self.changes += 1

    def connect(self, **header: str) -> tuple[Client, dict[str, str]]:
        """Connect a client; return it and the server's header."""
        near = socket.create_connection(self._listener.getsockname())
        far, _ = self._listener.accept()
        client = Client(self._clients.enter_context(near))
        fields = {"callerid": "/client", "service": "/serve", "md5sum": TYPE.type_id, **header}
        sock = DeadlineSocket(fileno=far.detach())
        error = self.servers.admit(sock, {k: v for k, v in fields.items() if v})
        if error:
            with sock:
                sock.sendall(encode({"error": error}))
        return client, decode(client.frame())

    def open(self, **header: str) -> Client:
        return self.connect(persistent="1", **header)[0]

    def close(self) -> None:
        self.servers.close()
        self.loop.stop()
        self._clients.close()
        self._listener.close()


class Client:
    """The client's end of a connection."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        sock.settimeout(20)

    def exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            part = self.sock.recv(count - len(data))
            assert part, f"the connection ended after {data[:100]!r}"
            data += part
        return data

    def frame(self) -> bytes:
        return self.exactly(struct.unpack("<I", self.exactly(4))[0])

    def send(self, request: bytes) -> None:
        self.sock.sendall(struct.pack("<I", len(request)) + request)

    def reply(self) -> tuple[int, bytes]:
        return self.exactly(1)[0], self.frame()

    def call(self, request: bytes) -> tuple[int, bytes]:
        self.send(request)
        return self.reply()

    def ended(self) -> bool:
        return self.sock.recv(1) == b""


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    bench = Bench(getattr(request, "param", LIMIT))
    yield bench
    bench.close()


def test_a_connection_that_is_not_persistent_is_closed_after_one_call(bench):
    client, header = bench.connect()
    assert header == {
        "callerid": "/midspan", "service": "/serve", "type": "pkg/Serve", "md5sum": "5e7e",
        "request_type": "pkg/ServeRequest", "response_type": "pkg/ServeResponse", "midspan_origin": "robot",
    }  # fmt: skip
    assert client.call(b"abc") == (1, b"cba")
    assert client.ended()
    until(lambda: bench.server.clients == 0, "the client is removed")


def test_a_persistent_connection_serves_many_calls(bench):
    client = bench.open()
    for n in range(50):
        assert client.call(f"call {n}".encode()) == (1, f"call {n}".encode()[::-1])


@pytest.mark.parametrize("persistent", ["", "1"])
@pytest.mark.parametrize("size", [0, 1, 65_536, 65_537, LIMIT])
def test_requests_and_replies_of_every_size_arrive(bench, size, persistent):
    body = bytes(range(256)) * (size // 256) + bytes(size % 256)
    client, _ = bench.connect(persistent=persistent)
    for _ in range(2 if persistent else 1):
        assert client.call(body) == (1, body[::-1])


def test_probes_and_clients_of_any_md5_are_accepted(bench):
    client, header = bench.connect(probe="1", md5sum="*")
    assert (header["type"], header["md5sum"]) == ("pkg/Serve", "5e7e")
    assert client.ended()
    client, _ = bench.connect(md5sum="*")
    assert client.call(b"any") == (1, b"yna")


def test_clients_with_an_invalid_header_are_rejected_with_the_reason(bench):
    _, header = bench.connect(md5sum="0ther")
    assert header == {
        "error": "/serve: md5 sums differ: /client requests 0ther, but it is pkg/Serve with 5e7e; use the same version"
        " of pkg on both sides"
    }
    assert "/midspan does not serve /other" in bench.connect(service="/other")[1]["error"]
    assert "needs the field md5sum" in bench.connect(md5sum="")[1]["error"]
    assert "needs the field callerid" in bench.connect(callerid="")[1]["error"]
    assert not bench.handler.requests


def test_errors_are_returned_and_the_connection_stays_open(bench):
    bench.handler.at_once = False
    client = bench.open()
    client.send(b"a")
    bench.handler.wait(1)
    bench.handler.dones[0](CallError("the goal is in a wall: Überall"))
    assert client.reply() == (0, "the goal is in a wall: Überall".encode())
    client.send(b"b")
    bench.handler.wait(2)
    bench.handler.dones[0](b"the first again")
    bench.handler.dones[1](b"the second")
    bench.handler.dones[1](b"twice")
    assert client.reply() == (1, b"the second")
    bench.handler.at_once = True
    assert client.call(b"cd") == (1, b"dc"), "no other bytes arrive in between"


def test_an_exception_of_the_handler_is_returned_as_an_error(bench):
    server = bench.servers.open("/broken", TYPE, lambda *_: 1 / 0)
    client = bench.open(service="/broken")
    ok, text = client.call(b"")
    assert (ok, text) == (0, b"failed here: ZeroDivisionError: division by zero")
    server.close()


def test_a_slow_call_does_not_delay_others(bench):
    bench.handler.at_once = False
    slow = [bench.open() for _ in range(100)]
    for n, client in enumerate(slow):
        client.send(str(n).encode())
    bench.handler.wait(100)
    quick = bench.open()
    for n in range(10):
        quick.send(b"quick")
        bench.handler.wait(101 + n)
        bench.handler.dones[100 + n](b"done")
        assert quick.reply() == (1, b"done")
    for request, done in reversed(list(zip(bench.handler.requests[:100], bench.handler.dones[:100], strict=True))):
        done(b"reply to " + request)
    assert [client.reply()[1] for client in slow] == [f"reply to {n}".encode() for n in range(100)]


def test_a_request_in_pieces_is_joined(bench):
    client = bench.open()
    for byte in struct.pack("<I", 9) + b"in pieces":
        client.sock.sendall(bytes([byte]))
    assert client.reply() == (1, b"seceip ni")


def test_requests_in_one_segment_are_served_in_sequence(bench):
    bench.handler.at_once = False
    client = bench.open()
    client.sock.sendall(b"".join(struct.pack("<I", 1) + bytes([n]) for n in range(5)))
    for n in range(5):
        bench.handler.wait(n + 1)
        assert len(bench.handler.dones) == n + 1
        bench.handler.dones[n](bytes([n]))
        assert client.reply() == (1, bytes([n]))


@pytest.mark.parametrize("size", [LIMIT + 1, 20 * LIMIT])
def test_a_request_above_the_limit_is_refused_with_an_error(bench, size):
    client = bench.open()
    assert client.call(bytes(size)) == (0, f"the request has {size} bytes, limits.message allows {LIMIT}".encode())
    assert client.call(b"small") == (1, b"llams")
    once, _ = bench.connect()
    assert once.call(bytes(size))[0] == 0, "the error arrives before the connection is closed"
    assert bench.handler.requests == [b"small"]


def test_a_reply_above_the_limit_becomes_an_error(bench):
    bench.handler.at_once = False
    client = bench.open()
    client.send(b"")
    bench.handler.wait(1)
    bench.handler.dones[0](bytes(LIMIT + 1))
    assert client.reply() == (0, f"the reply has {LIMIT + 1} bytes, limits.message allows {LIMIT}".encode())


def test_incomplete_requests_do_not_affect_other_clients(bench):
    liar = bench.open()
    liar.sock.sendall(struct.pack("<I", 2**32 - 1))
    cut_short = bench.open()
    cut_short.sock.sendall(struct.pack("<I", LIMIT) + b"start")
    cut_short.sock.close()
    assert bench.open().call(b"ab") == (1, b"ba")
    until(lambda: bench.server.clients == 2, "the disconnected client is removed")
    assert bench.handler.requests == [b"ab"]


@pytest.mark.parametrize("persistent", ["", "1"])
def test_a_client_that_leaves_abandons_its_call(bench, persistent):
    bench.handler.at_once = False
    client, _ = bench.connect(persistent=persistent)
    client.send(b"long")
    bench.handler.wait(1)
    client.sock.close()
    until(lambda: bench.handler.abandoned == [0], "the call is abandoned")
    until(lambda: bench.server.clients == 0, "the client is removed")
    bench.handler.dones[0](b"late")
    bench.handler.at_once = True
    assert bench.open().call(b"ab") == (1, b"ba")


def test_a_client_that_leaves_with_unread_data_abandons_its_call(bench):
    bench.handler.at_once = False
    client = bench.open()
    client.send(b"long")
    bench.handler.wait(1)
    client.send(b"more")
    client.sock.close()
    until(lambda: bench.handler.abandoned == [0], "the call is abandoned")
    assert bench.handler.requests == [b"long"]


@pytest.mark.parametrize("size", [100, 4096, 10_000, 200_000])
def test_a_request_of_any_size_may_arrive_during_a_call(bench, size):
    """The first bytes are buffered, so that a disconnection is noticed; the rest stays in the socket."""
    bench.handler.at_once = False
    client = bench.open()
    client.send(b"first")
    bench.handler.wait(1)
    body = bytes(range(250)) * (size // 250) + bytes(size % 250)
    sending = threading.Thread(target=lambda: (client.send(body), client.send(b"third")))
    sending.start()
    for n, request in enumerate((b"first", body, b"third")):
        bench.handler.wait(n + 1)
        assert (len(bench.handler.requests), bench.handler.requests[n]) == (n + 1, request)
        bench.handler.dones[n](request[::-1])
        assert client.reply() == (1, request[::-1])
    sending.join()


@pytest.mark.parametrize("bench", [40 * LIMIT], indirect=True)
def test_a_client_that_does_not_read_delays_no_others(bench):
    large = 40 * LIMIT  # more than any socket buffer
    bench.handler.at_once = False
    deaf, leaver, other = bench.open(), bench.open(), bench.open()
    for n, client in enumerate((deaf, leaver, other)):
        client.send(b"")
        bench.handler.wait(n + 1)
    bench.handler.dones[0](bytes(large))
    bench.handler.dones[1](bytes(large))
    bench.handler.dones[2](b"quick")
    assert other.reply() == (1, b"quick"), "other clients do not wait for the slow one"
    assert deaf.reply() == (1, bytes(large)), "when the slow client finally reads, it receives everything"
    leaver.sock.close()
    until(lambda: bench.server.clients == 2, "the client is removed")
    bench.handler.at_once = True
    assert deaf.call(b"ab") == (1, b"ba")


def test_closing_ends_pending_calls_with_an_error(bench):
    bench.handler.at_once = False
    waiting, idle = bench.open(), bench.open()
    waiting.send(b"long")
    bench.handler.wait(1)
    changes = bench.changes
    bench.server.close()
    bench.server.close()
    assert waiting.reply() == (0, b"/serve is no longer served")
    assert waiting.ended()
    assert idle.ended()
    until(lambda: bench.handler.abandoned == [0], "the call is abandoned")
    assert (list(bench.servers.names()), bench.changes) == ([], changes + 1)
    assert "does not serve" in bench.connect()[1]["error"]
    bench.servers.open("/serve", TYPE, bench.handler)
    bench.handler.at_once = True
    assert bench.open().call(b"ab") == (1, b"ba")


def test_closing_abandons_a_call_that_is_just_starting(bench):
    def begin(request: bytes, done: Any) -> Any:
        abandon = type(bench.handler).__call__(bench.handler, request, done)
        closer = threading.Thread(target=bench.server.close)
        closer.start()
        closer.join(20)
        return abandon

    bench.handler.at_once = False
    bench.server.call = begin
    client = bench.open()
    assert client.call(b"long") == (0, b"/serve is no longer served")
    until(lambda: bench.handler.abandoned == [0], "the call is abandoned")


def test_a_second_server_of_one_name_and_a_type_without_md5_are_refused(bench):
    with pytest.raises(MessageTypeError, match="already served on ROS 1 as pkg/Serve"):
        bench.servers.open("/serve", TYPE, bench.handler)
    with pytest.raises(MessageTypeError, match="md5 sum of pkg/Other is unknown"):
        bench.servers.open("/other", SideType("pkg/Other", "", ""), bench.handler)


def test_clients_beyond_the_limit_are_refused_until_one_leaves(bench, monkeypatch):
    assert MAX_CLIENTS == 1000
    monkeypatch.setattr("bridge.adapters.ros1.services.server.MAX_CLIENTS", 5)
    clients = [bench.open() for _ in range(5)]
    assert "has 5 clients already" in bench.connect()[1]["error"]
    clients.pop().sock.close()
    until(lambda: bench.server.clients == 4, "one client has left")
    assert bench.open().call(b"ab") == (1, b"ba")


def test_many_clients_at_once_get_their_own_replies(bench):
    replies = []

    def run(client: Client, name: int) -> None:
        for n in range(30):
            body = f"{name} {n}".encode() * (1 + 2000 * (n % 7))
            replies.append(client.call(body) == (1, body[::-1]))

    threads = [threading.Thread(target=run, args=(bench.open(), name)) for name in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert replies == [True] * 600


def test_a_client_is_disconnected_if_no_thread_can_send_its_reply(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = bench.open()

    def refuse(*_: object) -> int:
        raise BlockingIOError

    with monkeypatch.context() as failures, no_threads("midspan-ros1-send"):
        failures.setattr(connection, "send_now", refuse)
        client.send(b"abc")
        assert client.sock.recv(1) == b""
    assert bench.open().call(b"abc") == (1, b"cba")
