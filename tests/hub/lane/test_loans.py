"""Large messages are lent to the reader of a lane, which has only a limited number of them at a time."""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from bridge.hub.lane import loans as module
from bridge.hub.lane.blocks import Block, Blocks, StoredMessage
from bridge.hub.lane.outlet import Outlet, ReaderLink
from bridge.hub.lane.queues import MAX_LOANS
from bridge.hub.lane.wire import BLOCK, BODY, BOUND, DATA, FENCE, HEAD, LOAN, PART, ROOM, SAMPLE, TOKEN
from bridge.hub.wire.keys import pack_attachment, unpack_attachment

LARGE = 2 * BOUND


class Received(NamedTuple):
    """A record: the message's number and size; of a lent one, the loan, the block and the file."""

    kind: int
    key: int
    number: int
    size: int
    loan: int = 0
    block: int = 0
    file: int = -1


class Lender:
    """A link to a reader with two topics."""

    def __init__(self) -> None:
        self.near, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.near.setblocking(False)
        self.far.setblocking(False)
        self.watched: list[bool] = []
        self.blocks = Blocks(lambda *_: None)
        self.link = ReaderLink(self.near, self.watched.append, self.blocks, lambda *_: None)
        self.images, self.other = Outlet(self.link, 1, "0/images/t/h"), Outlet(self.link, 2, "0/other/t/h")
        self.link.outlets.update({1: self.images, 2: self.other})
        self.files: list[int] = []

    def send(self, number: int, size: int = LARGE, outlet: Outlet | None = None) -> None:
        payload = bytes([number % 256]) * size
        attachment, outlet = pack_attachment(number, 0, bytes(16)), outlet or self.images
        stored = self.blocks.store(payload) if size > BOUND else None
        if stored is None:
            outlet.send(attachment, payload)
        else:
            outlet.lend(attachment, stored)
            stored.release()

    def read(self) -> list[Received]:
        """Return the records that have arrived."""
        found = []
        while True:
            try:
                record, files, _, _ = socket.recv_fds(self.far, ROOM, 4)
            except BlockingIOError:
                return found
            if not record:
                return found
            self.files += files
            kind, key = HEAD.unpack_from(record)
            if kind == BLOCK:
                size, loan, block = LOAN.unpack_from(record, BODY)
                number = unpack_attachment(record[HEAD.size : BODY])[0]
                found.append(Received(kind, key, number, size, loan, block, *files))
            elif kind == DATA:
                found.append(Received(kind, key, SAMPLE.unpack_from(record)[3], SAMPLE.unpack_from(record)[2]))
            else:
                found.append(Received(kind, key, 0, 0))

    def numbers(self) -> list[int]:
        return [record.number for record in self.read()]


@pytest.fixture
def lender() -> Iterator[Lender]:
    lender = Lender()
    yield lender
    lender.link.close()
    lender.blocks.close()
    for file in lender.files:
        os.close(file)
    lender.near.close()
    lender.far.close()
    assert lender.blocks.size == 0, "a block was not released"


def test_a_large_message_is_lent_with_its_file(lender: Lender) -> None:
    lender.send(7)
    (record,) = lender.read()
    assert record[:4] == (BLOCK, 1, 7, LARGE)
    assert os.pread(record.file, LARGE, 0) == bytes([7]) * LARGE
    assert (lender.images.loans, lender.watched) == (1, [])


def test_a_returned_block_is_lent_again(lender: Lender) -> None:
    for number in range(1, 20):
        lender.send(number)
        (record,) = lender.read()
        assert (os.pread(record.file, 1, 0), record.block) == (bytes([number]), 1)
        lender.link.on_free(record.loan)
    assert (lender.blocks.size, lender.images.loans) == (LARGE, 0)


def test_a_reader_that_returns_nothing_has_a_limited_number_of_messages(lender: Lender) -> None:
    """The newest message waits, and is lent as soon as the reader returns another one."""
    for number in range(1, 20):
        lender.send(number)
    lender.link.flush()
    records = lender.read()
    assert [record.number for record in records] == list(range(1, MAX_LOANS + 1))
    assert True not in lender.watched, "the writer does not poll the socket while it waits for the reader"
    assert lender.images.dropped == 19 - MAX_LOANS - 1
    lender.link.on_free(records[0].loan)
    assert lender.numbers() == [19]
    lender.link.on_free(records[0].loan)  # twice
    lender.send(20)
    lender.link.flush()
    assert lender.numbers() == []


def test_messages_of_a_topic_stay_in_order(lender: Lender) -> None:
    lender.images.depth = MAX_LOANS
    for number in range(1, MAX_LOANS + 2):
        lender.send(number)
    lender.send(MAX_LOANS + 2, size=10)
    lender.images.fence(TOKEN.pack(1))
    lender.link.flush()
    records = lender.read()
    assert [record.number for record in records] == list(range(1, MAX_LOANS + 1))
    lender.link.on_free(records[0].loan)
    assert [(record.kind, record.number) for record in lender.read()] == [
        (BLOCK, MAX_LOANS + 1),
        (DATA, MAX_LOANS + 2),
        (FENCE, 0),
    ]


def test_a_small_message_does_not_wait_for_the_reader_in_place_of_a_large_one(lender: Lender) -> None:
    for number in range(1, MAX_LOANS + 2):
        lender.send(number)
    lender.link.flush()
    lender.read()
    lender.send(MAX_LOANS + 2, size=10)
    lender.link.flush()
    assert (lender.numbers(), lender.images.dropped) == ([MAX_LOANS + 2], 1)
    lender.send(MAX_LOANS + 3, size=20)
    assert lender.numbers() == [MAX_LOANS + 3]


def test_a_command_does_not_wait_for_the_copy_of_a_large_message(
    lender: Lender, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(1, MAX_LOANS + 1):
        lender.send(number)
    lender.read()
    lender.other.command = True

    def copy(message: StoredMessage) -> bytes:
        assert not lender.link._lock.locked()
        lender.send(1, size=10, outlet=lender.other)
        return bytes(len(message))

    monkeypatch.setattr(StoredMessage, "to_bytes", copy)
    lender.send(MAX_LOANS + 1)
    assert (lender.numbers(), len(lender.images.queue)) == ([1], 1)


def test_a_command_does_not_wait_until_a_returned_block_is_free(
    lender: Lender, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The block's memory may have to be returned to the system, because another reader was lost."""
    release, locked = Blocks.release, list[bool]()

    def record(blocks: Blocks, block: Block) -> None:
        locked.append(lender.link._lock.locked())
        release(blocks, block)

    lender.send(1)
    (lent,) = lender.read()
    with monkeypatch.context() as patch:
        patch.setattr(Blocks, "release", record)
        lender.link.on_free(lent.loan)
    assert locked == [False]


@pytest.mark.parametrize("queued", [False, True])
def test_a_message_whose_file_the_system_does_not_pass_is_sent_in_parts(
    lender: Lender, monkeypatch: pytest.MonkeyPatch, *, queued: bool
) -> None:
    """The system limits the descriptors in sockets for each user (unix(7), ETOOMANYREFS)."""
    if queued:
        for number in range(1, MAX_LOANS + 1):
            lender.send(number)
    lent = lender.read()

    def refuse(*_: object) -> None:
        raise OSError(errno.ETOOMANYREFS, os.strerror(errno.ETOOMANYREFS))

    monkeypatch.setattr(socket, "send_fds", refuse)
    lender.send(MAX_LOANS + 1)
    if queued:
        lender.link.on_free(lent[0].loan)
    else:
        lender.link.flush()
    assert [record.kind for record in lender.read()] == [PART, PART]
    assert not lender.images.queue
    monkeypatch.undo()
    lender.send(MAX_LOANS + 2)
    assert lender.numbers() == [MAX_LOANS + 2]


def test_other_topics_do_not_wait_for_the_reader_of_large_messages(lender: Lender) -> None:
    for number in range(1, 10):
        lender.send(number)
    lender.link.flush()
    lender.read()
    lender.send(1, size=10, outlet=lender.other)
    assert lender.numbers() == [1]
    lender.send(2, outlet=lender.other)
    assert lender.numbers() == [2]


def test_messages_beyond_the_bytes_of_a_reader_are_sent_in_parts(
    lender: Lender, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_LENT", 2 * LARGE)
    lender.send(1)
    lender.send(2)
    lender.send(1, outlet=lender.other)
    lender.link.flush()
    records = lender.read()
    assert [(record.kind, record.key) for record in records] == [(BLOCK, 1), (BLOCK, 1), (PART, 2), (PART, 2)]
    lender.link.on_free(records[0].loan)
    lender.send(2, outlet=lender.other)
    assert [(record.kind, record.key) for record in lender.read()] == [(BLOCK, 2)]


def test_a_message_beyond_the_bytes_of_a_reader_is_lent_if_it_is_the_only_one(
    lender: Lender, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_LENT", LARGE - 1)
    lender.send(1)
    (record,) = lender.read()
    assert (record.kind, record.number) == (BLOCK, 1)


def test_a_topic_that_the_reader_releases_has_no_message_waiting(lender: Lender) -> None:
    for number in range(1, 10):
        lender.send(number)
    lender.link.flush()
    (first, *_) = lender.read()
    del lender.link.outlets[1]
    lender.link.drop_queue(lender.images)
    lender.link.on_free(first.loan)
    assert lender.numbers() == []


def test_the_blocks_of_a_reader_that_has_ended_are_not_used_again(lender: Lender) -> None:
    lender.send(1)
    (record,) = lender.read()
    lender.link.close()
    assert lender.blocks.size == 0
    other = lender.blocks.store(b"x" * LARGE)
    assert other is not None
    other.release()
    assert os.pread(record.file, 1, 0) == b"\1", "the reader may still read it"
    lender.link.on_free(record.loan)


def test_a_full_socket_queues_a_large_message(lender: Lender) -> None:
    lender.near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 10_000)
    lender.other.depth = 1000
    sent = 0
    while not lender.other.queue:
        sent += 1
        lender.send(sent, size=5000, outlet=lender.other)
    lender.send(1)
    assert lender.images.queue
    arrived: list[Received] = []
    while len(arrived) < sent + 1:
        arrived += lender.read()
        lender.link.flush()
    assert (arrived[-1].kind, arrived[-1].size) == (BLOCK, LARGE)
