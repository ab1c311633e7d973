"""Messages queued for a full reader: commands go first, and a full queue drops its oldest messages."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from bridge.hub.lane import queues as module
from bridge.hub.lane.blocks import Blocks
from bridge.hub.lane.joining import MAX_JOINED, MAX_JOINED_BYTES, Joining, flush_joined
from bridge.hub.lane.outlet import Outlet, ReaderLink
from bridge.hub.lane.wire import BODY, BOUND, DATA, FENCE, HEAD, PART, PIECE, ROOM, SAMPLE, TOKEN
from bridge.hub.wire.keys import pack_attachment

GID = bytes(16)


class Pair:
    """A link and the reader's socket."""

    def __init__(self) -> None:
        ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.near, self.far = ends
        self.near.setblocking(False)
        self.far.setblocking(False)
        self.near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 100_000)
        self.watched: list[bool] = []
        self.blocks = Blocks(lambda *_: None)
        self.link = ReaderLink(self.near, self.watched.append, self.blocks, lambda *_: None)
        self.stream, self.command = Outlet(self.link, 1, "0/stream/t/h"), Outlet(self.link, 2, "0/command/t/h")
        self.link.outlets.update({1: self.stream, 2: self.command})
        self.stream.depth, self.command.command = 10, True

    def send(self, outlet: Outlet, number: int, size: int = 1000) -> None:
        outlet.send(pack_attachment(number, 0, GID), bytes(size))

    def fill(self) -> int:
        """Send on the stream until a message waits in the queue; return its number."""
        number = 0
        while not self.stream.queue:
            number += 1
            self.send(self.stream, number)
        return number

    def records(self) -> list[list[tuple[int, int]]]:
        """Return key and number of each message that has arrived, grouped by record."""
        records = []
        while True:
            try:
                record = self.far.recv(ROOM)
            except BlockingIOError:
                return records
            if not record:  # closed
                return records
            if record[0] == DATA:
                records.append(list(messages(record)))

    def read(self) -> list[tuple[int, int]]:
        """Return key and number of each message that has arrived."""
        return [message for record in self.records() for message in record]


def messages(record: bytes) -> Iterator[tuple[int, int]]:
    at = 0
    while at < len(record):
        _, key, size, sequence, _, _ = SAMPLE.unpack_from(record, at)
        yield key, sequence
        at += SAMPLE.size + size


@pytest.fixture
def joining() -> Iterator[Joining]:
    joining = Joining()
    yield joining
    joining.end()


@pytest.fixture
def pair() -> Iterator[Pair]:
    outlet_pair = Pair()
    yield outlet_pair
    outlet_pair.near.close()
    outlet_pair.far.close()


def test_commands_go_first_and_the_oldest_messages_are_dropped(pair: Pair) -> None:
    first = pair.fill()
    for number in range(first + 1, first + 30):
        pair.send(pair.stream, number)
    for number in range(1, 6):
        pair.send(pair.command, number)
    assert pair.watched == [True]
    assert pair.read() == [(1, number) for number in range(1, first)]
    pair.link.flush()
    assert pair.read() == [(2, 5), *((1, number) for number in range(first + 20, first + 30))]
    assert (pair.command.dropped, pair.stream.dropped, pair.link.dropped) == (4, 20, 24)
    assert pair.watched == [True, False]


def test_queue_is_bounded_in_bytes_except_the_newest_message(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_WAITING", 5000)
    last = pair.fill()
    for _ in range(8):
        last += 1
        pair.send(pair.stream, last)
    last += 1
    pair.send(pair.stream, last, BOUND)
    pair.read()
    pair.link.flush()
    assert pair.read() == [(1, last)]
    assert pair.stream.dropped == 9


def test_a_fence_is_not_dropped_and_does_not_overtake(pair: Pair) -> None:
    first = pair.fill()
    pair.stream.fence(TOKEN.pack(7))
    for number in range(first + 1, first + 30):
        pair.send(pair.stream, number)
    while pair.read():
        pass
    pair.link.flush()
    record = pair.far.recv(ROOM)
    assert HEAD.unpack_from(record) == (FENCE, 1)
    assert record[HEAD.size :] == TOKEN.pack(7)
    assert pair.read() == [(1, number) for number in range(first + 20, first + 30)]


def test_small_messages_overtake_parts_of_a_large_one(pair: Pair) -> None:
    pair.blocks.close()
    pair.send(pair.stream, 1, 5 * BOUND + 3)
    pair.link.flush()
    pair.send(pair.command, 1)
    parts, passed = 0, []
    while parts < 5 * BOUND + 3:
        try:
            record = pair.far.recv(ROOM)
        except BlockingIOError:
            pair.link.flush()
            continue
        kind, key = HEAD.unpack_from(record)
        if kind == PART:
            assert PIECE.unpack_from(record, BODY) == (5 * BOUND + 3, parts)
            parts += len(record) - BODY - PIECE.size
        else:
            passed.append(key)
    assert passed == [2], "the command does not wait for the whole message"


def test_messages_sent_before_a_flush_share_a_record(pair: Pair, joining: Joining) -> None:
    other = Outlet(pair.link, 3, "0/other/t/h")
    for number in range(1, MAX_JOINED // 2 + 1):
        pair.send(pair.stream, number, 10)
        pair.send(other, number, 0)
    both = [(key, number) for number in range(1, MAX_JOINED // 2 + 1) for key in (1, 3)]
    assert pair.records() == [both], "a full record does not wait"
    pair.send(pair.stream, 5)
    pair.send(pair.stream, 6)
    assert pair.records() == []
    joining.flush()
    assert pair.records() == [[(1, 5), (1, 6)]]
    pair.send(pair.stream, 7)
    flush_joined()
    assert pair.records() == [[(1, 7)]]


def test_a_record_has_room_for_the_largest_joined_messages(pair: Pair, joining: Joining) -> None:
    for number in range(MAX_JOINED):
        pair.send(pair.stream, number, MAX_JOINED_BYTES)
    assert pair.records() == [[(1, number) for number in range(MAX_JOINED)]]
    pair.send(pair.stream, MAX_JOINED, MAX_JOINED_BYTES + 1)
    assert pair.records() == [[(1, MAX_JOINED)]], "a larger message does not wait"


def test_joined_messages_are_not_overtaken(pair: Pair, joining: Joining) -> None:
    def elsewhere(work: Callable[[], None]) -> None:
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()

    pair.send(pair.stream, 1)
    elsewhere(lambda: pair.send(pair.stream, 2))
    assert pair.records() == [[(1, 1), (1, 2)]], "a thread that does not join messages sends all of them"
    pair.send(pair.stream, 3)
    pair.send(pair.command, 1)
    assert pair.records() == [[(1, 3)], [(2, 1)]], "a command does not wait"
    pair.send(pair.stream, 4)
    pair.send(pair.stream, 5, BOUND)
    assert pair.records() == [[(1, 4)], [(1, 5)]]
    pair.send(pair.stream, 6)
    pair.stream.fence(TOKEN.pack(7))
    assert list(messages(pair.far.recv(ROOM))) == [(1, 6)]
    assert HEAD.unpack_from(pair.far.recv(ROOM)) == (FENCE, 1)


def test_joined_messages_for_a_full_reader_are_queued_and_bounded(pair: Pair, joining: Joining) -> None:
    pair.stream.depth = 3
    number = 0
    while not pair.stream.queue:
        number += 1
        pair.send(pair.stream, number)
        joining.flush()
    for _ in range(2 * MAX_JOINED):
        number += 1
        pair.send(pair.stream, number)
    joining.flush()
    pair.read()
    pair.link.flush()
    assert pair.read() == [(1, number - 2), (1, number - 1), (1, number)]
    assert pair.stream.dropped == 2 * MAX_JOINED - 2


def test_joined_messages_of_a_closed_reader_are_dropped(pair: Pair, joining: Joining) -> None:
    pair.send(pair.stream, 1)
    pair.link.close()
    joining.flush()
    assert not pair.stream.queue
    assert pair.records() == []


def test_nothing_is_sent_to_a_closed_reader(pair: Pair) -> None:
    pair.far.close()
    pair.send(pair.stream, 1)
    pair.send(pair.stream, 2)
    assert not pair.stream.queue
    assert pair.watched == [True], "the socket's watcher detects its end"
