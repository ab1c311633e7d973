"""TCPROS headers, and handshakes with peers that misbehave."""

import contextlib
import socket
import struct

import pytest

from bridge.adapters.ros1.handshake import MAX_HEADER, connect, connect_service, decode, encode
from bridge.adapters.ros1_peers import ExhaustedError, RefusedError, Ros1Error, Ros1ProtocolError, UnreachableError
from tests.peers.ros1.servers import node, publisher, tcp_server, until_closed
from tests.support.descriptors import no_descriptors
from tests.support.ports import free_port

HEADER = {
    "type": "std_msgs/String",
    "md5sum": "992c",
    "message_definition": "string data\nint32 a=3\n",
    "latching": "1",
}


def field(text: bytes) -> bytes:
    return struct.pack("<I", len(text)) + text


def test_headers_have_the_documented_bytes():
    # https://wiki.ros.org/ROS/Connection%20Header: lengths are little endian, fields are name=value
    assert encode({"md5sum": "*", "topic": "/a"}) == b"\x18\0\0\0" + b"\x08\0\0\0md5sum=*" + b"\x08\0\0\0topic=/a"
    assert decode(encode(HEADER)[4:]) == HEADER


@pytest.mark.parametrize(
    "body", [b"\1\0", field(b"a=b")[:-1], field(b"nothing"), b"\xff\xff\xff\xff" + b"a=b", field(b"a=b") + b"\0"]
)
def test_malformed_headers_are_refused(body):
    with pytest.raises(Ros1ProtocolError, match="connection header"):
        decode(body)


def test_definitions_in_any_encoding_are_accepted():
    assert decode(field("message_definition=# Müller".encode("latin-1")))["message_definition"].startswith("# M")


def test_the_handshake_with_a_publisher_loses_no_byte_after_the_header():
    def serve(sock) -> None:
        sock.recv(65536)
        sock.sendall(encode(HEADER) + b"\2\0\0\0hi")
        until_closed(sock)

    with publisher(serve) as uri:
        sock, header = connect("/me", uri, "/topic", 20.0)
        with contextlib.closing(sock):
            assert header == HEADER
            assert sock.recv(100) == b"\2\0\0\0hi", "no byte after the header may be lost"


def sending(data):
    def serve(sock) -> None:
        sock.recv(65536)
        sock.sendall(data)
        until_closed(sock)

    return serve


def trickle(sock):
    """Send a byte now and then, forever, because each byte restarts a plain timeout."""
    sock.sendall(struct.pack("<I", 1000))
    sock.settimeout(0.05)
    while True:
        with contextlib.suppress(TimeoutError):
            if not sock.recv(65536):
                return
        sock.sendall(b"x")


BAD = [
    (sending(struct.pack("<I", MAX_HEADER + 1)), Ros1ProtocolError, "announces 1048577 bytes"),
    (sending(b"HTTP/1.1 400 Bad Request\r\n\r\n"), Ros1ProtocolError, "announces"),
    (sending(struct.pack("<I", 5) + b"\xff\xff\xff\xffa"), Ros1ProtocolError, "truncated"),
    (sending(encode({"error": "no such topic"})), RefusedError, "no such topic"),
    (sending(encode({"md5sum": "1"})), Ros1ProtocolError, "has no type"),
    (lambda _sock: None, Ros1Error, "closed the connection|broke off"),
    (until_closed, UnreachableError, "in time"),
    (trickle, UnreachableError, "in time"),
]


@pytest.mark.parametrize(("serve", "error", "words"), BAD)
def test_misbehaving_publishers_raise_a_specific_error(serve, error, words):
    with publisher(serve) as uri, pytest.raises(error, match=words):
        connect("/me", uri, "/topic", 5.0 if words == "in time" else 20.0)  # the time includes the steps before


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        ([1, "", []], Ros1Error),
        ([1, "", ["UDPROS", 1]], Ros1Error),
        ([1, "", ["TCPROS", "127.0.0.1", 0]], Ros1Error),
        ([1, "", ["TCPROS", "127.0.0.1", "http"]], Ros1Error),
        ([1, "", ["TCPROS", "a\0b", 1]], Ros1ProtocolError),
        ([1, "", ["TCPROS", "x" * 300, 1]], Ros1ProtocolError),
        ([0, "not mine", 0], RefusedError),
        (["x"], Ros1ProtocolError),
        (5, Ros1ProtocolError),
    ],
)
def test_invalid_responses_to_request_topic_are_errors(answer, error):
    with node(requestTopic=lambda *_: answer) as uri, pytest.raises(error):
        connect("/me", uri, "/topic", 20.0)


def test_a_refused_connection_names_the_step_that_failed():
    with pytest.raises(UnreachableError, match="does not answer"):
        connect("/me", f"http://127.0.0.1:{free_port()}/", "/topic", 20.0)
    answer = [1, "", ["TCPROS", "127.0.0.1", free_port()]]
    with node(requestTopic=lambda *_: answer) as uri, pytest.raises(UnreachableError, match="cannot connect"):
        connect("/me", uri, "/topic", 20.0)


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_a_lack_of_descriptors_is_not_the_peers_fault(name):
    socket.getaddrinfo(name, 11311)  # the resolver reports another errno after it has read its files
    with no_descriptors(), pytest.raises(ExhaustedError, match=r"no file descriptor left.*LimitNOFILE"):
        connect("/me", f"http://{name}:11311/", "/topic", 20.0)


@pytest.mark.parametrize(
    "address", ["", "nonsense", "rosrpc://", "rosrpc://host", "rosrpc://host:99999", "rosrpc://[::1"]
)
def test_services_without_a_valid_address_are_refused(address):
    with pytest.raises(Ros1ProtocolError, match="not a ROS 1 service's address"):
        connect_service("/me", address, "/serve", 20.0, md5sum="*")


def test_a_service_without_a_type_is_refused():
    with (
        tcp_server(sending(encode({"callerid": "/odd"}))) as (host, port),
        pytest.raises(Ros1ProtocolError, match="no type"),
    ):
        connect_service("/me", f"rosrpc://{host}:{port}", "/serve", 20.0, md5sum="*", probe="1")
