"""ROS 1: connection headers, frames, XML-RPC and HTTP, the master's graph, names, and the ledger's file."""

from __future__ import annotations

import contextlib
import json
import math
import socket
import struct
import xmlrpc.client
from collections.abc import Iterator
from typing import Any

from bridge.adapters.ros1_peers import DeadlineSocket, Ros1Error, Ros1ProtocolError
from tests.fuzz.target import JSON_WORDS, Subject, Target, scratch, texts

_FIELDS = {
    "callerid": "/talker", "topic": "/chatter", "type": "std_msgs/String", "md5sum": "992ce8a1687cec8c8bd883ec73ca41d1",
    "message_definition": "string data\n", "latching": "1", "midspan_origin": "robot",
}  # fmt: skip
_HEADER_WORDS = texts(*(f"{name}=" for name in _FIELDS), "error=no", "=", "\x00", "type=*", "md5sum=*", "latching= 1 ")


def _header() -> Subject:
    """A connection header's fields, and the values that are read from them."""
    from bridge.adapters.ros1.graph.probe import Facts
    from bridge.adapters.ros1.handshake import decode, encode

    def parse(data: bytes) -> None:
        fields = decode(data)
        assert all(isinstance(name, str) and isinstance(value, str) for name, value in fields.items())
        if fields.get("type") and fields.get("md5sum"):
            Facts.of(fields)

    return Subject(
        parse, [encode(_FIELDS)[4:], encode({"error": "not a publisher"})[4:]], (Ros1ProtocolError,), _HEADER_WORDS
    )


@contextlib.contextmanager
def _wire(data: bytes) -> Iterator[DeadlineSocket]:
    """Yield a connection whose peer has sent these bytes and then closed its end."""
    ours, theirs = socket.socketpair()
    with theirs:
        theirs.sendall(data)
        theirs.shutdown(socket.SHUT_WR)
        with DeadlineSocket(fileno=ours.detach()) as sock:
            sock.deadline = math.inf
            yield sock


def _greeting() -> Subject:
    """A header received on a connection, after its length."""
    from bridge.adapters.ros1.handshake import encode, read_header

    def parse(data: bytes) -> None:
        with _wire(data) as sock:
            read_header(sock)

    return Subject(
        parse, [encode(_FIELDS), encode({}), encode(_FIELDS) + b"\4\0\0\0abcd"], (Ros1ProtocolError,), _HEADER_WORDS
    )


def _frames() -> Subject:
    """A publisher's messages received on a connection."""
    from bridge.adapters.ros1.topics import connection as module

    def frame(size: int) -> bytes:
        return struct.pack("<I", size) + bytes(range(256)) * (size // 256) + bytes(size % 256)

    def parse(data: bytes) -> None:
        messages: list[bytes] = []
        with _wire(data) as sock:
            reader = module.PublisherConnection(
                _Addressed.adopt(sock, math.inf), "/t", "http://x/", lambda payload, *_: messages.append(payload), "",
                print, print,
            )  # fmt: skip
            try:
                reader._read()
            finally:
                reader.close()
        stream = b"".join(struct.pack("<I", len(message)) + message for message in messages)
        assert data.startswith(stream)

    seeds = [frame(5) * 3, frame(0) + frame(1000), frame(5000) + frame(3), b"".join(frame(n) for n in range(40))]
    return Subject(parse, seeds, (Ros1ProtocolError,), [struct.pack("<I", n) for n in (0, 1, 2**20, 2**31, 2**32 - 1)])


class _Addressed(DeadlineSocket):
    """A socket without an address that pretends to have one."""

    def getpeername(self) -> tuple[str, int]:
        return ("127.0.0.1", 1)

    def getsockname(self) -> tuple[str, int]:
        return ("127.0.0.1", 2)


def _rpc_client() -> Any:
    from bridge.adapters.ros1_peers import XmlRpcClient

    class FakeServerClient(XmlRpcClient):
        """A client whose server sends a given reply."""

        reply = b""

        def _exchange(self, body: bytes, _deadline: float) -> bytes:
            servers = body.count(b"lookupService")  # a second request has one call for each service in the state
            return _answer([[[1, "", "rosrpc://h:1"]]] * servers) if servers else self.reply

    return FakeServerClient("http://127.0.0.1:1/", 1.0)


def _answer(value: Any) -> bytes:
    return xmlrpc.client.dumps((value,), methodresponse=True, allow_none=True).encode()


_XML_WORDS = texts(
    "<value>", "</value>", "<array><data>", "</data></array>", "<struct>", "<member><name>a</name>", "<int>",
    "<i8>", "<boolean>2</boolean>",
    "<nil/>", "<base64>!</base64>", "<dateTime.iso8601>x</dateTime.iso8601>", "<double>nan</double>",
    "<int>9e9</int>", "<ex:nil/>",
    "<!DOCTYPE a [<!ENTITY b 'c'>]>", "&b;", "&#0;", "&lt;", "<![CDATA[", "]]>",
    "<?xml version='1.0' encoding='utf-16'?>", "<fault>",
    "<bigdecimal>1e999999</bigdecimal>", "<float>1e999</float>", "<biginteger>1</biginteger>", "<param>",
    "<methodName>a</methodName>",
)  # fmt: skip


def _xmlrpc() -> Subject:
    """A node's answer: code, message, value; and the values that the handshake reads from it."""
    from bridge.adapters.ros1.handshake import _address

    client = _rpc_client()

    def parse(data: bytes) -> None:
        client.reply = data
        _address(client.call("requestTopic", "/a", "/b", [["TCPROS"]]), "http://x/")

    seeds = [
        _answer([1, "ready", ["TCPROS", "host", 4242]]), _answer([0, "no", 0]), _answer([1, "", {"a": [1.5, True]}]),
        xmlrpc.client.dumps(xmlrpc.client.Fault(1, "broken"), methodresponse=True).encode(),
    ]  # fmt: skip
    return Subject(parse, seeds, (Ros1Error,), _XML_WORDS)


def _slave() -> Subject:
    """Calls of this node's slave API: each call gets a reply of three values, or a fault."""
    from bridge.adapters.ros1.connection_loop import ConnectionLoop
    from bridge.adapters.ros1.node.slave import SlaveApi, SlaveEvents, SlaveState
    from bridge.adapters.ros1.topics.book import TopicBook
    from bridge.adapters.ros1.xmlrpc_request import DEFAULT_LIMITS, decode_call, encode_response
    from bridge.messages.transcode.conversion import SideType

    book = TopicBook(ConnectionLoop(), lambda: "/node", "robot", lambda: None, lambda: None)
    book.publish("/chatter", SideType("std_msgs/String", "0" * 32, "string data\n"), latched=True)
    state = SlaveState(lambda: "/node", lambda: "http://x:1/", "http://m:1/", lambda: ("x", 2), book, lambda: [0, 0, 0])
    api = SlaveApi(state, SlaveEvents(lambda: None, lambda _: True, lambda _: None))
    calls: dict[str, tuple[Any, ...]] = {
        **dict.fromkeys(api.methods, ()), "shutdown": ("why",), "paramUpdate": ("/a", {"b": [1, 2.5]}),
        "publisherUpdate": ("/chatter", ["http://h:1/"]), "requestTopic": ("/chatter", [["UDPROS", 1], ["TCPROS"]]),
    }  # fmt: skip

    def parse(data: bytes) -> None:
        method, params = decode_call(data, DEFAULT_LIMITS)
        if method in api.methods:
            code, text, value = api.methods[method](*params)
            assert code in (-1, 0, 1)
            assert isinstance(text, str)
            encode_response((code, text, value))

    seeds = [xmlrpc.client.dumps(("/caller", *params), name).encode() for name, params in calls.items()]
    return Subject(parse, seeds, (xmlrpc.client.Fault,), [*_XML_WORDS, *texts(*api.methods, "/chatter", "TCPROS")])


def _graph() -> Subject:
    """A master's state as the worker reads it: registrations, types, addresses, other Midspan workers."""
    from bridge.adapters.ros1.graph.presence import NodeEntry, others, removal_calls
    from bridge.adapters.ros1.graph.state import MasterReader

    own_node = NodeEntry("o", "d", "/midspan", "http://me/", 1)
    entry = {"owner": "x", "daemon": "d", "node": "/midspan2", "uri": "http://h:1/", "pid": 7}
    state = [[["/chatter", ["/a", "/b"]]], [["/chatter", ["/c"]]], [["/a/service", ["/a"]]]]
    good = [
        [[1, "", state]], [[1, "", [["/chatter", "std_msgs/String"]]]], [[1, "", "run-id"]], [[1, "",
        {"midspan2": entry}]],
        [[1, "", 4711]], [[1, "", "http://h:11311/"]],
    ]  # fmt: skip
    uris = [[[1, "", f"http://{node}:1/"]] for node in "abc"]

    def parse(data: bytes) -> None:
        client = _rpc_client()
        reader = MasterReader(client, "/midspan")
        client.reply = data
        for _ in range(2):
            with contextlib.suppress(Ros1Error):
                state = reader.read()
                entries = others(state, own_node)
                removal_calls(state, entries)
                hash((state.publishers, state.subscribers))
        # also the reply to a request for the addresses of three nodes
        reader._nodes = ("/a", "/b", "/c")
        reader.read()

    seeds = [
        _answer(good),
        _answer([*good, *uris]),
        _answer([*good[:2], {"faultCode": 1, "faultString": "x"}, *good[3:]]),
    ]
    return Subject(
        parse, seeds, (Ros1Error,), [*_XML_WORDS, *texts("<int>1</int>", "<string>/a</string>")], largest=16384
    )


def _http() -> Subject:
    """Responses of a node's HTTP server."""
    from bridge.adapters.ros1_peers import XmlRpcClient

    body = _answer([1, "", 3])

    def parse(data: bytes) -> None:
        client = XmlRpcClient("http://127.0.0.1:1/", 5.0)
        client._http.connect = _refuse  # type: ignore[method-assign]
        with _wire(data) as sock, contextlib.closing(client):
            client._http.sock = sock
            client.call("getPid", "/a")

    head = b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\n"
    seeds = [
        head + b"Content-Length: %d\r\n\r\n" % len(body) + body,
        head + b"Transfer-Encoding: chunked\r\n\r\n%x\r\n" % len(body) + body + b"\r\n0\r\n\r\n",
        head + b"\r\n" + body,
        b"HTTP/1.0 500 Oh\r\n\r\n",
    ]
    tokens = texts(
        "HTTP/1.1 100 Continue\r\n\r\n", "\r\n\r\n", "Content-Length: -1\r\n", "Content-Length: 99999999999\r\n",
        "Transfer-Encoding: chunked\r\n",
        "FFFFFFFFFFFF\r\n", "Connection: close\r\n", "X: " + "y" * 300 + "\r\n", "HTTP/9.9 200\r\n",
        "Content-Length: 1_0\r\n", "-5\r\n",
    )  # fmt: skip
    return Subject(parse, seeds, (Ros1Error,), tokens)


def _refuse() -> None:
    raise ConnectionRefusedError


def _uri() -> Subject:
    """Node addresses from a master."""
    from bridge.adapters.ros1_peers import XmlRpcClient

    def parse(data: bytes) -> None:
        XmlRpcClient(data.decode(errors="replace"), 1.0).close()

    seeds = texts("http://robot:11311/", "http://127.0.0.1:4242", "http://[::1]:80/x", "https://h/", "rosrpc://h:1")
    return Subject(
        parse, seeds, (Ros1Error,), texts("http://", "[", "]", ":", "@", "%00", "\r\n", "//", "65536", "?", "#"), 512
    )


def _names() -> Subject:
    """ROS 1 topic names, converted to valid hub names."""
    from bridge.adapters.ros1.names import MAX_LENGTH, NameTable, hub_name
    from bridge.hub.wire.keys import check_topic

    def parse(data: bytes) -> None:
        name = data.decode(errors="surrogateescape")
        legal = hub_name(name)
        assert len(legal) <= MAX_LENGTH
        assert check_topic(legal) == legal
        assert hub_name(legal) == legal
        table = NameTable()
        table.learn([name])
        assert legal == name or table.side_name(legal) == name

    seeds = texts("/camera/1/image", "/a//b/", "chatter", "/x" * 200, "/é/ü", "", "/", "/_")
    return Subject(parse, seeds, (), texts("/", "//", "0", "_", "%", "*", "#", "$", "\x00"), 600)


def _ledger() -> Subject:
    """The file in the state folder with the owner's ID and the daemon's last ROS 1 node."""
    from bridge.adapters.ros1.graph.presence import Ledger, NodeEntry

    folder = scratch()
    last = NodeEntry("x", "d", "/midspan", "http://h:1/", 7)

    def parse(data: bytes) -> None:
        (folder / "ros1.json").write_bytes(data)
        ledger = Ledger(folder)
        assert ledger.owner
        assert ledger.last is None or isinstance(ledger.last.parameter, str)

    seeds = [json.dumps({"owner": "abc", "last": last.as_dict()}).encode(), b'{"owner": "abc", "last": null}']
    return Subject(parse, seeds, (), [*JSON_WORDS, *texts('"owner":', '"last":', '"uri": 5')])


TARGETS = (
    Target("tcpros_header", 60_000, _header),
    Target("tcpros_greeting", 15_000, _greeting),
    Target("tcpros_frames", 15_000, _frames),
    Target("xmlrpc", 12_000, _xmlrpc),
    Target("slave_api", 8_000, _slave),
    Target("master_graph", 4_000, _graph),
    Target("http", 8_000, _http),
    Target("node_uri", 15_000, _uri),
    Target("ros1_names", 20_000, _names),
    Target("ros1_ledger", 4_000, _ledger),
)
