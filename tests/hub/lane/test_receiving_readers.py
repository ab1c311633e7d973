"""Which subscriptions receive a lane's messages in C: those that are the only ones of their key."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from bridge.hub.lane.inlet import Inlet
from bridge.hub.lane.receiving import Receiver, Track
from bridge.hub.lane.wire import DATA, HEAD, OFF, ON, ROOM, SAMPLE
from tests.peers.native import GID, RecordingAcceptor
from tests.support.wait import until


class Reader:
    """A subscription; ``by_python`` are the payloads that did not go to its acceptor."""

    def __init__(self, key: str = "key", *, native: bool = True) -> None:
        self.key, self.track, self.acceptor = key, Track(), RecordingAcceptor()
        self.track.sequence = 0
        self.by_python: list[bytes] = []
        self.receiver: Receiver | None = None
        if native:
            self.receiver = Receiver({GID: self.track}, (), ROOM)
            self.receiver.hand_to(self.acceptor)

    @property
    def by_c(self) -> list[bytes]:
        return [payload for _, payload, _ in self.acceptor.accepted]

    def on_message(self, _inlet: Inlet, attachment: tuple[int, int, bytes], payload: bytes) -> None:
        self.track.sequence = attachment[0]
        self.by_python.append(payload)

    def on_mark(self, inlet: Inlet, gid: bytes, sequence: int) -> None:
        raise NotImplementedError

    def on_fence(self, inlet: Inlet) -> None:
        raise NotImplementedError

    def on_large_message(self) -> None:
        raise NotImplementedError


class LaneWriter:
    """The writing end of a lane, and the inlet that reads it."""

    def __init__(self) -> None:
        self.sock, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.sock.settimeout(40)
        self.lost: list[Inlet] = []
        self.inlet = Inlet(far, "zid", self.lost.append, lambda *_: None)
        self.sequence = 0

    def join(self, reader: Reader) -> int:
        """Let a reader join; return its key's number."""
        self.inlet.join(reader)
        kind, number = HEAD.unpack_from(self.sock.recv(ROOM))
        assert kind == ON
        return number

    def send(self, key: int, payload: bytes, *readers: Reader) -> None:
        """Send a message, and wait until these readers have received it."""
        self.sequence += 1
        self.sock.send(SAMPLE.pack(DATA, key, len(payload), self.sequence, 0, GID) + payload)
        for reader in readers:
            until(lambda reader=reader: payload in reader.by_c + reader.by_python, f"{payload!r} is received")

    def close(self) -> None:
        self.sock.close()
        until(lambda: self.lost, "the inlet has ended")


@pytest.fixture
def writer() -> Iterator[LaneWriter]:
    writer = LaneWriter()
    yield writer
    writer.close()


def test_the_only_reader_of_a_key_receives_in_c(writer: LaneWriter) -> None:
    reader = Reader()
    key = writer.join(reader)
    writer.send(key, b"1", reader)
    writer.send(key, b"2", reader)
    assert (reader.by_c, reader.by_python) == ([b"1", b"2"], [])


def test_two_readers_of_a_key_receive_in_python_until_one_leaves(writer: LaneWriter) -> None:
    first, second = Reader(), Reader()
    key = writer.join(first)
    writer.send(key, b"1", first)
    second.track.sequence = 1
    assert writer.join(second) == key
    writer.send(key, b"2", first, second)
    assert (first.by_c, first.by_python, second.by_c, second.by_python) == ([b"1"], [b"2"], [], [b"2"])
    writer.inlet.leave(first)
    writer.send(key, b"3", second)
    assert (second.by_c, second.by_python) == ([b"3"], [b"2"])
    assert (first.by_c, first.by_python) == ([b"1"], [b"2"]), "it has left"


def test_a_reader_that_joins_again_still_receives_in_c(writer: LaneWriter) -> None:
    reader = Reader()
    assert writer.join(reader) == writer.join(reader)
    writer.send(1, b"1", reader)
    assert reader.by_c == [b"1"]


def test_readers_of_different_keys_receive_in_c(writer: LaneWriter) -> None:
    readers = [Reader("a"), Reader("b"), Reader("c", native=False)]
    keys = [writer.join(reader) for reader in readers]
    for number, (reader, key) in enumerate(zip(readers, keys, strict=True)):
        reader.track.sequence = number
        writer.send(key, b"x", reader)
    assert [reader.by_c for reader in readers] == [[b"x"], [b"x"], []]


def test_a_reader_that_has_left_receives_nothing(writer: LaneWriter) -> None:
    reader, other = Reader("a"), Reader("b")
    key, last = writer.join(reader), writer.join(other)
    writer.inlet.leave(reader)
    assert HEAD.unpack(writer.sock.recv(ROOM)) == (OFF, key)
    writer.send(key, b"1")
    other.track.sequence = 1
    writer.send(last, b"2", other)
    assert (reader.by_c, reader.by_python, other.by_c) == ([], [], [b"2"])
