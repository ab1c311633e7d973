"""The network of examples/own_side, with subscriptions that open while a latched message is published."""

from __future__ import annotations

import json
import socket

import pytest

from tests.contract.ownside import Node, free_group
from tests.support.wait import until


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the publisher live although it announces itself only once."""
    monkeypatch.setattr("datagrams.network.SILENT", 600.0)


def test_a_latched_message_that_arrives_by_two_paths_is_delivered_once() -> None:
    """A message may arrive live and from the cache, in either order. An older message after a newer one is dropped."""
    group = free_group()
    received: list[str] = []
    node = Node(group, "127.0.0.1", "/listener")
    address, _, port = group.partition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as publisher:
        publisher.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        node.open("sub", "/mode", "t", latched=True, take=lambda message, _: received.append(json.loads(message)))
        ends = {"ab.1": ["pub", "/mode", "t", True, []], "ab.2": ["pub", "/mode", "t", False, []]}
        hello = {"hello": "ab", "node": "/publisher", "by": "", "record": "", "ends": ends}
        publisher.sendto(json.dumps(hello).encode(), (address, int(port)))
        for source, number in (("", 2), ("", 2), ("", 1), ("b", 1), ("", 3), ("b", 1)):
            text = f"{source}{number}"
            sent = {"from": "ab.1", "topic": "/mode", "message": text, "source": source, "number": number}
            publisher.sendto(json.dumps(sent).encode(), (address, int(port)))
        sent = {"from": "ab.2", "topic": "/mode", "message": "end"}
        publisher.sendto(json.dumps(sent).encode(), (address, int(port)))
        until(lambda: "end" in received, "all messages are received")
    node.close()
    assert received == ["2", "b1", "3", "end"]


def test_a_lost_latched_message_is_requested_again() -> None:
    """A datagram can be lost. A program that only one side considers dead is received again by that side."""
    group = free_group()
    received: list[str] = []
    node = Node(group, "127.0.0.1", "/listener")
    address, _, port = group.partition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as publisher:
        publisher.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        publisher.settimeout(20)

        def hello(numbers: list[int]) -> None:
            ends = {"ab.1": ["pub", "/mode", "t", True, numbers]}
            text = {"hello": "ab", "node": "/publisher", "by": "", "record": "", "ends": ends}
            publisher.sendto(json.dumps(text).encode(), (address, int(port)))

        node.open("sub", "/mode", "t", latched=True, take=lambda message, _: received.append(json.loads(message)))
        hello([7])  # the datagram with message 7 was lost
        request, listener = publisher.recvfrom(65536)
        assert json.loads(request) == {"again": ["ab.1"]}
        sent = {"from": "ab.1", "topic": "/mode", "message": "on", "source": "", "number": 7}
        publisher.sendto(json.dumps(sent).encode(), listener)
        until(lambda: received == ["on"], "the requested message is received")
        hello([7])
        hello([7, 9])
        assert publisher.recvfrom(65536)[0] == request
        node.close()
        publisher.setblocking(False)
        with pytest.raises(BlockingIOError):
            publisher.recvfrom(65536)  # known messages are not requested
