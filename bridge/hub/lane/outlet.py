"""The writing end of a lane: the connection to one reader, with its queues."""

from __future__ import annotations

import contextlib
import errno
import socket
from collections import deque
from collections.abc import Callable
from functools import partial
from threading import Lock

from bridge.hub.lane.blocks import Blocks, StoredMessage
from bridge.hub.lane.joining import MAX_JOINED_BYTES
from bridge.hub.lane.loans import MAX_LOANS, Loans
from bridge.hub.lane.numbering import Link
from bridge.hub.lane.wire import BLOCK, BOUND, DATA, FENCE, HEAD, LOAN, MARK, PART, PIECE, SAMPLE, SIZE, TOKEN
from bridge.hub.wire.keys import ATTACHMENT_SIZE, pack_attachment

_size = SIZE.pack
_NO_MEMORY = (errno.ENOBUFS, errno.ENOMEM, errno.ETOOMANYREFS)

MAX_WAITING = 64 << 20
"""Maximum number of bytes queued for one reader; the newest message of each key is queued in any case."""


class LaneMessage:
    """A queued message, or the record of a fence; ``at`` is the number of bytes that were already sent in parts."""

    __slots__ = ("at", "attachment", "fence", "payload")

    def __init__(self, attachment: bytes, payload: bytes, fence: bytes = b"") -> None:
        self.attachment, self.payload, self.fence = attachment, payload, fence
        self.at = 0


class Outlet:
    """The lane of one key to one reader, which the publishers of that key share.

    Attributes:
        number: the number that the reader assigned to the key.
        command: whether its messages are sent before all others.
        depth: maximum number of queued messages.
        dropped: number of dropped messages.
        fences: number of fences among the queued messages.
        loans: number of messages lent to the reader.
        head: the beginning of each of its messages' records.
        send: sends, joins (`bridge.hub.lane.joining`) or queues a message, given attachment and payload; never blocks.
        lend: lends or queues a large message that is in a block; never blocks.
    """

    def __init__(self, link: ReaderLink, number: int, key: str) -> None:
        self.key, self.link, self.number = key, link, number
        self.command, self.depth = False, 1
        self.queue: deque[LaneMessage] = deque()
        self.dropped = self.fences = self.loans = 0
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
            again; after True, `flush` must be called when the socket is writable again.
        blocks: the session's blocks.
    """

    def __init__(self, sock: socket.socket, watch: Callable[[bool], None], blocks: Blocks) -> None:
        self.sock = sock
        self.outlets: dict[int, Outlet] = {}
        self.dropped = 0
        self._watch, self._blocks = watch, blocks
        self._lock = Lock()
        # outlets with queued messages: those that can be sent, and those that wait until a loan ends
        self._queued: dict[Outlet, None] = {}
        self._loans, self._parked = Loans(blocks), dict[Outlet, None]()
        self._notes: deque[bytes] = deque()
        self._bytes = 0
        self._closed = False
        self.fast = None if Link is None else Link(sock.fileno(), self._unsent)

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
            waits = self._queued or self._notes or outlet.queue or size > BOUND
            if not waits and self._put(outlet.record(attachment, payload)):
                return
            if not self._closed:
                self._wait(outlet, LaneMessage(attachment, payload))

    def lend(self, outlet: Outlet, attachment: bytes, stored: StoredMessage) -> None:
        """Lend a message; see `Outlet.lend`."""
        with self._lock:
            if self._closed:
                return
            self._flush_joined()
            may_lend = outlet.loans < MAX_LOANS and self._loans.has_room(len(stored))
            waits = self._queued or self._notes or outlet.queue or not may_lend
            if not waits and self._lend(outlet, attachment, stored):
                return
            if not self._closed:
                self._wait(outlet, LaneMessage(attachment, stored.to_bytes()))

    def _unsent(self) -> None:
        """Queue the joined messages, which ``fast`` could not send."""
        with self._lock:
            self._flush_joined()
            self._ready()

    def _queue_joined(self, record: bytes | None) -> None:
        """Queue the messages of a record, unless it can be sent now; None: there is none."""
        if record is None or self._closed:
            return
        if not self._queued and not self._notes and self._put(record):
            self._ready()
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

    def _ready(self) -> None:
        """Let ``fast`` send, unless something else has to be sent before."""
        if self.fast is not None:
            self.fast.ready = not (self._closed or self._queued or self._parked or self._notes)

    def note(self, record: bytes) -> None:
        """Send a record before all queued messages."""
        with self._lock:
            self._flush_joined()
            if self._closed:
                return
            if self._notes or not self._put(record):
                self._notes.append(record)
                self._ready()
                self._watch(True)

    def fence(self, outlet: Outlet, record: bytes) -> None:
        """Send a fence; see `Outlet.fence`."""
        with self._lock:
            self._flush_joined()
            if self._closed:
                return
            if outlet.queue or not self._put(record):
                outlet.queue.append(LaneMessage(b"", b"", record))
                outlet.fences += 1
                self._queued[outlet] = None
                self._ready()
                self._watch(True)

    def flush(self) -> None:
        """Send the queued messages, commands first."""
        with self._lock:
            while self._notes:
                if not self._put(self._notes[0]):
                    return
                self._notes.popleft()
            for outlet in sorted(self._queued, key=lambda each: not each.command):
                while outlet.queue and not self._has_to_wait(outlet):
                    if not self._send_next(outlet):
                        return
                del self._queued[outlet]
                if outlet.queue:
                    self._parked[outlet] = None
            self._ready()
            self._watch(False)

    def on_free(self, number: int) -> None:
        """End a loan, and send the messages that waited for it."""
        with self._lock:
            self._loans.end(number)
            if not self._parked:
                return
            self._queued.update(self._parked)
            self._parked.clear()
        self.flush()

    def drop_queue(self, outlet: Outlet) -> None:
        """Drop the queue of a key that the reader released."""
        with self._lock:
            self._queued.pop(outlet, None)
            self._parked.pop(outlet, None)
            self._bytes -= sum(len(message.payload) for message in outlet.queue)
            outlet.queue.clear()
            outlet.fences = 0
            self._ready()

    def close(self) -> None:
        """Close the connection, which the reader detects. Safe to call twice."""
        with self._lock:
            self._closed = True
            self._queued.clear()
            self._parked.clear()
            self._notes.clear()
            self._loans.lose()
            if self.fast is not None:
                self.fast.close()
        with contextlib.suppress(OSError):
            self.sock.shutdown(socket.SHUT_RDWR)

    def _wait(self, outlet: Outlet, message: LaneMessage) -> None:
        queue = outlet.queue
        queue.append(message)
        self._bytes += len(message.payload)
        while (left := len(queue) - outlet.fences) > outlet.depth or (self._bytes > MAX_WAITING and left > 1):
            at = next(number for number, queued in enumerate(queue) if not queued.fence)
            self._bytes -= len(queue[at].payload)
            del queue[at]
            outlet.dropped += 1
            self.dropped += 1
        if outlet not in self._parked:
            if not self._queued:
                self._watch(True)
            self._queued[outlet] = None
        self._ready()

    def _send_next(self, outlet: Outlet) -> bool:
        """Send the first message of a queue; return False if the socket is full."""
        message = outlet.queue[0]
        if message.fence:
            sent = self._put(message.fence)
        elif len(message.payload) <= BOUND:
            sent = self._put(outlet.record(message.attachment, message.payload))
        elif (stored := self._stored(message)) is not None:
            sent = self._lend(outlet, message.attachment, stored)
            stored.release()
        else:
            sent = self._send_parts(outlet, message)
        if sent:
            outlet.queue.popleft()
            self._bytes -= len(message.payload)
            outlet.fences -= bool(message.fence)
        return sent

    def _has_to_wait(self, outlet: Outlet) -> bool:
        """Return whether the first message of a queue may be sent only when the reader has returned another one."""
        message = outlet.queue[0]
        return outlet.loans >= MAX_LOANS and len(message.payload) > BOUND and not message.at

    def _stored(self, message: LaneMessage) -> StoredMessage | None:
        """Return a queued message in a block, None if it has to be sent in parts."""
        may_lend = not message.at and self._loans.has_room(len(message.payload))
        return self._blocks.store(message.payload) if may_lend else None

    def _lend(self, outlet: Outlet, attachment: bytes, stored: StoredMessage) -> bool:
        """Lend a message; return False if the socket is full, or the link has ended."""
        block, size = stored.block, len(stored)
        assert block is not None
        loan = LOAN.pack(size, self._loans.next, block.number)
        if not self._put(HEAD.pack(BLOCK, outlet.number) + attachment + loan, block.file):
            return False
        self._loans.begin(outlet, block, size)
        return True

    def _send_parts(self, outlet: Outlet, message: LaneMessage) -> bool:
        whole = len(message.payload)
        head = HEAD.pack(PART, outlet.number) + message.attachment
        while message.at < whole:
            piece = message.payload[message.at : message.at + BOUND]
            if not self._put(head + PIECE.pack(whole, message.at) + piece):
                return False
            message.at += len(piece)
        return True

    def _put(self, record: bytes, file: int | None = None) -> bool:
        """Write a record, with a file, to the socket; return False if the socket is full, or the link has ended."""
        try:
            if file is None:
                self.sock.send(record)
            else:
                socket.send_fds(self.sock, [record], [file])
        except BlockingIOError:
            return False
        except OSError as err:
            if err.errno not in _NO_MEMORY:
                self._closed = True
                self._ready()
                self._watch(True)
            return False
        return True
