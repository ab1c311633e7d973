"""The network of datagrams of the example side."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator

import pytest

from tests.contract.ownside import Node, free_group

TOPIC, TYPE = "/state", "std_msgs/msg/String"


@pytest.fixture
def node() -> Iterator[Node]:
    node = Node(free_group(), "127.0.0.1", "/node")
    yield node
    node.close()


def test_a_latched_message_that_overtakes_its_publishers_hello_is_requested_again(node: Node) -> None:
    received: list[bytes] = []
    node.open("sub", TOPIC, TYPE, latched=True, take=lambda message, _: received.append(message))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
        program.settimeout(40)
        program.bind(("127.0.0.1", 0))
        address = program.getsockname()
        message = {"from": "abc.1", "topic": TOPIC, "source": "", "number": 5, "message": {"data": "kept"}}
        hello = {
            "hello": "abc",
            "node": "/late",
            "by": "",
            "record": "",
            "ends": {"abc.1": ["pub", TOPIC, TYPE, True, [5]]},
        }
        node._dispatch(message, address)
        assert not received
        node._dispatch(hello, address)
        assert json.loads(program.recv(65536)) == {"again": ["abc.1"]}
        node._dispatch(message, address)
        assert [json.loads(data) for data in received] == [{"data": "kept"}]
