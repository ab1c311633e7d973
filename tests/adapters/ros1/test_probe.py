"""Asking publishers what they are, the good beside the dead, the slow and the odd."""

import contextlib
import threading
from typing import Any

import pytest

from bridge.adapters.ros1.graph import Link
from bridge.adapters.ros1.handshake import ORIGIN_FIELD, encode
from bridge.adapters.ros1.lanes import Lanes
from bridge.adapters.ros1.probe import Facts, Prober
from tests.adapters.ros1.servers import node, publisher, tcp_server, until_closed
from tests.support.ports import free_port
from tests.support.wait import until

HEADER = {"type": "std_msgs/String", "md5sum": "992c", "message_definition": "string data\n", "latching": "1"}


@pytest.fixture
def prober():
    lanes = Lanes()
    made = Prober(lanes, lambda: "/me", lambda _link: None)
    yield made
    lanes.stop()


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
        links = frozenset({Link("/a", "/t", native), Link("/b", "/t", ours)})
        facts = known(prober, links, Link("/a", "/t", native))
        assert facts == Facts("std_msgs/String", "992c", "string data\n", latching=True, native=True)
        facts = known(prober, links, Link("/b", "/t", ours))
        assert (facts.latching, facts.native) == (False, False)
        prober.follow(frozenset())
        assert prober.facts() == {}


def test_dead_ones_delay_nobody(prober):
    with contextlib.ExitStack() as stack:
        host, port = stack.enter_context(tcp_server(until_closed))
        # a hundred publishers of one node that accepts and says nothing, and some that are gone
        dead = {Link("/dead", f"/dead{n}", f"http://{host}:{port}/") for n in range(100)}
        dead |= {Link(f"/gone{n}", "/gone", f"http://127.0.0.1:{free_port()}/") for n in range(5)}
        odd = stack.enter_context(node(requestTopic=lambda *_: "what?"))
        dead.add(Link("/odd", "/odd", odd))
        dead.add(Link("/nowhere", "/nowhere", ""))
        prober.follow(frozenset(dead))
        good = Link("/good", "/t", stack.enter_context(publisher(serve())))
        assert known(prober, frozenset({*dead, good}), good).native
        assert not prober.facts().keys() & dead
        until(lambda: len(prober.troubles()) >= 6, "their troubles are told")
        assert "not a ROS 1 answer" in until(lambda: prober.troubles().get(Link("/odd", "/odd", odd)), "the odd one's")


def test_one_that_comes_late_is_asked_again(prober):
    here = threading.Event()

    def request(_caller, _topic, _protocols) -> list[Any]:
        return [1, "", ["TCPROS", *address]] if here.is_set() else [0, "not yet", 0]

    with tcp_server(serve()) as address, node(requestTopic=request) as uri:
        link = Link("/late", "/t", uri)
        prober.follow(frozenset({link}))
        until(lambda: prober.troubles().get(link) == "not yet", "it was asked")
        here.set()
        assert known(prober, frozenset({link}), link).native
        assert not prober.troubles()


def test_doubt(prober):
    with publisher(serve()) as uri:
        link = Link("/a", "/t", uri)
        links = frozenset({link})
        known(prober, links, link)
        prober.doubt(link, "it broke off")
        assert prober.facts() == {}
        assert prober.troubles() == {link: "it broke off"}
        known(prober, links, link)
