"""The XML-RPC server of ROS 1's APIs, and the embedded master: requests, calls, state file."""

from __future__ import annotations

import xmlrpc.client
from typing import Any

from tests.fuzz.target import JSON_WORDS, Subject, Target, scratch, texts

_WORDS = texts(
    "<value>", "</value>", "<array><data>", "</data></array>", "<struct><member><name>a</name>", "</member></struct>",
    "<nil/>", "<int>99999999999</int>", "<i8>1</i8>", "<double>nan</double>", "<boolean>2</boolean>",
    "<base64>A</base64>", "<dateTime.iso8601>x</dateTime.iso8601>", "<bigdecimal>1</bigdecimal>", "&amp;", "&#0;",
    "&#13;", "&a;", "<![CDATA[", '<!DOCTYPE a [<!ENTITY a "b">]>', "<?xml version='1.0' encoding='utf-16'?>", "~", "/",
    "//", "*", "http://h:1/", "ü",
    "<value>" * 200, "<value><array><data>" * 100, "rosrpc://h:2", "system.multicall",
)  # fmt: skip
_CALLS: list[tuple[str, tuple[Any, ...]]] = [
    ("registerPublisher", ("/n", "/t", "std_msgs/String", "http://h:1/")),
    ("unregisterPublisher", ("/n", "/t", "http://h:1/")),
    ("registerSubscriber", ("/m", "t", "*", "http://h:2/")),
    ("unregisterSubscriber", ("/m", "t", "http://h:2/")),
    ("registerService", ("/n", "/s", "rosrpc://h:2", "http://h:1/")),
    ("unregisterService", ("/n", "/s", "rosrpc://h:2")),
    ("lookupNode", ("/n", "/m")),
    ("lookupService", ("/n", "s")),
    ("getPublishedTopics", ("/n", "/ns")),
    ("getSystemState", ("/n",)),
    ("setParam", ("/n", "~p", {"a": [1, 2.5, True, "x"], "b": {}})),
    ("getParam", ("/n", "/")),
    ("searchParam", ("/ns/n", "p/q")),
    ("subscribeParam", ("/n", "http://h:1/", "/p")),
    ("unsubscribeParam", ("/n", "http://h:1/", "/p")),
    ("deleteParam", ("/n", "/n/p")),
    ("hasParam", ("/n", "/n/p/a")),
    ("shutdown", ("/n", "why")),
    *((name, ("/n",)) for name in ("getUri", "getPid", "getParamNames", "getTopicTypes")),
]


def _api() -> Subject:
    """A request's body, the call that it makes, and the body of the response."""
    from bridge.adapters.ros1.master.api import MasterApi
    from bridge.adapters.ros1.xmlrpc_request import Limits, decode_call, encode_response
    from tests.peers.ros1.outbox import RecordedCalls

    api, limits = MasterApi("http://master:1/", RecordedCalls()), Limits(values=500, depth=20)
    seeds = [xmlrpc.client.dumps(params, method).encode() for method, params in _CALLS]
    assert {method for method, _ in _CALLS} == api.methods.keys()
    for method, params in _CALLS:
        assert len(api.methods[method](*params)) == 3

    def parse(data: bytes) -> None:
        method, params = decode_call(data, limits)
        function = api.methods.get(method)
        if function is None:
            return
        code, message, value = function(*params)
        assert code in (-1, 0, 1), code
        assert isinstance(message, str)
        encode_response([code, message, value])
        if len(api.parameters.names()) > 200:
            api.methods["setParam"]("/n", "/", {})
        if len(api.registrations.nodes) > 200:
            for node in list(api.registrations.nodes):
                api.registrations.remove_node(node)
        assert encode_response(api.methods["getSystemState"]("/n"))

    return Subject(parse, seeds, (xmlrpc.client.Fault,), _WORDS)


def _head() -> Subject:
    """A request's HTTP header."""
    from bridge.adapters.ros1.xmlrpc_request import HttpError, parse_head

    def parse(data: bytes) -> None:
        head = parse_head(data, 1000)
        assert 0 <= head.length <= 1000

    line = "POST /RPC2 HTTP/1.1\r\n"
    seeds = texts(
        f"{line}Host: h:1\r\nContent-Type: text/xml\r\nContent-Length: 10",
        f"{line}content-length: 0\r\nConnection: close",
        "POST / HTTP/1.0\r\nConnection: keep-alive\r\nContent-Length: 1000\r\nExpect: 100-continue",
    )  # fmt: skip
    words = texts(
        "\r\n", ":", "Content-Length: 1001", "Content-Length: -1", "Content-Length: 1_0", "Content-Length: ²",
        "Transfer-Encoding: chunked", "Content-Encoding: gzip", "GET", "HTTP/2", "9" * 5000, "\x00",
    )  # fmt: skip
    return Subject(parse, seeds, (HttpError,), words)


def _state() -> Subject:
    """The master's state file."""
    from bridge.adapters.ros1.master import saved
    from bridge.adapters.ros1.master.api import MasterApi
    from tests.peers.ros1.outbox import RecordedCalls

    file = scratch() / "state.json"
    api = MasterApi("", RecordedCalls())
    for method, params in _CALLS[:1] + _CALLS[2:3] + _CALLS[4:5] + _CALLS[10:11] + _CALLS[13:14]:
        api.methods[method](*params)
    api.methods["setParam"]("/n", "/bytes", xmlrpc.client.Binary(b"abc"))
    api.methods["setParam"]("/n", "/time", xmlrpc.client.DateTime("20261126T12:00:00"))

    def parse(data: bytes) -> None:
        file.write_bytes(data)
        loaded = MasterApi("", RecordedCalls())
        if saved.load(file, loaded):
            saved.dump(loaded)

    words = (*JSON_WORDS, b'"PUBLISHER"', b'"SERVICE"', b'"\\u0000binary"', b'"\\u0000time"', b'"version"')
    return Subject(parse, [saved.dump(api).encode()], (), words)


TARGETS = (
    Target("ros1_master_calls", 20_000, _api),
    Target("ros1_request_heads", 5_000, _head),
    Target("ros1_master_state", 1_000, _state),
)
