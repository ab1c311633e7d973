"""ROS 1 servers are called: valid, slow, malformed and crashing ones."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.graph.state import Registration
from bridge.adapters.ros1.handshake import decode, encode
from bridge.adapters.ros1.peer_pool import PeerPool
from bridge.adapters.ros1.services import caller as caller_module
from bridge.adapters.ros1.services.caller import MAX_CALLS, Ros1Caller
from bridge.adapters.ros1.services.connection import ServiceConnection
from bridge.messages.transcode.conversion import SideType
from tests.peers.hub.calls import Ends
from tests.peers.ros1.servers import tcp_server, until_closed
from tests.support.descriptors import no_descriptors
from tests.support.ports import free_port
from tests.support.wait import until

TYPE = SideType("pkg/Serve", "5e7e", "")
HEADER = {"type": TYPE.name, "md5sum": TYPE.type_id}
LIMIT = 1_000_000


def framed(body: bytes, ok: int = 1) -> bytes:
    return struct.pack("<BI", ok, len(body)) + body


def exactly(sock: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        part = sock.recv(count - len(data))
        if not part:
            raise ConnectionResetError
        data += part
    return data


def request_of(sock: socket.socket) -> bytes:
    return exactly(sock, struct.unpack("<I", exactly(sock, 4))[0])


class Server:
    """A loopback server; ``serve(sock, header)`` handles each connection after the exchange of headers."""

    def __init__(self, serve: Callable[[socket.socket, dict[str, str]], None]) -> None:
        self.connections: list[dict[str, str]] = []
        self._serve = serve

    def __call__(self, sock: socket.socket) -> None:
        header = decode(request_of(sock))
        self.connections.append(header)
        sock.sendall(encode(HEADER))
        self._serve(sock, header)


def echo(sock: socket.socket, _header: Any) -> None:
    while True:
        sock.sendall(framed(request_of(sock)[::-1]))


class Bench:
    """A caller and its environment."""

    def __init__(self) -> None:
        self.loop, self.pool, self.doubts = ConnectionLoop("test-calls"), PeerPool(), []
        context: Any = SimpleNamespace(loop=self.loop, pool=self.pool, node=lambda: "/me", limit=LIMIT)
        self.caller = Ros1Caller(context, "/serve", TYPE, self.on_doubt, lambda _caller: None)

    def on_doubt(self, link: Registration, trouble: str) -> None:
        self.doubts.append((link, trouble))

    def toward(self, address: tuple[str, int]) -> None:
        self.link = Registration("/server", "/serve", f"rosrpc://{address[0]}:{address[1]}")
        self.caller.follow(self.link)

    def poll(self) -> None:
        """Do what the edge does after each read of the master."""
        if self.caller.needs_connection:
            self.caller.follow(self.link)

    def call(self, request: bytes = b"abc") -> Ends:
        ends = Ends()
        self.caller.call(request, ends.done)
        return ends

    def warm(self) -> None:
        until(lambda: self.poll() or self.caller.load.idle, "a connection is kept open")


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.caller.close()
    bench.loop.stop()
    bench.pool.stop()


def test_sequential_calls_share_a_connection(bench):
    server = Server(echo)
    with tcp_server(server) as address:
        bench.toward(address)
        bench.warm()
        for n in range(50):
            assert bench.call(f"call {n}".encode()).wait() == [f"call {n}".encode()[::-1]]
            until(lambda: bench.caller.load.idle, "the connection is idle again", every=0.001)
        (header,) = server.connections
        assert header == {
            "callerid": "/me", "service": "/serve", "md5sum": "5e7e", "persistent": "1", "tcp_nodelay": "1"
        }  # fmt: skip


@pytest.mark.parametrize("size", [0, 1, 65_531, 65_536, 65_537, LIMIT])
def test_requests_and_replies_of_every_size_arrive(bench, size):
    body = bytes(range(256)) * (size // 256) + bytes(size % 256)
    with tcp_server(Server(echo)) as address:
        bench.toward(address)
        assert bench.call(body).wait() == [body[::-1]]
        assert bench.call(body).wait() == [body[::-1]], "the connection is still valid afterwards"


def test_a_slow_call_does_not_delay_others(bench):
    go_on = threading.Event()

    def serve(sock, _header) -> None:
        while True:
            request = request_of(sock)
            if request == b"slow":
                go_on.wait(20)
            sock.sendall(framed(request))

    server = Server(serve)
    with tcp_server(server) as address:
        bench.toward(address)
        slow = [bench.call(b"slow") for _ in range(30)]
        for _ in range(20):
            assert bench.call(b"quick").wait() == [b"quick"]
        assert not any(ends.items for ends in slow)
        go_on.set()
        assert all(ends.wait() == [b"slow"] for ends in slow)
        assert len(server.connections) < 60, "connections are reused"
        until(lambda: bench.caller.load.connections <= 8, "only a few idle connections are kept")


def test_a_server_that_is_too_busy_to_connect_keeps_its_pending_calls(bench, monkeypatch):
    """For example a rospy server whose handler computes in an extension and holds the interpreter lock."""
    go_on, server = threading.Event(), Server(echo)

    def serve(sock) -> None:
        if server.connections:
            until_closed(sock)
        server(sock)

    def compute(sock, _header) -> None:
        request = request_of(sock)
        go_on.wait(20)
        sock.sendall(framed(request))

    server._serve = compute
    with tcp_server(serve) as address:
        bench.toward(address)
        bench.warm()
        monkeypatch.setattr(caller_module, "_CONNECT_SECONDS", 1.0)
        long = bench.call(b"long")
        assert "sends no connection header in time" in bench.call().error()
        assert not bench.doubts, "the route to the server would be closed"
        go_on.set()
        assert long.wait() == [b"long"]


def test_a_reply_in_pieces_is_joined(bench):
    def serve(sock, _header) -> None:
        request_of(sock)
        for byte in framed(b"in pieces"):
            sock.sendall(bytes([byte]))
        until_closed(sock)

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        assert bench.call().wait() == [b"in pieces"]


def test_the_servers_error_reaches_the_client(bench):
    def serve(sock, _header) -> None:
        while True:
            sock.sendall(framed({b"a": "no path: Überall".encode(), b"b": b"\xff\xfe", b"c": b""}[request_of(sock)], 0))

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        assert bench.call(b"a").error() == "no path: Überall"
        assert bench.call(b"b").error() == "��"
        assert "no reason" in bench.call(b"c").error()


def test_a_call_without_a_server_fails_with_the_reason(bench):
    assert bench.call().error() == "/serve has no server on ROS 1 now"
    bench.toward(("127.0.0.1", free_port()))
    assert "cannot be called" in bench.call().error()
    assert "refused" in until(lambda: bench.doubts, "the server's registration is checked")[0][1]


def test_the_reason_of_a_rejected_connection_reaches_the_client(bench):
    def refuse(sock) -> None:
        sock.recv(65536)
        sock.sendall(encode({"error": "md5sums do not match"}))

    with tcp_server(refuse) as address:
        bench.toward(address)
        assert "md5sums do not match" in bench.call().error()
        until(lambda: bench.doubts, "the server is probed again")


def test_a_call_fails_if_its_server_crashes_before_the_reply(bench):
    taken = threading.Event()

    def serve(sock, _header) -> None:
        request_of(sock)
        taken.set()
        sock.close()

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        bench.warm()
        assert bench.call().error() == "the server /server closed the connection before it answered"
        assert taken.is_set()


def test_a_call_fails_if_its_server_crashes_during_the_reply(bench):
    def serve(sock, _header) -> None:
        size = int(request_of(sock))
        sock.sendall(framed(bytes(size))[:-1])

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        for size in (10, 500_000):
            assert "closed the connection before" in bench.call(str(size).encode()).error()


def test_the_crash_of_a_server_is_noticed_without_a_call(bench):
    with tcp_server(Server(echo)) as address:
        bench.toward(address)
        bench.warm()
        assert not bench.doubts
    link, trouble = until(lambda: bench.poll() or bench.doubts, "the server's registration is checked")[0]
    assert (link.node, link.uri) == ("/server", f"rosrpc://{address[0]}:{address[1]}")
    assert "refused" in trouble


def test_a_request_is_never_sent_twice(bench):
    # if the connection breaks during the call, it is unknown whether the server executed the request
    requests = []

    def serve(sock, _header) -> None:
        requests.append(request_of(sock))

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        for _ in range(20):
            bench.call().error()
    assert len(requests) == 20


def test_calls_go_to_the_new_address_of_a_server_that_moved(bench):
    def new(sock, _header) -> None:
        request_of(sock)
        sock.sendall(framed(b"new"))
        until_closed(sock)

    with tcp_server(Server(echo)) as first:
        bench.toward(first)
        bench.warm()
        with tcp_server(Server(new)) as second:
            bench.toward(second)
            assert bench.call().wait() == [b"new"]
        bench.caller.follow(None)
        assert "no server" in bench.call().error()


def test_a_reply_above_the_limit_is_an_error_and_later_calls_work(bench):
    def serve(sock, _header) -> None:
        while True:
            size = int(request_of(sock))
            with contextlib.suppress(OSError):
                sock.sendall(struct.pack("<BI", 1, size) + bytes(min(size, 2 * LIMIT)))

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        for size in (LIMIT + 1, 2**32 - 1):
            assert bench.call(str(size).encode()).error() == (
                f"the server /server announced a reply of {size} bytes, limits.message allows {LIMIT}"
            )
        assert bench.call(b"4").wait() == [bytes(4)]


def test_data_without_a_request_closes_the_connection(bench):
    def serve(sock, _header) -> None:
        request_of(sock)
        sock.sendall(framed(b"right") + framed(b"wrong"))
        until_closed(sock)

    server = Server(serve)
    with tcp_server(server) as address:
        bench.toward(address)
        for _ in range(10):
            assert bench.call().wait() == [b"right"], "unrequested data is not the reply of a later call"
        bench.warm()
        assert bench.call().wait() == [b"right"]


def test_an_abandoned_call_closes_its_connection(bench):
    arrived, answer = threading.Event(), threading.Event()
    removed = []

    def serve(sock, _header) -> None:
        request = request_of(sock)
        if request == b"long":
            arrived.set()
            removed.append(sock.recv(1))
            answer.wait(20)
        sock.sendall(framed(b"late"))
        until_closed(sock)

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        ends = Ends()
        abandon = bench.caller.call(b"long", ends.done)
        assert arrived.wait(20)
        abandon()
        until(lambda: removed == [b""], "the server notices that the client has left")
        answer.set()
        abandon()
        assert bench.call(b"next").wait() == [b"late"]
        assert ends.items == [], "the result is dropped"
        assert bench.caller.load.calls == 0


def test_a_call_abandoned_before_the_connection_is_open_is_not_sent(bench):
    go_on = threading.Event()
    requests = []

    def late(sock) -> None:
        go_on.wait(20)
        Server(lambda s, _: requests.append(request_of(s)))(sock)

    with tcp_server(late) as address:
        bench.toward(address)
        ends = Ends()
        bench.caller.call(b"first", ends.done)()
        go_on.set()
        bench.warm()
        assert "closed the connection" in bench.call(b"second").error()
        assert (requests, ends.items) == ([b"second"], [])


def test_calls_beyond_the_limit_are_refused(bench):
    with tcp_server(Server(lambda sock, _: until_closed(sock))) as address:
        bench.toward(address)
        under_way = [bench.caller.call(b"", (ends := Ends()).done) for _ in range(MAX_CALLS)]
        assert "busy: 1000 calls" in bench.call().error()
        for abandon in under_way:
            abandon()
        assert not ends.items
        until(lambda: bench.caller.load.connections == 0 or bench.caller.load.idle, "the calls' connections are closed")


def test_closing_ends_pending_calls(bench):
    arrived = threading.Event()

    def serve(sock, _header) -> None:
        request_of(sock)
        arrived.set()
        until_closed(sock)

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        ends = bench.call()
        assert arrived.wait(20)
        bench.caller.close()
        bench.caller.close()
        assert ends.error() == "/serve is no longer bridged"
        assert bench.call().error() == "/serve is no longer bridged"
        until(lambda: bench.caller.load.connections == 0, "all connections are closed")


def test_a_server_that_does_not_read_blocks_neither_call_nor_close(bench):
    # the request fills the socket's buffer; neither `call` nor `close` waits for the server
    blocked = threading.Event()

    def serve(sock, _header) -> None:
        blocked.wait(20)
        until_closed(sock)

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        bench.warm()
        stuck = bench.call(bytes(50 * LIMIT))
        bench.caller.close()
        assert stuck.error() == "/serve is no longer bridged"
        blocked.set()


def test_a_reply_may_arrive_before_the_request_is_read(bench):
    def serve(sock, _header) -> None:
        sock.recv(4)
        sock.sendall(framed(b"no thanks", 0))
        until_closed(sock)

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        assert bench.call(bytes(20 * LIMIT)).error() == "no thanks"


def test_without_descriptors_only_the_open_connection_is_used(bench):
    go_on = threading.Event()

    def serve(sock, _header) -> None:
        while True:
            request = request_of(sock)
            if request == b"slow":
                go_on.wait(20)
            sock.sendall(framed(request))

    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        bench.warm()
        with no_descriptors():
            assert bench.call().wait() == [b"abc"], "the open connection suffices"
            until(lambda: bench.caller.load.idle, "the connection is idle again", every=0.001)
            slow = bench.call(b"slow")
            assert "no file descriptor" in bench.call().error()
        assert not bench.doubts, "a lack of descriptors is not the server's fault"
        go_on.set()
        assert slow.wait() == [b"slow"]
        assert bench.call().wait() == [b"abc"]


def test_a_call_that_is_abandoned_while_it_connects_is_not_sent(bench, monkeypatch):
    """The request is not sent even if the client abandons the call right before."""
    outcomes = []

    def serve(sock, _header) -> None:
        try:
            outcomes.append(request_of(sock))
        except ConnectionResetError:
            outcomes.append("closed")

    begin = caller_module._ServerConnection.begin

    def begin_late(connection, pending) -> bool:
        pending.abandon()
        return begin(connection, pending)

    monkeypatch.setattr(caller_module._ServerConnection, "begin", begin_late)
    with tcp_server(Server(serve)) as address:
        bench.toward(address)
        ends = bench.call()
        until(lambda: outcomes, "the call's connection ends, or its request arrives")
        assert (outcomes, ends.items) == (["closed"], [])


def test_a_call_that_lacks_a_descriptor_for_its_request_reports_that(bench, monkeypatch):
    monkeypatch.setattr(ServiceConnection, "send", lambda *_arguments: False)
    monkeypatch.setattr("bridge.resources.has_descriptor", lambda: False)
    with tcp_server(Server(echo)) as address:
        bench.toward(address)
        (result,) = bench.call().wait()
        assert "no file descriptor left" in str(result)
