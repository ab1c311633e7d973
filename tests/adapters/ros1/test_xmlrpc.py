"""The XML-RPC server of ROS 1's APIs: Python's client, invalid requests, and slow, hostile or many clients."""

from __future__ import annotations

import contextlib
import http.client
import random
import select
import selectors
import socket
import threading
import xmlrpc.client
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import datetime
from typing import Any

import pytest

from bridge.adapters.ros1 import xmlrpc as xmlrpc_server
from bridge.adapters.ros1.xmlrpc import XmlRpcServer
from bridge.adapters.ros1.xmlrpc_request import Limits, decode_response, encode_response, encode_responses
from tests.support.no_threads import no_threads
from tests.support.wait import until
from yarp_compat.threaded_loop import ThreadedLoop

LIMITS = Limits(
    connections=600,
    body=100_000,
    buffered=250_000,
    head=2000,
    depth=10,
    values=500,
    seconds=60.0,
    threads=2,
    response=1_000_000,
)
HASTY = pytest.mark.parametrize("served", [replace(LIMITS, seconds=1.0)], ids=["hasty"], indirect=True)
"""For tests of connections that expire; on a busy machine, the clients of other tests may be silent for a second."""

ADD = xmlrpc.client.dumps((1, 2), "add").encode()
MANY = 500


class Served:
    """A server whose method ``wait`` blocks until it is released."""

    def __init__(self, quick: tuple[str, ...] = (), limits: Limits = LIMITS) -> None:
        self.large = 0
        self.release = threading.Event()
        self.waiting = threading.Semaphore(0)
        self.server = XmlRpcServer(
            {
                "large": self._large,
                "add": lambda a, b: a + b,
                "echo": lambda value: value,
                "wait": self._wait,
                "fail": self._fail,
            },
            limits=limits,
            quick=quick,
        )
        self.server.start()
        self.uri = f"http://127.0.0.1:{self.server.port}/"

    def _large(self) -> str:
        self.large += 1
        return "x" * 100_000

    def _wait(self) -> int:
        self.waiting.release()
        return int(self.release.wait(30))

    def _fail(self, code: int) -> int:
        raise xmlrpc.client.Fault(code, "asked for") if code else KeyError("broken")

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.server.port), 20)

    def post(self, body: bytes) -> bytes:
        """Post one request on a new connection, and return the body of the response."""
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", self.server.port, 20)) as client:
            client.request("POST", "/", body)
            return client.getresponse().read()


@pytest.fixture
def served(request: pytest.FixtureRequest) -> Iterator[Served]:
    """A server, with other limits if the test has them as a parameter."""
    served = Served(limits=getattr(request, "param", LIMITS))
    yield served
    served.release.set()
    served.server.close()


@pytest.fixture
def proxy(served: Served) -> Iterator[xmlrpc.client.ServerProxy]:
    with xmlrpc.client.ServerProxy(served.uri) as proxy:
        yield proxy


def fault_of(call: Callable[[], object]) -> xmlrpc.client.Fault:
    with pytest.raises(xmlrpc.client.Fault) as caught:
        call()
    return caught.value


@pytest.mark.parametrize(
    "value",
    [
        0, -(2**31), 1.5, True, "", "päth/\U0001f916 <&>", [], {}, [[1, "a"], {"b": [2.5, False]}],
        xmlrpc.client.Binary(bytes(range(256))), xmlrpc.client.DateTime(datetime(2026, 11, 26, 12, 0, 0)),
    ],
    ids=str,
)  # fmt: skip
def test_values_return_as_they_were_sent(proxy: xmlrpc.client.ServerProxy, value: object):
    assert proxy.echo(value) == value


def test_calls_share_a_connection(served: Served, proxy: xmlrpc.client.ServerProxy):
    assert [proxy.add(i, 1) for i in range(20)] == list(range(1, 21))
    assert served.server.connections == 1


@pytest.mark.parametrize(
    ("version", "header", "persists"), [("1.0", "", False), ("1.0", "keep-alive", True), ("1.1", "close", False)]
)
def test_a_connection_persists_if_the_client_wants_it(served: Served, version: str, header: str, persists: bool):
    option = f"Connection: {header}\r\n" if header else ""
    with served.connect() as sock:
        sock.sendall(f"POST / HTTP/{version}\r\n{option}Content-Length: {len(ADD)}\r\n\r\n".encode() + ADD)
        response = http.client.HTTPResponse(sock)
        response.begin()
        assert xmlrpc.client.loads(response.read())[0] == (3,)
        until(lambda: served.server.connections == int(persists), "the server keeps or closes the connection")


def test_requests_that_arrive_together_or_in_pieces_are_served_in_order(served: Served):
    requests = b""
    for number in range(3):
        body = xmlrpc.client.dumps((number, 0), "add").encode()
        requests += b"POST /RPC2 HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % len(body) + body
    with served.connect() as sock, sock.makefile("rb") as responses:
        for piece in (requests[:30], requests[30:150], requests[150:]):
            sock.sendall(piece)
        values = []
        for _ in range(3):
            head = b"".join(iter(responses.readline, b"\r\n"))
            size = int(head.partition(b"Content-Length: ")[2].split()[0])
            values.append(xmlrpc.client.loads(responses.read(size))[0][0])
    assert values == [0, 1, 2]


def test_expect_continue_is_answered(served: Served):
    with served.connect() as sock:
        sock.sendall(b"POST / HTTP/1.1\r\nExpect: 100-continue\r\nContent-Length: %d\r\n\r\n" % len(ADD))
        assert sock.recv(100).startswith(b"HTTP/1.1 100 ")
        sock.sendall(ADD)
        assert sock.recv(100).startswith(b"HTTP/1.1 200 ")


def test_a_failed_call_returns_a_fault_and_is_logged_once_per_method(
    served: Served, proxy: xmlrpc.client.ServerProxy, caplog: pytest.LogCaptureFixture
):
    assert "nothing" in fault_of(proxy.nothing).faultString
    assert fault_of(lambda: proxy.fail(7)).faultCode == 7
    assert "broken" in fault_of(lambda: proxy.fail(0)).faultString
    assert "broken" in fault_of(lambda: proxy.fail(0)).faultString
    assert "TypeError" in fault_of(lambda: proxy.add(1)).faultString
    assert "TypeError" in fault_of(lambda: getattr(proxy, "system.multicall")(5)).faultString
    assert proxy.add(1, 2) == 3
    # of each method once: fail, add; threads of earlier tests may still log
    failures = [r for r in caplog.records if r.name == xmlrpc_server.__name__ and "fail" in r.getMessage()]
    assert len(failures) == 2


def test_a_multicall_returns_a_result_or_fault_per_call(proxy: xmlrpc.client.ServerProxy):
    calls = xmlrpc.client.MultiCall(proxy)
    calls.add(1, 2)
    calls.nothing()
    calls.fail(5)
    getattr(calls, "system.multicall")([])
    calls.add(3, 4)
    results: list[Any] = calls().results
    assert (results[0], results[4]) == ([3], [7])
    assert [r["faultCode"] for r in results[1:4]] == [
        xmlrpc.client.METHOD_NOT_FOUND,
        5,
        xmlrpc.client.INVALID_METHOD_PARAMS,
    ]


def test_multicall_makes_no_calls_for_the_characters_of_a_text(served: Served):
    """Otherwise a request of a megabyte would have a response of hundreds of megabytes."""
    for params in (("x" * 90_000,), ({"a": 1},), ([], [])):
        body = xmlrpc.client.dumps(params, "system.multicall").encode()
        response = served.post(body)
        assert "list of calls" in fault_of(lambda response=response: xmlrpc.client.loads(response)).faultString
        assert len(response) < 1000


def test_a_method_of_any_type_is_a_fault_of_that_call(proxy: xmlrpc.client.ServerProxy):
    calls = [{"methodName": name, "params": [1, 2]} for name in ("add", 5, [1], {"a": 1}, "", "add")]
    results = getattr(proxy, "system.multicall")([*calls, 7, "add", {}])
    assert (results[0], results[5]) == ([3], [3])
    assert all("faultCode" in result for result in (*results[1:5], *results[6:]))


def test_the_response_to_many_calls_is_limited(served: Served):
    """A small request could otherwise cause a response that fills the memory."""
    calls = [{"methodName": "large", "params": []} for _ in range(100)]
    body = xmlrpc.client.dumps((calls,), "system.multicall").encode()
    assert "exceeds 1000000 bytes" in fault_of(lambda: xmlrpc.client.loads(served.post(body))).faultString
    assert served.large < 20
    assert b"<int>3</int>" in served.post(ADD)


@pytest.mark.parametrize("text", ["\0\x1b", "\ud800", "\uffff", "\x7f\n\r\t"], ids=ascii)
def test_a_response_is_xml_whatever_its_texts_contain(text: str):
    """A connected node's name, which `getBusInfo` returns, may contain any bytes."""
    value = decode_response(encode_response([text, {text: text}]))
    assert len(value[0]) == len(text)
    assert decode_response(encode_responses([[text]], LIMITS)) == [[value[0]]]


def test_the_rest_of_a_body_that_is_longer_than_announced_is_not_a_request(served: Served):
    with served.connect() as sock, sock.makefile("rb") as responses:
        sock.sendall(b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % len(ADD) + ADD + b"<more/>\r\n\r\n")
        assert b"200" in responses.readline()
        assert b" 400 " in responses.read()
    until(lambda: served.server.connections == 0, "the connection is closed")


def call_with(value: str) -> bytes:
    return f"<methodCall><methodName>echo</methodName><params><param>{value}</param></params></methodCall>".encode()


NESTED = "<value><array><data>" * 11 + "</data></array></value>" * 11
STRUCTS = "<value><struct><member><name>a</name>" * 11 + "<value/>" + "</member></struct></value>" * 11
BOMB = '<!DOCTYPE b [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b"", "no element"),
        (b"<methodCall>", "no element"),
        (b"\x00\xff", "not an XML-RPC request"),
        (b"<methodCall></methodCall>", "not an XML-RPC request"),
        (b"<methodResponse><params/></methodResponse>", "names no method"),
        (call_with("<value><int>one</int></value>"), "one"),
        (call_with("<value><boolean>2</boolean></value>"), "boolean"),
        (call_with("<value><int>" + "9" * 9000 + "</int></value>"), "digits"),
        (call_with("<value><ex:thing/></value>"), "not an XML-RPC request"),
        (call_with(NESTED), "deeper than 10"),
        (call_with(STRUCTS), "deeper than 10"),
        (call_with("<value><array><data>" + "<value/>" * 500 + "</data></array></value>"), "too many values"),
        (BOMB.encode() + call_with("<value>&b;</value>"), "document type"),
        (b'<!DOCTYPE x SYSTEM "file:///etc/passwd">' + ADD, "document type"),
        (call_with("<value>&unknown;</value>"), "entity"),
    ],
)
def test_invalid_bodies_are_faults(served: Served, body: bytes, reason: str):
    assert reason in fault_of(lambda: xmlrpc.client.loads(served.post(body))).faultString
    assert xmlrpc.client.loads(served.post(ADD))[0] == (3,)


@pytest.mark.parametrize(
    ("head", "status"),
    [
        ("GET / HTTP/1.1", 501),
        ("POST /other HTTP/1.1\r\nContent-Length: 5", 404),
        ("POST / HTTP/1.1", 411),
        ("POST / HTTP/1.1\r\nTransfer-Encoding: chunked", 411),
        ("POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\nContent-Length: 5", 411),
        ("POST / HTTP/1.1\r\nContent-Length: -5", 400),
        ("POST / HTTP/1.1\r\nContent-Length: 5\r\nContent-Length: 6", 400),
        ("POST / HTTP/1.1\r\nContent-Length: 100001", 413),
        ("POST / HTTP/1.1\r\nContent-Length: " + "9" * 500, 413),
        ("POST / HTTP/1.1\r\nContent-Encoding: gzip\r\nContent-Length: 5", 501),
        ("POST / HTTP/1.1\r\nnonsense", 400),
        ("nonsense", 400),
        ("POST / HTTP/1.1\r\nX: " + "x" * 3000, 431),
    ],
)
def test_invalid_headers_are_rejected(served: Served, head: str, status: int):
    with served.connect() as sock:
        sock.sendall(head.encode() + b"\r\n\r\n")
        assert int(sock.recv(1000).split()[1]) == status
        with contextlib.suppress(ConnectionResetError):
            assert sock.recv(1000) == b""
    until(lambda: served.server.connections == 0, "the connection is closed")


@HASTY
def test_half_requests_and_silent_connections_expire(served: Served):
    with served.connect() as silent, served.connect() as half_head, served.connect() as half_body:
        half_head.sendall(b"POST / HT")
        half_body.sendall(b"POST / HTTP/1.1\r\nContent-Length: 50\r\n\r\nabc")
        for sock in (silent, half_head, half_body):
            assert sock.recv(100) == b""


@HASTY
def test_an_idle_connection_does_not_expire(served: Served, proxy: xmlrpc.client.ServerProxy):
    assert proxy.add(1, 2) == 3
    with served.connect() as silent:  # expires
        assert silent.recv(100) == b""
    assert served.server.connections == 1
    assert proxy.add(1, 2) == 3


def test_500_clients_at_once_are_served_by_three_threads(served: Served):
    threads = threading.active_count()
    socks = [served.connect() for _ in range(MANY)]
    try:
        for sock in socks:
            sock.sendall(b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % len(ADD) + ADD)
        for sock in socks:
            assert b"<int>3</int>" in sock.recv(1000)
        assert threading.active_count() - threads <= LIMITS.threads
        assert served.server.connections == MANY
    finally:
        for sock in socks:
            sock.close()
    until(lambda: served.server.connections == 0, "all connections are closed")


def test_beyond_the_limit_the_longest_idle_connection_is_closed(served: Served):
    with contextlib.ExitStack() as stack:
        first = stack.enter_context(served.connect())
        until(lambda: served.server.connections == 1, "the first connection is open")
        for _ in range(LIMITS.connections - 1):
            stack.enter_context(served.connect())
        assert b"<int>3</int>" in served.post(ADD)
        assert first.recv(100) == b""
        assert served.server.connections <= LIMITS.connections


def test_server_without_connections_does_not_wake_up(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(xmlrpc_server, "_TICK", 0.5)
    served = Served()
    try:
        for _ in range(2):
            assert decode_response(served.post(ADD)) == 3
            with served.connect():  # open until it is seen that the checks have begun
                until(lambda: served.server._loop._timers, "the connections are checked")
            until(lambda: served.server.connections == 0, "the connection is closed")
            until(lambda: not served.server._loop._timers, "the checks end")
    finally:
        served.server.close()


def test_clients_are_accepted_once_select_can_watch_the_listener(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(selectors, "DefaultSelector", selectors.SelectSelector)
    monkeypatch.setattr(xmlrpc_server, "_TICK", 0.01)
    attempts = list[None]()
    monkeypatch.setattr(ThreadedLoop, "_fits", lambda *_: attempts.append(None) or len(attempts) > 2)
    served = Served()
    try:
        until(lambda: len(attempts) > 2, "the listener is watched", 10.0)
        assert decode_response(served.post(ADD)) == 3
    finally:
        served.server.close()


def test_many_large_half_requests_do_not_prevent_others(served: Served):
    head = b"POST / HTTP/1.1\r\nContent-Length: 100000\r\n\r\n"
    with contextlib.ExitStack() as stack:
        socks = [stack.enter_context(served.connect()) for _ in range(4)]
        for sock in socks:
            with contextlib.suppress(ConnectionError):
                sock.sendall(head + b"x" * 90_000)
        until(lambda: served.server.connections < 4, "the largest request is rejected")
        assert b"<int>3</int>" in served.post(ADD)


def test_a_method_that_blocks_does_not_delay_others(served: Served, proxy: xmlrpc.client.ServerProxy):
    with ThreadPoolExecutor(1) as pool, xmlrpc.client.ServerProxy(served.uri) as other:
        waiting = pool.submit(other.wait)
        assert served.waiting.acquire(timeout=20)
        assert proxy.add(1, 2) == 3
        served.release.set()
        assert waiting.result(20) == 1


@HASTY
def test_a_client_that_reads_nothing_does_not_delay_others(served: Served, proxy: xmlrpc.client.ServerProxy):
    body = xmlrpc.client.dumps(("x" * 90_000,), "echo").encode()
    request = b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % len(body) + body
    with served.connect() as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sock.settimeout(0.2)
        with contextlib.suppress(TimeoutError, ConnectionError):
            for _ in range(100):
                sock.sendall(request)
        assert proxy.add(1, 2) == 3
        until(lambda: served.server.connections == 1, "the connection of the client that reads nothing is closed")


def test_random_changes_of_a_request_are_answered(served: Served):
    chance = random.Random(48)
    seeds = [
        ADD,
        call_with(STRUCTS[:200]),
        xmlrpc.client.dumps(([{"methodName": "add", "params": [1, 2]}],), "system.multicall").encode(),
    ]
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", served.server.port, 20)) as client:
        for _ in range(300):
            body = bytearray(chance.choice(seeds))
            for _ in range(chance.randint(1, 4)):
                at = chance.randrange(len(body))
                body[at : at + chance.randint(0, 3)] = chance.randbytes(chance.randint(0, 3))
            client.request("POST", "/", bytes(body))
            response = client.getresponse()
            assert response.status == 200
            assert response.read().startswith(b"<?xml")


def test_close_ends_connections_and_threads(served: Served):
    with served.connect() as sock:
        until(lambda: served.server.connections == 1, "the connection is open")
        served.server.close()
        served.server.close()
        assert sock.recv(100) == b""
    until(lambda: not served.server._loop._thread.is_alive(), "the thread ends, which closes the listener last")
    with pytest.raises(ConnectionRefusedError):
        served.connect()


def test_a_server_that_was_never_started_can_be_closed():
    server = XmlRpcServer({})
    server.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", server.port), 20)


def test_the_server_listens_on_ipv6():
    try:
        server = XmlRpcServer({"add": lambda a, b: a + b}, "::1")
    except OSError:
        pytest.skip("no IPv6 on this machine")
    server.start()
    with xmlrpc.client.ServerProxy(f"http://[::1]:{server.port}/") as proxy:
        assert proxy.add(1, 2) == 3
    server.close()


def test_a_port_in_use_is_an_error(served: Served):
    with pytest.raises(OSError, match="in use"):
        XmlRpcServer({}, port=served.server.port)


def test_quick_calls_are_answered_while_all_threads_are_busy():
    served = Served(quick=("echo",))
    echo, large = (xmlrpc.client.dumps((value,), "echo").encode() for value in ("x", "x" * 5000))
    try:
        with ThreadPoolExecutor(5) as pool:
            waiting = [pool.submit(served.post, xmlrpc.client.dumps((), "wait").encode()) for _ in range(2)]
            assert all(served.waiting.acquire(timeout=20) for _ in range(2)), "both threads make a call"
            assert xmlrpc.client.loads(served.post(echo)) == (("x",), None)
            assert xmlrpc.client.loads(served.post(echo.replace(b"\n", b""))) == (("x",), None)
            others = [pool.submit(served.post, body) for body in (ADD, large)]
            assert xmlrpc.client.loads(served.post(echo)) == (("x",), None)
            assert not any(call.done() for call in others), "a large call, or one of another method, needs a thread"
            served.release.set()
            assert [xmlrpc.client.loads(call.result(20))[0] for call in [*waiting, *others]] == [
                (1,), (1,), (3,), ("x" * 5000,)
            ]  # fmt: skip
    finally:
        served.release.set()
        served.server.close()


def test_a_quick_call_is_answered_before_the_next_call_of_another_connection():
    """Otherwise, a call that the master makes because of the second call could overtake the response to the first."""
    holding, go = threading.Event(), threading.Event()
    socks: list[socket.socket] = []
    answered: list[int] = []

    def hold() -> int:
        holding.set()
        return int(go.wait(20))

    def look() -> int:
        answered.append(len(select.select(socks, [], [], 0)[0]))
        return 0

    server = XmlRpcServer({"hold": hold, "look": look}, quick=("hold", "look"))
    server.start()
    with contextlib.closing(server), contextlib.ExitStack() as stack:
        for method in ("hold", "look", "look"):
            socks.append(stack.enter_context(socket.create_connection(("127.0.0.1", server.port), 20)))
            body = xmlrpc.client.dumps((), method).encode()
            socks[-1].sendall(b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % len(body) + body)
            assert holding.wait(20)
        go.set()
        until(lambda: len(answered) == 2, "both calls have been made")
    assert answered == [1, 2]


def test_a_client_is_disconnected_if_no_thread_can_make_its_call(
    served: Served, proxy: xmlrpc.client.ServerProxy
) -> None:
    with no_threads("midspan-xmlrpc-call"), pytest.raises(http.client.RemoteDisconnected):
        served.post(xmlrpc.client.dumps((1,), "echo").encode())
    assert proxy.echo(1) == 1
