"""The queues of a reader are sent without delaying its commands, and without using the processor in vain."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from bridge.hub.lane.blocks import Blocks, StoredMessage
from bridge.hub.lane.joining import MAX_JOINED_BYTES
from bridge.hub.lane.outlet import Outlet, ReaderLink
from bridge.hub.lane.queues import MAX_LOANS
from bridge.hub.lane.wire import BLOCK, BODY, BOUND, DATA, HEAD, LOAN, PART, PIECE, ROOM, SAMPLE
from bridge.hub.lane.write_watch import FIRST_PAUSE, LAST_PAUSE
from bridge.hub.wire.keys import pack_attachment
from tests.support.wait import until

LARGE = 2 * BOUND


class Sock(socket.socket):
    """The socket of a link; ``before`` is called with each record before it is sent, and may raise an error."""

    before: Callable[[bytes], None] | None = None

    def send(self, record: bytes, *flags: int) -> int:  # type: ignore[override]
        if self.before is not None:
            self.before(record)
        return super().send(record, *flags)

    def sendmsg(self, buffers: list[bytes], *rest: object) -> int:  # type: ignore[override]
        if self.before is not None:
            self.before(buffers[0])
        return super().sendmsg(buffers, *rest)  # type: ignore[arg-type]


class FullReader:
    """A link to a reader whose socket is full, with the topics ``images``, ``other`` and ``command``."""

    def __init__(self) -> None:
        near, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.near = Sock(fileno=near.detach())
        self.near.setblocking(False)
        self.far.setblocking(False)
        self.watched: list[bool] = []
        self.later: list[tuple[float, Callable[[], None]]] = []
        self.blocks = Blocks(lambda *_: None)
        self.link = ReaderLink(self.near, self.watched.append, self.blocks, lambda *call: self.later.append(call))
        self.images, self.other = Outlet(self.link, 1, "0/images/t/h"), Outlet(self.link, 2, "0/other/t/h")
        self.command = Outlet(self.link, 3, "0/command/t/h")
        self.command.command = True
        self.other.depth = 100
        self.link.outlets.update({1: self.images, 2: self.other, 3: self.command})
        self.fill()

    def fill(self) -> None:
        """Fill the socket, with records without a kind."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self.near.send(bytes(10))

    def send(self, outlet: Outlet, number: int, size: int = MAX_JOINED_BYTES + 1) -> None:
        """Send a message, by default one that is not sent in C."""
        outlet.send(pack_attachment(number, 0, bytes(16)), bytes([number % 256]) * size)

    def lend(self, number: int) -> None:
        with stored(self.blocks, number) as message:
            self.images.lend(pack_attachment(number, 0, bytes(16)), message)

    def read(self) -> list[tuple[int, int, int]]:
        """Return kind, key, and number, loan or offset of each record that has arrived, except those that filled."""
        records: list[tuple[int, int, int]] = []
        with contextlib.suppress(BlockingIOError):
            while received := socket.recv_fds(self.far, ROOM, 4):
                record, files, *_ = received
                if not record:
                    break
                for file in files:
                    os.close(file)
                if record[0]:
                    kind, key = HEAD.unpack_from(record)
                    records.append((kind, key, detail(kind, record)))
        return records


def detail(kind: int, record: bytes) -> int:
    if kind == BLOCK:
        return int(LOAN.unpack_from(record, BODY)[1])
    return int(PIECE.unpack_from(record, BODY)[1] if kind == PART else SAMPLE.unpack_from(record)[3])


def stored(blocks: Blocks, number: int) -> StoredMessage:
    message = blocks.store(bytes([number]) * LARGE)
    assert message is not None
    return message


@pytest.fixture
def reader() -> Iterator[FullReader]:
    full = FullReader()
    yield full
    full.near.before = None
    full.link.close()
    full.blocks.close()
    full.near.close()
    full.far.close()
    assert full.blocks.size == 0, "a block was not released"


def test_a_command_does_not_wait_until_a_queued_message_is_in_a_block(
    reader: FullReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Blocks.store

    def send_meanwhile(blocks: Blocks, payload: bytes) -> StoredMessage | None:
        assert not reader.link._lock.locked()
        reader.send(reader.command, 1)
        return store(blocks, payload)

    reader.send(reader.images, 1, LARGE)
    reader.read()
    monkeypatch.setattr(Blocks, "store", send_meanwhile)
    reader.link.flush()
    assert reader.read() == [(DATA, 3, 1), (BLOCK, 1, 1)]


def test_a_command_is_sent_between_the_parts_of_a_message(reader: FullReader) -> None:
    reader.blocks.close()
    commands = threading.Thread(target=reader.send, args=(reader.command, 1))

    def send_command(_record: bytes) -> None:
        reader.near.before = None
        commands.start()
        until(lambda: reader.link._lock._next.locked(), "the command waits for the lock")

    reader.send(reader.images, 1, 3 * BOUND)
    reader.read()
    reader.near.before = send_command
    reader.link.flush()
    commands.join()
    assert reader.read() == [(PART, 1, 0), (DATA, 3, 1), (PART, 1, BOUND), (PART, 1, 2 * BOUND)]


def test_small_messages_are_sent_between_the_parts_of_a_message(reader: FullReader) -> None:
    reader.blocks.close()
    reader.send(reader.images, 1, 3 * BOUND)
    reader.send(reader.other, 1)
    reader.send(reader.other, 2)
    reader.read()
    reader.link.flush()
    parts = [(PART, 1, BOUND * at) for at in range(3)]
    assert reader.read() == [parts[0], (DATA, 2, 1), parts[1], (DATA, 2, 2), parts[2]]


def test_a_message_for_a_full_socket_is_written_to_a_block_once(
    reader: FullReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    copies: list[int] = []
    store = Blocks.store

    def count(blocks: Blocks, payload: bytes) -> StoredMessage | None:
        copies.append(len(payload))
        return store(blocks, payload)

    monkeypatch.setattr(Blocks, "store", count)
    reader.send(reader.images, 1, LARGE)
    for _ in range(5):
        reader.link.flush()
    assert copies == [LARGE]
    reader.read()
    reader.link.flush()
    assert (reader.read(), copies) == ([(BLOCK, 1, 1)], [LARGE])


def test_a_newer_message_replaces_one_that_is_in_a_block(reader: FullReader) -> None:
    reader.send(reader.images, 1, LARGE)
    reader.link.flush()
    assert reader.blocks.size == LARGE
    reader.send(reader.images, 2)
    reader.read()
    reader.link.flush()
    assert reader.read() == [(DATA, 1, 2)]


def test_a_message_is_completed_although_newer_ones_arrive(reader: FullReader, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Blocks.store

    def send_meanwhile(blocks: Blocks, payload: bytes) -> StoredMessage | None:
        reader.send(reader.images, payload[0] + 1, LARGE)
        return store(blocks, payload)

    reader.send(reader.images, 1, LARGE)
    reader.read()
    with monkeypatch.context() as patch:
        patch.setattr(Blocks, "store", send_meanwhile)
        reader.link.flush()
    assert [kind for kind, _, _ in reader.read()] == [BLOCK] * MAX_LOANS
    assert (reader.images.queue[0].payload[0], reader.images.dropped) == (MAX_LOANS + 1, 0)


def test_a_message_that_is_dropped_while_it_is_written_to_a_block_is_not_sent(
    reader: FullReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Blocks.store

    def drop_meanwhile(blocks: Blocks, payload: bytes) -> StoredMessage | None:
        reader.link.drop_queue(reader.images)
        return store(blocks, payload)

    monkeypatch.setattr(Blocks, "store", drop_meanwhile)
    reader.send(reader.images, 1, LARGE)
    reader.read()
    reader.link.flush()
    assert reader.read() == []


def test_a_returned_loan_for_a_full_socket_is_not_the_end_of_the_queue(reader: FullReader) -> None:
    """The socket may be full although nothing had to be queued for it yet."""
    reader.read()
    for number in range(1, MAX_LOANS + 2):
        reader.lend(number)
    (_, _, loan), *_ = reader.read()
    reader.fill()
    reader.link.on_free(loan)
    assert reader.watched[-1:] == [True], "the rest is sent once the socket is writable"
    reader.read()
    reader.link.flush()
    assert (reader.read(), reader.watched[-1]) == ([(BLOCK, 1, MAX_LOANS + 1)], False)


@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.ENOMEM])
def test_without_memory_for_records_the_socket_is_tried_after_growing_pauses(reader: FullReader, number: int) -> None:
    """The socket is writable, so a watcher would try again at once, and prevent other readers from being served."""

    def refuse(_record: bytes) -> None:
        raise OSError(number, os.strerror(number))

    reader.read()
    reader.near.before = refuse
    reader.send(reader.other, 1)
    pauses: list[float] = []
    for _ in range(10):
        assert reader.watched[-1]
        reader.link.flush()
        assert not reader.watched[-1]
        ((seconds, resume),) = reader.later
        reader.later.clear()
        pauses.append(seconds)
        reader.link.flush()
        assert not reader.later, "only one call is scheduled"
        resume()
    assert pauses[:3] == [FIRST_PAUSE, 2 * FIRST_PAUSE, 4 * FIRST_PAUSE]
    assert pauses[-2:] == [LAST_PAUSE, LAST_PAUSE]
    reader.near.before = None
    reader.send(reader.command, 1)
    assert reader.read() == [(DATA, 3, 1)], "a command does not wait for the end of a pause"
    reader.link.flush()
    assert (reader.read(), reader.watched[-1]) == ([(DATA, 2, 1)], False)
    reader.near.before = refuse
    reader.send(reader.other, 2)
    reader.link.flush()
    assert [seconds for seconds, _ in reader.later] == [FIRST_PAUSE]


def test_other_errors_end_the_connection(reader: FullReader) -> None:
    """Without the end, the reader would wait for messages that are no longer sent."""

    def refuse(_record: bytes) -> None:
        raise OSError(errno.EMSGSIZE, os.strerror(errno.EMSGSIZE))

    reader.read()
    reader.near.before = refuse
    reader.send(reader.other, 1)
    reader.link.flush()
    assert reader.watched[-1], "the watcher detects the end"
    assert reader.far.recv(ROOM) == b""
