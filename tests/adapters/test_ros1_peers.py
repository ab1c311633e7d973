"""XML-RPC requests with deadlines and limits."""

import contextlib
import math
import socket

import pytest

from bridge.adapters import ros1_peers
from bridge.adapters.ros1_peers import RefusedError, Ros1ProtocolError, UnreachableError
from tests.peers.ros1.servers import node, tcp_server, until_closed
from tests.support.ports import free_port

PATIENT = 60.0
"""Deadline in seconds of requests whose response is expected; the process may stall meanwhile."""


def test_calls_return_values_and_raise_refusals():
    with node(one=lambda _caller: [1, "", 7], no=lambda _caller: [-1, "not set", 0]) as uri:
        client = ros1_peers.XmlRpcClient(uri, PATIENT)
        with contextlib.closing(client):
            assert client.call("one", "/me") == 7
            with pytest.raises(RefusedError, match="not set"):
                client.call("no", "/me")
            with pytest.raises(RefusedError, match="nothing"):
                client.call("nothing", "/me")
            assert client.calls([("one", ("/me",)), ("no", ("/me",)), ("nothing", ("/me",))]) == [7, None, None]


def test_a_request_is_not_delayed_by_acknowledgements():
    """http.client sends header and body separately, so a delayed acknowledgment would delay the body."""
    with node(one=lambda _caller: [1, "", 7]) as uri:
        client = ros1_peers.XmlRpcClient(uri, PATIENT)
        with contextlib.closing(client):
            client.call("one", "/me")
            assert client._http.sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_an_unchanged_answer_is_the_same_object():
    values = [1, 1, 2]
    with node(value=lambda _caller: [1, "", values.pop(0)]) as uri:
        client = ros1_peers.XmlRpcClient(uri, PATIENT)
        with contextlib.closing(client):
            first, second, third = (client.calls([("value", ("/me",))]) for _ in range(3))
    assert first is second
    assert (first, third) == ([1], [2])


def test_a_stopped_server_is_unreachable():
    with node(one=lambda _caller: [1, "", 1]) as uri:
        client = ros1_peers.XmlRpcClient(uri, PATIENT)
        assert client.call("one", "/me") == 1
    with contextlib.closing(client), pytest.raises(UnreachableError):
        client.call("one", "/me")


def trickle(sock):
    sock.recv(65536)
    sock.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n")
    sock.settimeout(0.05)
    while True:
        with contextlib.suppress(TimeoutError):
            if not sock.recv(1):
                return
        sock.sendall(b" ")


def answer(text):
    def serve(sock) -> None:
        sock.recv(65536)
        sock.sendall(text)

    return serve


def ok(body):
    return answer(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n%b" % (len(body), body))


@pytest.mark.parametrize(
    ("serve", "seconds", "error"),
    [
        (until_closed, 0.5, UnreachableError),
        (trickle, 0.5, UnreachableError),
        (answer(b"SSH-2.0-OpenSSH\r\n"), PATIENT, Ros1ProtocolError),
        (answer(b"HTTP/1.1 500 Oops\r\nContent-Length: 0\r\n\r\n"), PATIENT, Ros1ProtocolError),
        (ok(b"<html>"), PATIENT, Ros1ProtocolError),
        (ok(b"<?xml version='1.0'?><methodResponse></methodResponse>"), PATIENT, Ros1ProtocolError),
    ],
)
def test_servers_that_misbehave_are_unreachable_or_violate_the_protocol(serve, seconds, error):
    with tcp_server(serve) as (host, port), pytest.raises(error):
        ros1_peers.ask(f"http://{host}:{port}/", seconds, "getPid", "/me")


def test_responses_above_the_limit_are_refused(monkeypatch):
    monkeypatch.setattr(ros1_peers, "MAX_NODE_ANSWER", 1000)
    with node(big=lambda _caller: [1, "", "x" * 2000]) as uri, pytest.raises(Ros1ProtocolError, match="longer than"):
        ros1_peers.ask(uri, PATIENT, "big", "/me")


@pytest.mark.parametrize("length", [5, 95_000_000, 2**64])
def test_truncated_responses_are_refused(length):
    def serve(sock) -> None:
        sock.recv(65536)
        sock.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n<a>" % length)

    with tcp_server(serve) as (host, port), pytest.raises((Ros1ProtocolError, UnreachableError), match="answer"):
        ros1_peers.ask(f"http://{host}:{port}/", PATIENT, "getPid", "/me")


def response(value: bytes) -> bytes:
    return b"<methodResponse><params><param>" + value + b"</param></params></methodResponse>"


DEEP = response(b"<value><array><data>" * 1200 + b"</data></array></value>" * 1200)
BOMB = b'<!DOCTYPE b [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>' + response(b"<value>&b;</value>")


@pytest.mark.parametrize(
    "body", [b"<bigdecimal></bigdecimal>", b"<a", b"<value><array><data>" * 1000, b"\xff\xfe", DEEP, BOMB]
)
def test_responses_without_xmlrpc_are_refused(body):
    def serve(sock) -> None:
        sock.recv(65536)
        sock.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(body) + body)

    with tcp_server(serve) as (host, port), pytest.raises(Ros1ProtocolError, match="does not respond with XML-RPC"):
        ros1_peers.ask(f"http://{host}:{port}/", PATIENT, "getPid", "/me")


@pytest.mark.parametrize("uri", ["", "rosrpc://a:1", "http://", "http://a:b/", "ftp://a/", "p://[", "http://a\0b:1/"])
def test_invalid_addresses_are_refused(uri):
    with pytest.raises(Ros1ProtocolError, match="not a ROS 1 address"):
        ros1_peers.XmlRpcClient(uri, 1.0)


def test_a_refused_connection_is_reported():
    with pytest.raises(UnreachableError):
        ros1_peers.ask(f"http://127.0.0.1:{free_port()}/", 1.0, "getPid", "/me")


def test_a_connection_whose_options_cannot_be_set_is_closed(monkeypatch):
    near, far = socket.socketpair()  # without TCP's options
    monkeypatch.setattr(socket, "create_connection", lambda *_args, **_options: near)
    with far, pytest.raises(OSError, match="supported"):
        ros1_peers.DeadlineSocket.connected("host", 1, math.inf)
    assert near.fileno() == -1
