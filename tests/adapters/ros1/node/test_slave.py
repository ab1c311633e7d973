"""The slave API of a node without a master, called over XML-RPC."""

from __future__ import annotations

import errno
import os
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xmlrpc.client import Binary, Fault, ServerProxy

import pytest

from bridge.adapters.ros1.edge import Ros1Edge
from bridge.adapters.ros1.handshake import connect, encode
from bridge.adapters.ros1.node import node as node_module
from bridge.adapters.ros1.node import plain
from bridge.adapters.ros1.node.address import NodeAddress
from bridge.adapters.ros1.node.plain import PlainNode, PlainNodeEvents
from bridge.adapters.ros1.topics.publication import figure
from bridge.config.model import Config
from bridge.config.sections.ros import Ros1Section
from bridge.config.sections.routing import ParameterRule
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.registry import Registry
from tests.support.wait import until

MASTER = "http://127.0.0.1:9/"
"""An address where nothing listens."""

METHODS = {
    "getBusStats": 0, "getBusInfo": 0, "getMasterUri": 0, "shutdown": 1, "getPid": 0, "getSubscriptions": 0,
    "getPublications": 0, "paramUpdate": 2, "publisherUpdate": 2, "requestTopic": 2, "getUri": 0, "getName": 0,
}  # fmt: skip
"""The methods, each with the number of its parameters after the caller's name."""

NOTHING: list[Any] = [
    0,
    "",
    [],
    {},
    -1,
    1e300,
    True,
    "\u2028ü",
    Binary(b"\0"),
    [[]],
    [["", None]],
    {"a": []},
    "/" * 9999,
]


class Events:
    """The edge's listener."""

    def __init__(self) -> None:
        self.failures: list[str] = []

    def graph_changed(self) -> None: ...

    def presence_changed(self) -> None: ...

    def message_refused(self, topic: str, reason: str, why: str) -> None: ...

    def edge_failed(self, reason: str) -> None:
        self.failures.append(reason)


class Node:
    """An edge, and a client of its slave API."""

    def __init__(self) -> None:
        self.events, self.registry = Events(), Registry()
        self.edge = Ros1Edge(Config(ros1=Ros1Section(master=MASTER)), self.registry, Path(tempfile.mkdtemp()))
        self.edge.start(self.events)
        assert self.edge._node is not None
        self.node = self.edge._node
        self.proxy = ServerProxy(self.node.uri, allow_none=True)

    def call(self, method: str, *params: Any) -> Any:
        return getattr(self.proxy, method)("/caller", *params)

    def value(self, method: str, *params: Any) -> Any:
        code, _, value = self.call(method, *params)
        assert code == 1
        return value

    def close(self) -> None:
        self.proxy("close")()
        self.edge.stop()


@pytest.fixture(scope="module")
def node() -> Iterator[Node]:
    patch = pytest.MonkeyPatch()
    patch.setenv("ROS_IP", "127.0.0.1")
    node = Node()
    patch.undo()
    yield node
    node.close()


@pytest.fixture
def listening(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Make slave APIs fail to listen; return the addresses on which nodes listen for connections."""
    opened: list[tuple[str, int]] = []

    def listen(address: NodeAddress) -> socket.socket:
        listener = real(address)
        opened.append(listener.getsockname())
        return listener

    def fail(*_: Any, **__: Any) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    real = NodeAddress.listen
    monkeypatch.setattr(NodeAddress, "listen", listen)
    for module in (node_module, plain):
        monkeypatch.setattr(module, "XmlRpcServer", fail)
    return opened


def test_a_node_that_cannot_listen_for_the_slave_api_closes_its_other_socket(
    monkeypatch: pytest.MonkeyPatch, listening: list[tuple[str, int]]
) -> None:
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    edge = Ros1Edge(Config(ros1=Ros1Section(master=MASTER)), Registry(), Path(tempfile.mkdtemp()))
    with pytest.raises(RuntimeError, match=r"cannot listen on 127\.0\.0\.1: Too many open files"):
        edge.start(Events())
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(listening[0], 20).close()
    edge.stop()


def test_a_plain_node_that_cannot_listen_for_the_slave_api_closes_its_other_socket_and_thread(
    listening: list[tuple[str, int]],
) -> None:
    events = PlainNodeEvents(lambda _: [], lambda: None, lambda _: None)
    with pytest.raises(OSError, match="Too many open files"):
        PlainNode("/plain", MASTER, NodeAddress("127.0.0.1", "127.0.0.1", False), events, label="unlistening")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(listening[0], 20).close()
    until(lambda: not [t for t in threading.enumerate() if t.name.startswith("unlistening")], "its thread ends")


def test_the_slave_api_returns_process_id_master_name_and_uri(node: Node) -> None:
    assert node.value("getPid") == os.getpid()
    assert node.value("getMasterUri") == MASTER
    assert node.value("getName") == "/midspan"
    assert node.value("getUri") == node.node.uri


def test_the_slave_api_lists_topics_connections_and_statistics(node: Node) -> None:
    text = node.registry.ros1("std_msgs/String")
    publisher = node.edge.advertise("/figures", text, LATCHED)
    subscription = node.edge.subscribe("/read", text, Qos(), lambda *_: None)
    assert ["/figures", "std_msgs/String"] in node.value("getPublications")
    assert ["/read", "*"] in node.value("getSubscriptions")
    publisher.send(b"\1\0\0\0a", "hub")
    sock, header = connect("/reader", node.node.uri, "/figures", 20.0)
    with sock:
        assert (header["latching"], header["callerid"]) == ("1", "/midspan")
        entry = lambda: next(e for e in node.value("getBusStats")[0] if e[0] == "/figures")  # noqa: E731
        ((number, _, _, _),) = until(lambda: entry()[2], "the subscriber is connected")
        publisher.send(b"\2\0\0\0bb", "hub")
        assert entry() == ["/figures", 11, [[number, 9 + 10, 2, True]]]
        (info,) = node.value("getBusInfo")
        assert info[:6] == [number, "/reader", "o", "TCPROS", "/figures", True]
        assert f"on port {node.node.port} to [127.0.0.1:{sock.getsockname()[1]} on socket" in info[6]
    until(lambda: not node.value("getBusInfo"), "the end of the connection is noticed at once")
    assert node.value("getBusStats")[1:] == [[["/read", []]], [0, 0, 0]]
    publisher.close()
    subscription.close()
    assert node.value("getPublications") == node.value("getSubscriptions") == []


def test_statistics_above_32_bits_are_doubles() -> None:
    assert [figure(2**31 - 1), figure(2**31), figure(2**50)] == [2**31 - 1, 2.0**31, 2.0**50]
    assert isinstance(figure(2**31 - 1), int)


def test_udpros_is_refused_and_tcpros_chosen(node: Node) -> None:
    publisher = node.edge.advertise("/ask", node.registry.ros1("std_msgs/String"), Qos())
    udpros = ["UDPROS", Binary(b"\4\0\0\0a=b"), "127.0.0.1", 4242, 1500]
    ready = ["TCPROS", "127.0.0.1", node.node.port]
    assert node.call("requestTopic", "/ask", [udpros, ["TCPROS"]])[2] == ready
    assert node.call("requestTopic", "ask", [["TCPROS"]])[2] == ready, "the name is relative to the caller"
    code, text, value = node.call("requestTopic", "/ask", [udpros])
    assert (code, value) == (0, [])
    assert "TCPROS, not UDPROS" in text
    for odd in ([[]], ["TCPROS"], [[5]], [{}], [None]):
        assert node.call("requestTopic", "/ask", odd)[::2] == [0, []]
    publisher.close()
    code, text, value = node.call("requestTopic", "/ask", [["TCPROS"]])
    assert (code, value) == (-1, [])
    assert "Not a publisher of [/ask]" in text


def test_an_update_is_reported_only_if_a_parameter_is_subscribed(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    woken: list[str] = []
    assert node.call("paramUpdate", "/a", 1)[0] == -1, "no parameter is subscribed"
    monkeypatch.setattr(node.node, "parameter_listeners", {lambda update: not woken.append(update.key)})
    assert node.value("paramUpdate", "/a/", {"b": 1}) == 0
    assert node.value("publisherUpdate", "/a", []) == 0
    assert node.value("publisherUpdate", "/a", ["http://[::1]:4/", "http://b:5/"]) == 0
    assert woken == ["/a/"]


def test_parameter_updates_are_refused_once_the_rules_are_removed(node: Node) -> None:
    rule = ParameterRule(owner="ros2", ros1="/a", node="/b")
    hub: Any = None  # a rule that is not active needs no hub
    stop = node.edge.carry_parameters([rule], hub, lambda: False)
    assert node.value("paramUpdate", "/a/", 1) == 0
    assert node.edge.details()["parameters"]
    stop()
    assert node.call("paramUpdate", "/a/", 1) == [-1, "not subscribed", 0]
    assert node.edge.details() == {}


def test_a_shutdown_request_is_reported_with_its_reason(node: Node) -> None:
    node.events.failures.clear()
    assert node.call("shutdown", "new node registered with same name") == [1, "shutdown", 0]
    assert node.call("shutdown") == [1, "shutdown", 0]
    assert node.events.failures == [
        "/caller requested this node's shutdown: new node registered with same name",
        "/caller requested this node's shutdown",
    ]


@pytest.mark.parametrize(("method", "count"), METHODS.items())
def test_invalid_calls_have_a_code_and_a_value_of_the_right_type(node: Node, method: str, count: int) -> None:
    call: Callable[..., Any] = getattr(node.proxy, method)
    usual = type(call("/caller", *(["/x", []][:count]))[2])
    calls: list[list[Any]] = [[], ["/caller"] * (count + 2), *([odd, *["/x"] * count] for odd in NOTHING)]
    calls += [["/caller", *[odd] * count] for odd in NOTHING if method not in ("shutdown", "paramUpdate")]
    for params in calls:
        code, text, value = call(*params)
        assert isinstance(text, str)
        assert code in (-1, 0, 1)
        assert type(value) is usual
        if not params or not isinstance(params[0], str):
            assert code == -1


@pytest.mark.parametrize(
    ("method", "params", "wanted"),
    [("shutdown", ["why", "more"], "1 or 2"), ("paramUpdate", [], "3"), ("getPid", [1], "1")],
)
def test_a_wrong_number_of_parameters_is_reported_with_the_right_ones(
    node: Node, method: str, params: list[Any], wanted: str
) -> None:
    code, text, _ = node.call(method, *params)
    assert (code, text) == (-1, f"Error: bad call arity: {1 + len(params)} parameters, not {wanted}")


def test_an_unknown_method_is_a_fault(node: Node) -> None:
    with pytest.raises(Fault, match="not supported"):
        node.call("getEverything")
    assert node.value("getPid") == os.getpid()


def test_the_master_is_still_read_after_an_unusable_state(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def fail() -> None:
        calls.append(1)
        raise RecursionError

    assert node.edge._master is not None
    monkeypatch.setattr(node.edge._master, "_poll", fail)
    until(lambda: len(calls) >= 2, "the master is read again")


def test_a_subscribers_name_of_any_bytes_does_not_prevent_tools(node: Node) -> None:
    publisher = node.edge.advertise("/bytes", node.registry.ros1("std_msgs/String"), Qos())
    with socket.create_connection(("127.0.0.1", node.node.port), 20) as sock:
        sock.sendall(encode({"callerid": "/odd\0\x1b", "topic": "/bytes", "md5sum": "*", "type": "*"}))
        until(lambda: any(c.topic == "/bytes" for c in node.edge.connections()), "the subscriber is connected")
        assert "/odd\ufffd\ufffd" in [entry[1] for entry in node.value("getBusInfo")]
    publisher.close()
