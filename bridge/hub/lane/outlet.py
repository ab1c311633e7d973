"""The writing end of a lane: the connection to one reader."""

from __future__ import annotations

import contextlib
import errno
import socket
from collections import deque
from collections.abc import Callable
from functools import partial

from bridge.hub.lane.blocks import Blocks, StoredMessage
from bridge.hub.lane.fair_lock import FairLock
from bridge.hub.lane.joining import MAX_JOINED_BYTES
from bridge.hub.lane.loans import Loans
from bridge.hub.lane.numbering import Link
from bridge.hub.lane.queues import KeyQueue, LaneMessage, ReaderQueues
from bridge.hub.lane.wire import BLOCK, BOUND, DATA, FENCE, HEAD, LOAN, MARK, PART, PIECE, SAMPLE, SIZE, TOKEN
from bridge.hub.lane.write_watch import WriteWatch
from bridge.hub.wire.keys import ATTACHMENT_SIZE, pack_attachment

_size = SIZE.pack
_NO_MEMORY = (errno.ENOBUFS, errno.ENOMEM, errno.ETOOMANYREFS)
_MAX_FLUSHED = 64
"""Maximum number of records that `ReaderLink.flush` sends, because its thread also serves other readers."""


class Outlet(KeyQueue):
    """The lane of one key to one reader, which the publishers of that key share.

    Attributes:
        number: the number that the reader assigned to the key.
        head: the beginning of each of its messages' records.
        send: sends, joins (`bridge.hub.lane.joining`) or queues a message, given attachment and payload; never blocks.
        lend: lends or queues a large message that is in a block; never blocks.
    """

    def __init__(self, link: ReaderLink, number: int, key: str) -> None:
        super().__init__()
        self.key, self.link, self.number = key, link, number
        self.head = HEAD.pack(DATA, number)
        self.send, self.lend = partial(link.send, self), partial(link.lend, self)

    def record(self, attachment: bytes, payload: bytes) -> bytes:
        """Return the record of a message."""
        return b"".join((self.head, _size(len(payload)), attachment, payload))

    def mark(self, gid: bytes, sequence: int) -> None:
        """Send a mark, which announces that the publisher's messages after this number are sent on this lane."""
        self.link.note(HEAD.pack(MARK, self.number) + pack_attachment(sequence, 0, gid))

    def fence(self, token: bytes) -> None:
        """Return a fence's token to the reader, after everything that was sent before."""
        self.link.fence(self, HEAD.pack(FENCE, self.number) + token[: TOKEN.size])


class ReaderLink:
    """A reader's connection. Safe to use from any thread; never blocks.

    Attributes:
        fast: joins and sends small messages, while it is ``ready``: nothing is queued, and the link is open.

    Args:
        sock: a connected, non-blocking socket.
        watch: called with True when data is queued or the link has ended, and with False when the queues are empty
            again; after True, `flush` must be called while the socket is writable.
        blocks: the session's blocks.
        later: calls a function after some seconds.
    """

    def __init__(
        self, sock: socket.socket, watch: Callable[[bool], None], blocks: Blocks,
        later: Callable[[float, Callable[[], None]], None],
    ) -> None:  # fmt: skip
        self.sock = sock
        self.outlets: dict[int, Outlet] = {}
        self._watch = WriteWatch(watch, later)
        self._lock = FairLock()
        self._blocks = blocks
        self._queues, self._loans = ReaderQueues[Outlet](), Loans[Outlet](blocks)
        self._notes: deque[bytes] = deque()
        self._closed = self._starved = False
        self.fast = None if Link is None else Link(sock.fileno(), self._unsent)

    @property
    def dropped(self) -> int:
        """Number of dropped messages."""
        return self._queues.dropped

    def send(self, outlet: Outlet, attachment: bytes, payload: bytes) -> None:
        """Send a message; see `Outlet.send`."""
        size = len(payload)
        with self._lock:
            if self._closed:
                return
            if self.fast is not None and self.fast.ready and size <= MAX_JOINED_BYTES and not outlet.command:
                self._queue_joined(self.fast.join(outlet.number, attachment, payload))
                return
            self._flush_joined()
            waits = self._notes or outlet.queue or size > BOUND or (self._queues.due and not outlet.command)
            if not waits and self._put(outlet.record(attachment, payload)):
                return
            if not self._closed:
                self._wait(outlet, LaneMessage(attachment, payload))

    def lend(self, outlet: Outlet, attachment: bytes, stored: StoredMessage) -> None:
        """Lend a message; see `Outlet.lend`."""
        if self._lend_at_once(outlet, attachment, stored):
            return
        payload = stored.to_bytes()  # without the lock, for which a command may wait
        with self._lock:
            if not self._closed:
                self._wait(outlet, LaneMessage(attachment, payload))

    def _lend_at_once(self, outlet: Outlet, attachment: bytes, stored: StoredMessage) -> bool:
        """Lend a message; return False if it has to be queued."""
        with self._lock:
            self._flush_joined()
            may_lend = outlet.may_lend and self._loans.has_room(len(stored))
            waits = self._queues.due or self._notes or outlet.queue or not may_lend
            return self._closed or (not waits and self._lend(outlet, attachment, stored))

    def _unsent(self) -> None:
        """Queue the joined messages, which ``fast`` could not send."""
        with self._lock:
            self._flush_joined()
            self._settle()

    def _queue_joined(self, record: bytes | None) -> None:
        """Queue the messages of a record, unless it can be sent now; do nothing for None."""
        if record is None or self._closed:
            return
        if not self._queues.due and not self._notes and self._put(record):
            self._settle()
            return
        at, whole = 0, len(record)
        while at < whole and not self._closed:
            _, number, size, *_ = SAMPLE.unpack_from(record, at)
            begin = at + SAMPLE.size
            outlet = self.outlets.get(number)
            if outlet is not None:
                self._wait(outlet, LaneMessage(record[begin - ATTACHMENT_SIZE : begin], record[begin : begin + size]))
            at = begin + size

    def _flush_joined(self) -> None:
        if self.fast is not None:
            self._queue_joined(self.fast.flush())

    def _settle(self) -> None:
        """Let ``fast`` send if nothing has to be sent before, and watch the socket if something can be sent."""
        if self.fast is not None:
            self.fast.ready = not (self._closed or self._queues.count or self._notes)
        self._watch.want(self._closed or bool(self._queues.due or self._notes))

    def note(self, record: bytes) -> None:
        """Send a record before all queued messages."""
        with self._lock:
            self._flush_joined()
            if not self._closed and (self._notes or not self._put(record)):
                self._notes.append(record)
                self._settle()

    def fence(self, outlet: Outlet, record: bytes) -> None:
        """Send a fence; see `Outlet.fence`."""
        with self._lock:
            self._flush_joined()
            if not self._closed and (outlet.queue or not self._put(record)):
                self._wait(outlet, LaneMessage(b"", b"", record))

    def flush(self) -> None:
        """Send queued messages, commands first.

        Other threads may send between two records, and while a large message is written to a block.
        """
        for _ in range(_MAX_FLUSHED):
            with self._lock:
                outlet = None if self._notes else self._queues.first()
                unstored = None if outlet is None else self._next_to_store(outlet)
                if unstored is None and not self._send_first(outlet):
                    self._settle()
                    return
            if outlet is not None and unstored is not None:
                self._store(outlet, unstored)

    def on_free(self, number: int) -> None:
        """End a loan, and send the messages that waited for it."""
        with self._lock:
            loan = self._loans.end(number)
            due = loan is not None and self._queues.update(loan.queue)
            self._settle()
        if loan is not None:
            self._blocks.release(loan.block)  # without the lock: this may return the block's memory to the system
        if due:
            self.flush()

    def drop_queue(self, outlet: Outlet) -> None:
        """Drop the queue of a key that the reader released."""
        with self._lock:
            self._queues.clear(outlet)
            self._settle()

    def close(self) -> None:
        """Close the connection, which the reader detects. Safe to call twice."""
        with self._lock:
            for outlet in tuple(self.outlets.values()):
                self._queues.clear(outlet)
            self._notes.clear()
            self._loans.lose()
            self._end()
            if self.fast is not None:
                self.fast.close()

    def _end(self) -> None:
        self._closed = True
        with contextlib.suppress(OSError):
            self.sock.shutdown(socket.SHUT_RDWR)
        self._settle()

    def _wait(self, outlet: Outlet, message: LaneMessage) -> None:
        self._queues.add(outlet, message)
        self._settle()

    def _next_to_store(self, outlet: Outlet) -> LaneMessage | None:
        """Return the first message of a queue if it has to be written to a block before it is lent."""
        message = outlet.queue[0]
        waits = message.lends and not message.begun and message.stored is None
        if not waits or self._closed or not self._loans.has_room(len(message.payload)):
            return None
        message.begun = True
        return message

    def _store(self, outlet: Outlet, message: LaneMessage) -> None:
        """Write a queued message to a block, without the lock, for which a command may wait."""
        stored = self._blocks.store(message.payload)
        with self._lock:
            message.begun, message.lends = False, stored is not None
            if outlet.queue and outlet.queue[0] is message:  # otherwise the reader has released the key, or has ended
                message.stored = stored
                return
        if stored is not None:
            stored.release()

    def _send_first(self, outlet: Outlet | None) -> bool:
        """Send the next note or record of a queue; return False if nothing can be sent now."""
        if self._closed or (outlet is None and not self._notes):
            return False
        sent = self._put(self._notes[0]) if outlet is None else self._send_next(outlet)
        if sent:
            self._watch.on_sent()
        elif self._starved:
            self._watch.pause(self._resume)
        if sent and outlet is None:
            self._notes.popleft()
        return sent

    def _resume(self) -> None:
        with self._lock:
            self._watch.end_pause()

    def _send_next(self, outlet: Outlet) -> bool:
        """Send the next record of a queue; return False if that is impossible now."""
        message = outlet.queue[0]
        if message.fence:
            sent = self._put(message.fence)
        elif len(message.payload) <= BOUND:
            sent = self._put(outlet.record(message.attachment, message.payload))
        else:
            sent = self._send_large(outlet, message)
        if sent and not message.begun:
            self._queues.pop(outlet)
        if sent:
            self._queues.rotate(outlet)
        return sent

    def _send_large(self, outlet: Outlet, message: LaneMessage) -> bool:
        """Lend a message, or send a part if it has no block, or if the system refuses to pass a file."""
        if message.stored is not None and self._loans.has_room(len(message.payload)):
            if self._lend(outlet, message.attachment, message.stored):
                return True
            if not self._starved:
                return False
            message.lends = False
        message.release()
        return self._send_part(outlet, message)

    def _lend(self, outlet: Outlet, attachment: bytes, stored: StoredMessage) -> bool:
        """Lend a message; return False if the socket is full, or the link has ended."""
        block, size = stored.block, len(stored)
        assert block is not None
        loan = LOAN.pack(size, self._loans.next, block.number)
        if not self._put(HEAD.pack(BLOCK, outlet.number) + attachment + loan, block.file):
            return False
        self._loans.begin(outlet, block, size)
        return True

    def _send_part(self, outlet: Outlet, message: LaneMessage) -> bool:
        whole, at = len(message.payload), message.at
        piece = message.payload[at : at + BOUND]
        if not self._put(HEAD.pack(PART, outlet.number) + message.attachment + PIECE.pack(whole, at) + piece):
            return False
        message.at += len(piece)
        message.begun = message.at < whole
        return True

    def _put(self, record: bytes, file: int | None = None) -> bool:
        """Write a record, with a file, to the socket; return False if that is impossible now, or the link has ended."""
        self._starved = False
        try:
            if file is None:
                self.sock.send(record)
            else:
                socket.send_fds(self.sock, [record], [file])
        except BlockingIOError:
            return False
        except OSError as err:
            self._starved = err.errno in _NO_MEMORY
            if not self._starved:
                self._end()  # so that the reader does not wait for more
            return False
        return True
