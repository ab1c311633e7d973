"""Asking publishers what they are, the good beside the dead, the slow and the odd."""

import contextlib
import struct
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros1.graph.probe import Facts, Prober
from bridge.adapters.ros1.graph.state import Registration
from bridge.adapters.ros1.handshake import ORIGIN_FIELD, decode, encode, read_exactly
from bridge.adapters.ros1.peer_pool import PeerPool
from bridge.concurrency import DelayedCalls
from tests.adapters.ros1.servers import node, publisher, tcp_server, until_closed
from tests.support.ports import free_port
from tests.support.wait import until

HEADER = {"type": "std_msgs/String", "md5sum": "992c", "message_definition": "string data\n", "latching": "1"}


def asking(pool: PeerPool, timer: DelayedCalls | None = None) -> Any:
    return SimpleNamespace(pool=pool, timer=timer, node=lambda: "/me")


@pytest.fixture
def prober():
    pool = PeerPool()
    made = Prober(asking(pool), lambda _link: None)
    yield made
    pool.stop()


def serve(**more: str):
    def answer(sock) -> None:
        sock.recv(65536)
        sock.sendall(encode({**HEADER, **more}) + b"\xff" * 100_000)
        until_closed(sock)

    return answer


def known(prober, links, link):
    def look() -> Facts | None:
        prober.follow(links)
        return prober.facts().get(link)

    return until(look, f"{link} is known")


def test_what_a_header_says(prober):
    with publisher(serve()) as native, publisher(serve(latching="0", **{ORIGIN_FIELD: "robot2"})) as ours:
        links = frozenset({Registration("/a", "/t", native), Registration("/b", "/t", ours)})
        facts = known(prober, links, Registration("/a", "/t", native))
        assert facts == Facts("std_msgs/String", "992c", "string data\n", latching=True, native=True)
        facts = known(prober, links, Registration("/b", "/t", ours))
        assert (facts.latching, facts.native) == (False, False)
        prober.follow(frozenset())
        assert prober.facts() == {}


def test_one_that_latches_a_moment_later_is_probed_again():
    """``rospy.Publisher`` registers with the master before it enables latching."""
    headers = iter([{"latching": "0"}])

    def answer(sock) -> None:
        sock.recv(65536)
        sock.sendall(encode({**HEADER, **next(headers, {})}))
        until_closed(sock)

    pool, timer = PeerPool(), DelayedCalls("test-timer")
    prober = Prober(asking(pool, timer), lambda _link: None, holds=True)
    try:
        with publisher(answer) as native:
            link = Registration("/a", "/t", native)
            assert not known(prober, frozenset({link}), link).latching
            until(lambda: prober.facts()[link].latching, "its second header is read")
    finally:
        prober.close()
        timer.close()
        pool.stop()


def test_dead_ones_delay_nobody(prober):
    with contextlib.ExitStack() as stack:
        host, port = stack.enter_context(tcp_server(until_closed))
        # a hundred publishers of one node that accepts and says nothing, and some that are gone
        dead = {Registration("/dead", f"/dead{n}", f"http://{host}:{port}/") for n in range(100)}
        dead |= {Registration(f"/gone{n}", "/gone", f"http://127.0.0.1:{free_port()}/") for n in range(5)}
        odd = stack.enter_context(node(requestTopic=lambda *_: "what?"))
        dead.add(Registration("/odd", "/odd", odd))
        dead.add(Registration("/nowhere", "/nowhere", ""))
        prober.follow(frozenset(dead))
        good = Registration("/good", "/t", stack.enter_context(publisher(serve())))
        assert known(prober, frozenset({*dead, good}), good).native
        assert not prober.facts().keys() & dead
        until(lambda: len(prober.troubles()) >= 6, "their troubles are told")
        assert "not a ROS 1 answer" in until(
            lambda: prober.troubles().get(Registration("/odd", "/odd", odd)), "the odd one's"
        )


def test_one_that_comes_late_is_asked_again(prober):
    here = threading.Event()

    def request(_caller, _topic, _protocols) -> list[Any]:
        return [1, "", ["TCPROS", *address]] if here.is_set() else [0, "not yet", 0]

    with tcp_server(serve()) as address, node(requestTopic=request) as uri:
        link = Registration("/late", "/t", uri)
        prober.follow(frozenset({link}))
        until(lambda: prober.troubles().get(link) == "not yet", "it was asked")
        here.set()
        assert known(prober, frozenset({link}), link).native
        assert not prober.troubles()


def test_doubt(prober):
    with publisher(serve()) as uri:
        link = Registration("/a", "/t", uri)
        links = frozenset({link})
        known(prober, links, link)
        prober.doubt(link, "it broke off")
        assert prober.facts() == {}
        assert prober.troubles() == {link: "it broke off"}
        known(prober, links, link)


class YarpPort:
    """A publisher's port as a real YARP 3.9.1 was seen to serve it (``TcpRosCarrier.cpp``, ``PortCoreInputUnit.cpp``).

    It sends the caller's header back with its own name in it, and its type where it knows one. Whatever the header says
    (a field ``probe`` too), the caller is an output from then on, until a message cannot be written to it.
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
def holding():
    """A prober that keeps the connections to native publishers."""
    pool, timer = PeerPool(), DelayedCalls("test")
    made = Prober(asking(pool, timer), lambda _link: None, holds=True)
    yield made
    timer.close()
    pool.stop()
    made.close()


def test_who_waits_for_a_listener_writes_to_the_one_that_asked(holding):
    """A real port of YARP 3.9.1 counted who asked as an output, and its first message went there and nowhere else."""
    port = YarpPort()
    port.type = "std_msgs/String"
    with publisher(port) as uri:
        link = Registration("/talker", "/t", uri)
        facts = known(holding, frozenset({link}), link)
        assert facts == Facts("std_msgs/String", "992c", "string data\n", latching=False, native=True)
        until(lambda: port.outputs, "it counts an output")[0].sendall(b"\4\0\0\0once")
        sock, header = holding.take(link)
        assert holding.take(link) is None
        with sock:
            assert header["callerid"] == "/talker"
            assert read_exactly(sock, 8) == b"\4\0\0\0once"


@pytest.mark.parametrize("end", ["time", "gone", "doubt", "close"])
def test_what_nobody_takes_is_closed(holding, end, monkeypatch):
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
            holding.follow(frozenset())
        elif end == "doubt":
            holding.doubt(link, "it broke off")
        elif end == "close":
            holding.close()
        assert closed.wait(10)
        assert holding.take(link) is None


def test_only_native_publishers_are_kept(holding):
    with publisher(serve(**{ORIGIN_FIELD: "robot2"})) as ours:
        link = Registration("/b", "/t", ours)
        assert not known(holding, frozenset({link}), link).native
        assert holding.take(link) is None


def test_a_port_of_yarp_that_knows_no_type_yet_is_asked_again(prober):
    """It sends our own header back: "*" is no type, and must not be taken for one."""
    port = YarpPort()
    with publisher(port) as uri:
        link = Registration("/talker", "/t", uri)
        links = frozenset({link})
        prober.follow(links)
        until(lambda: "has no type" in prober.troubles().get(link, ""), "it has told no type")
        port.type = "std_msgs/String"
        assert known(prober, links, link).type == "std_msgs/String"
