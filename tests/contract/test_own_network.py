"""The network of examples/own_side: what a subscription hears that opens while something latched is published."""

from __future__ import annotations

import json
import socket

import pytest

from tests.contract.ownside import Node, free_group
from tests.support.wait import until


def test_latched_heard_both_ways_comes_once() -> None:
    """Live and again, in either order; an older one after a newer one not at all, of each source."""
    group = free_group()
    heard: list[str] = []
    node = Node(group, "127.0.0.1", "/listener")
    address, _, port = group.partition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as publisher:
        publisher.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        node.open("sub", "/mode", "t", latched=True, take=lambda message, _: heard.append(json.loads(message)))
        for source, number in (("", 2), ("", 2), ("", 1), ("b", 1), ("", 3), ("b", 1)):
            text = f"{source}{number}"
            said = {"from": "ab.1", "topic": "/mode", "message": text, "source": source, "number": number}
            publisher.sendto(json.dumps(said).encode(), (address, int(port)))
        said = {"from": "ab.2", "topic": "/mode", "message": "end"}
        publisher.sendto(json.dumps(said).encode(), (address, int(port)))
        until(lambda: "end" in heard, "all is heard")
    node.close()
    assert heard == ["2", "b1", "3", "end"]


def test_a_latched_message_that_was_lost_is_asked_for_again() -> None:
    """A datagram can be lost; a program that was taken for dead by one side alone is heard again by it."""
    group = free_group()
    heard: list[str] = []
    node = Node(group, "127.0.0.1", "/listener")
    address, _, port = group.partition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as publisher:
        publisher.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        publisher.settimeout(20)

        def hello(numbers: list[int]) -> None:
            ends = {"ab.1": ["pub", "/mode", "t", True, numbers]}
            said = {"hello": "ab", "node": "/publisher", "by": "", "record": "", "ends": ends}
            publisher.sendto(json.dumps(said).encode(), (address, int(port)))

        node.open("sub", "/mode", "t", latched=True, take=lambda message, _: heard.append(json.loads(message)))
        hello([7])  # whose datagram was lost
        asked, listener = publisher.recvfrom(65536)
        assert json.loads(asked) == {"again": ["ab.1"]}
        said = {"from": "ab.1", "topic": "/mode", "message": "on", "source": "", "number": 7}
        publisher.sendto(json.dumps(said).encode(), listener)
        until(lambda: heard == ["on"], "what was asked for is heard")
        hello([7])
        hello([7, 9])
        assert publisher.recvfrom(65536)[0] == asked
        node.close()
        publisher.setblocking(False)
        with pytest.raises(BlockingIOError):
            publisher.recvfrom(65536)  # nothing was asked for that is known
