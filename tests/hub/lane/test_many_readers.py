"""A topic may have more readers on lanes than the path in C serves."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.hub.lane import folder
from bridge.hub.lane.joining import MAX_LINKS
from bridge.hub.lane.wire import DATA, HEAD, MARK, ON, ROOM
from bridge.hub.node import Hub
from tests.peers.hub.endpoints import advertise
from tests.peers.hub.lane import lane_messages
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until


@pytest.fixture
def writer(network: HubNetwork, tmp_path: Path) -> Iterator[Hub]:
    with Hub.open(network.settings("writer", lane=str(tmp_path))) as writer:
        yield writer


def read(path: Path, writer: Hub, key: str) -> socket.socket:
    """Return the connection of a reader that has requested a key."""
    reader = folder.connect(path, writer.zid)
    reader.settimeout(20)
    reader.send(HEAD.pack(ON, 1) + key.encode())
    return reader


def expect(reader: socket.socket, *payloads: bytes) -> None:
    received: list[bytes] = []
    while len(received) < len(payloads):
        record = reader.recv(ROOM)
        if record[0] == DATA:
            received += [message.payload for message in lane_messages(record)]
    assert received == list(payloads)


@pytest.mark.parametrize("count", [MAX_LINKS, MAX_LINKS + 1, MAX_LINKS + 4])
def test_all_publishers_of_a_topic_reach_all_readers(writer: Hub, tmp_path: Path, count: int) -> None:
    first, second = advertise(writer, "/t"), advertise(writer, "/t")
    with contextlib.ExitStack() as stack:
        readers = [stack.enter_context(read(tmp_path, writer, first.key)) for _ in range(count)]
        for reader in readers:
            assert [reader.recv(ROOM)[0], reader.recv(ROOM)[0]] == [MARK, MARK], "each publisher sends a mark"
        until(lambda: len(first._outlets) == len(second._outlets) == count, "the publishers use all lanes")
        third = advertise(writer, "/t")
        for publisher, payload in ((first, b"1"), (second, b"2"), (third, b"3")):
            publisher.put(payload)
        for reader in readers:
            expect(reader, b"1", b"2", b"3")


def test_a_publisher_uses_the_path_in_c_again_when_few_readers_remain(writer: Hub, tmp_path: Path) -> None:
    publishers = [advertise(writer, "/t"), advertise(writer, "/t")]
    with contextlib.ExitStack() as stack:
        readers = [stack.enter_context(read(tmp_path, writer, publishers[0].key)) for _ in range(MAX_LINKS + 3)]
        until(lambda: all(len(p._outlets) == len(readers) for p in publishers), "the publishers use all lanes")
        assert not any(publisher.sender.direct for publisher in publishers)
        for reader in readers[MAX_LINKS:]:
            reader.close()
        until(lambda: all(len(p._outlets) == MAX_LINKS for p in publishers), "the publishers leave three lanes")
        until(lambda: all(p.sender.direct for p in publishers), "both use the path in C")
