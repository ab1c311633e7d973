"""The prober handles valid, dead, slow and malformed publishers."""

import contextlib
import socket
import struct
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros1.graph import probe
from bridge.adapters.ros1.graph.probe import Facts, Prober
from bridge.adapters.ros1.graph.state import Registration
from bridge.adapters.ros1.handshake import ORIGIN_FIELD, decode, encode, read_exactly
from bridge.adapters.ros1.peer_pool import PeerPool
from bridge.adapters.ros1_peers import DeadlineSocket
from bridge.concurrency import DelayedCalls
from tests.peers.ros1.servers import node, publisher, tcp_server, until_closed
from tests.support.ports import free_port
from tests.support.wait import until

HEADER = {"type": "std_msgs/String", "md5sum": "992c", "message_definition": "string data\n", "latching": "1"}


def asking(pool: PeerPool, timer: DelayedCalls | None = None) -> Any:
    return SimpleNamespace(pool=pool, timer=timer, node=lambda: "/me")


@pytest.fixture
def prober():
    pool = PeerPool()
    prober = Prober(asking(pool), lambda _link: None)
    yield prober
    pool.stop()


def serve(**more: str):
    def answer(sock) -> None:
        sock.recv(65536)
        sock.sendall(encode({**HEADER, **more}) + b"\xff" * 100_000)
        until_closed(sock)

    return answer


def known(prober, links, link):
    def poll() -> Facts | None:
        prober.update(links)
        return prober.facts().get(link)

    return until(poll, f"{link} is known")


def test_a_publishers_header_gives_type_latching_and_origin(prober):
    with publisher(serve()) as native, publisher(serve(latching="0", **{ORIGIN_FIELD: "robot2"})) as ours:
        links = frozenset({Registration("/a", "/t", native), Registration("/b", "/t", ours)})
        facts = known(prober, links, Registration("/a", "/t", native))
        assert facts == Facts("std_msgs/String", "992c", "string data\n", latching=True, native=True)
        facts = known(prober, links, Registration("/b", "/t", ours))
        assert (facts.latching, facts.native) == (False, False)
        prober.update(frozenset())
        assert prober.facts() == {}


def test_a_publisher_that_latches_slightly_later_is_probed_again(monkeypatch):
    """``rospy.Publisher`` registers with the master before it enables latching."""
    monkeypatch.setattr(probe, "HANDSHAKE_SECONDS", 60.0)  # the second probe is not repeated if it fails
    headers, seen = iter([{"latching": "0"}]), threading.Event()

    def answer(sock) -> None:
        sock.recv(65536)
        first = next(headers, {})
        if not first:
            seen.wait(60)
        sock.sendall(encode({**HEADER, **first}))
        until_closed(sock)

    pool, timer = PeerPool(), DelayedCalls("test-timer")
    prober = Prober(asking(pool, timer), lambda _link: None, holds=True)
    try:
        with publisher(answer) as native:
            link = Registration("/a", "/t", native)
            assert not known(prober, frozenset({link}), link).latching
            seen.set()
            until(lambda: prober.facts()[link].latching, "the publisher's second header is read")
    finally:
        prober.close()
        timer.close()
        pool.stop()


def test_dead_publishers_do_not_delay_others(prober):
    with contextlib.ExitStack() as stack:
        host, port = stack.enter_context(tcp_server(until_closed))
        # a hundred publishers of one node that accepts connections but never responds, and some dead ones
        dead = {Registration("/dead", f"/dead{n}", f"http://{host}:{port}/") for n in range(100)}
        dead |= {Registration(f"/gone{n}", "/gone", f"http://127.0.0.1:{free_port()}/") for n in range(5)}
        odd = stack.enter_context(node(requestTopic=lambda *_: "what?"))
        dead.add(Registration("/odd", "/odd", odd))
        dead.add(Registration("/nowhere", "/nowhere", ""))
        prober.update(frozenset(dead))
        good = Registration("/good", "/t", stack.enter_context(publisher(serve())))
        assert known(prober, frozenset({*dead, good}), good).native
        assert not prober.facts().keys() & dead
        until(lambda: len(prober.failures()) >= 6, "the problems are reported")
        assert "not a ROS 1 answer" in until(
            lambda: prober.failures().get(Registration("/odd", "/odd", odd)), "the malformed publisher is reported"
        )


def test_alternating_failures_are_logged_once_each(prober, caplog: pytest.LogCaptureFixture, monkeypatch):
    monkeypatch.setattr(probe, "HANDSHAKE_SECONDS", 60.0)  # otherwise a suspension would be a third failure
    asked: list[str] = []

    def request(_caller, _topic, _protocols) -> list[Any]:
        asked.append("timed out" if len(asked) % 2 else "no route")
        return [0, asked[-1], 0]

    with caplog.at_level("INFO"), node(requestTopic=request) as uri:
        link = Registration("/flapping", "/t", uri)

        def poll() -> bool:
            prober.update(frozenset({link}))
            return len(asked) > 4

        until(poll, "the publisher is probed several times")
        prober.update(frozenset())  # before the node closes its connections, which would be another failure
    # a probe of an earlier test may still be logged
    reasons = [text.rpartition(": ")[2] for text in caplog.messages if "/flapping" in text]
    assert reasons == ["no route", "timed out"]


def test_a_publisher_that_does_not_respond_yet_is_probed_again(prober):
    listening = threading.Event()

    def request(_caller, _topic, _protocols) -> list[Any]:
        return [1, "", ["TCPROS", *address]] if listening.is_set() else [0, "not yet", 0]

    with tcp_server(serve()) as address, node(requestTopic=request) as uri:
        link = Registration("/late", "/t", uri)
        prober.update(frozenset({link}))
        until(lambda: prober.failures().get(link) == "not yet", "the publisher is probed")
        listening.set()
        assert known(prober, frozenset({link}), link).native
        assert not prober.failures()


def test_a_publisher_whose_facts_were_dropped_is_probed_again(prober):
    with publisher(serve()) as uri:
        link = Registration("/a", "/t", uri)
        links = frozenset({link})
        known(prober, links, link)
        prober.drop_facts(link, "it broke off")
        assert prober.facts() == {}
        assert prober.failures() == {link: "it broke off"}
        known(prober, links, link)


class YarpPort:
    """A publisher's port that behaves like one of YARP 3.9.1 (``TcpRosCarrier.cpp``, ``PortCoreInputUnit.cpp``).

    The port returns the caller's header with its own name, and with its type if known. Whatever the header contains
    (even a field ``probe``), the caller is an output from then on, until a message cannot be written to it.
    """

    def __init__(self) -> None:
        self.type = ""
        self.outputs: list[Any] = []

    def __call__(self, sock: Any) -> None:
        (length,) = struct.unpack("<I", read_exactly(sock, 4))
        header = decode(read_exactly(sock, length))
        known = {"type": self.type, "md5sum": "992c", "message_definition": "string data\n"} if self.type else {}
        sock.sendall(encode({**header, **known, "callerid": "/talker"}))
        self.outputs.append(sock)
        with contextlib.suppress(OSError):
            until_closed(sock)


@pytest.fixture
def holding(monkeypatch):
    """A prober that keeps the connections to native publishers open."""
    monkeypatch.setattr(probe, "HANDSHAKE_SECONDS", 60.0)  # a publisher that is probed twice has two connections
    pool, timer = PeerPool(), DelayedCalls("test")
    prober = Prober(asking(pool, timer), lambda _link: None, holds=True)
    yield prober
    timer.close()
    pool.stop()
    prober.close()


def test_a_publisher_that_waits_for_a_subscriber_writes_to_the_probe(holding, monkeypatch):
    """A real port of YARP 3.9.1 counts the probe as an output, and sends its first message only there."""
    monkeypatch.setattr("bridge.adapters.ros1.graph.probe.HOLD_SECONDS", 60.0)
    port = YarpPort()
    port.type = "std_msgs/String"
    with publisher(port) as uri:
        link = Registration("/talker", "/t", uri)
        facts = known(holding, frozenset({link}), link)
        assert facts == Facts("std_msgs/String", "992c", "string data\n", latching=False, native=True)
        until(lambda: port.outputs, "the port has an output")[0].sendall(b"\4\0\0\0once")
        sock, header = holding.take(link)
        assert holding.take(link) is None
        with sock:
            assert header["callerid"] == "/talker"
            assert read_exactly(sock, 8) == b"\4\0\0\0once"


@pytest.mark.parametrize("end", ["time", "gone", "doubt", "close"])
def test_connections_that_are_not_reused_are_closed(holding, end, monkeypatch):
    monkeypatch.setattr("bridge.adapters.ros1.graph.probe.HOLD_SECONDS", 0.2 if end == "time" else 60.0)
    closed = threading.Event()

    def serve_until_closed(sock) -> None:
        with contextlib.suppress(OSError):
            serve()(sock)
        closed.set()

    with publisher(serve_until_closed) as uri:
        link = Registration("/a", "/t", uri)
        known(holding, frozenset({link}), link)
        if end == "gone":
            holding.update(frozenset())
        elif end == "doubt":
            holding.drop_facts(link, "it broke off")
        elif end == "close":
            holding.close()
        assert closed.wait(60)
        assert holding.take(link) is None


def test_only_connections_to_native_publishers_are_held(holding):
    with publisher(serve(**{ORIGIN_FIELD: "robot2"})) as ours:
        link = Registration("/b", "/t", ours)
        assert not known(holding, frozenset({link}), link).native
        assert holding.take(link) is None


def test_a_yarp_port_without_a_type_is_probed_again(prober):
    """The port returns the received header, whose "*" must not count as a type."""
    port = YarpPort()
    with publisher(port) as uri:
        link = Registration("/talker", "/t", uri)
        links = frozenset({link})
        prober.update(links)
        until(lambda: "has no type" in prober.failures().get(link, ""), "the missing type is reported")
        port.type = "std_msgs/String"
        assert known(prober, links, link).type == "std_msgs/String"


def test_a_connection_of_a_probe_that_ends_after_close_is_closed():
    link, shaken, go_on = Registration("/a", "/t", "http://x:1/"), threading.Event(), threading.Event()
    near, far = socket.socketpair()
    sock = DeadlineSocket.adopt(near, 0.0)

    def shake(*_: object) -> tuple[DeadlineSocket, dict[str, str]]:
        shaken.set()
        assert go_on.wait(20)
        return sock, HEADER

    pool, timer, known = PeerPool(), DelayedCalls("test-later"), threading.Event()
    prober = Prober(asking(pool, timer), lambda _link: known.set(), shake, holds=True)
    with far:
        prober.update(frozenset({link}))
        assert shaken.wait(20)
        timer.close()
        prober.close()
        go_on.set()
        assert known.wait(20)
        pool.stop()
    assert sock.fileno() == -1
