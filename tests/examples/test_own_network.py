"""The example side's network, which consists of datagrams."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from typing import Any

import pytest

from tests.contract.ownside import Node, free_group

TOPIC, TYPE = "/state", "std_msgs/msg/String"


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    monkeypatch.setattr("datagrams.network.SILENT", 600.0)  # the other program sends nothing by itself
    node = Node(free_group(), "127.0.0.1", "/node")
    yield node
    node.close()


MESSAGE = {"from": "abc.1", "topic": TOPIC, "source": "", "number": 5, "message": {"data": "kept"}}
HELLO = {
    "hello": "abc", "node": "/late", "by": "", "record": "", "ends": {"abc.1": ["pub", TOPIC, TYPE, True, [5]]},
}  # fmt: skip


@pytest.fixture
def program() -> Iterator[socket.socket]:
    """The socket of another program, to which the node sends its requests."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
        program.settimeout(40)
        program.bind(("127.0.0.1", 0))
        yield program


def requested(node: Node, program: socket.socket) -> bool:
    """Receive a hello of the program; return whether the node requests its latched messages."""
    marker = {"again": ["end"]}
    node._dispatch(HELLO, program.getsockname())
    node._own.sendto(json.dumps(marker).encode(), program.getsockname())
    first = json.loads(program.recv(65536))
    if first != marker:
        assert (first, json.loads(program.recv(65536))) == ({"again": ["abc.1"]}, marker)
    return bool(first != marker)


def test_a_latched_message_that_overtakes_its_publishers_hello_is_requested_again(
    node: Node, program: socket.socket
) -> None:
    received: list[bytes] = []
    node.open("sub", TOPIC, TYPE, latched=True, take=lambda message, _: received.append(message))
    node._dispatch(MESSAGE, program.getsockname())
    assert not received
    assert requested(node, program)
    node._dispatch(MESSAGE, program.getsockname())
    assert [json.loads(data) for data in received] == [{"data": "kept"}]
    assert not requested(node, program)


def test_a_program_that_returns_after_a_silence_has_new_endpoint_ids(node: Node, program: socket.socket) -> None:
    """With the old id, the engine could receive the message before it has removed the previous endpoint.

    That endpoint would still retain the message.
    """
    publishers: list[str] = []
    node.open("sub", TOPIC, TYPE, latched=True, take=lambda _, publisher: publishers.append(publisher))
    for _ in range(2):
        assert requested(node, program)
        node._dispatch(MESSAGE, program.getsockname())
        assert publishers[-1:] == [end.id for end in node.programs["abc"].ends.values()]
        node._on_exit("abc")
    assert len(set(publishers)) == 2


def test_a_message_is_requested_again_if_its_program_is_dropped_meanwhile(
    node: Node, program: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    node.open("sub", TOPIC, TYPE, latched=True, take=lambda *_: None)
    assert requested(node, program)
    is_new = node._is_new

    def dropped_meanwhile(*of: Any) -> bool:
        node._on_exit("abc")
        return is_new(*of)

    with monkeypatch.context() as patch:
        patch.setattr(node, "_is_new", dropped_meanwhile)
        node._dispatch(MESSAGE, program.getsockname())
    assert requested(node, program)
