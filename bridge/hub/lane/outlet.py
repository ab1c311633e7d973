"""The writing end of a lane: the connection to one reader."""

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
from bridge.hub.lane.loans import Loans
from bridge.hub.lane.numbering import Link
from bridge.hub.lane.queues import KeyQueue, LaneMessage, ReaderQueues
from bridge.hub.lane.wire import BLOCK, BOUND, DATA, FENCE, HEAD, LOAN, MARK, PART, PIECE, SAMPLE, SIZE, TOKEN
from bridge.hub.wire.keys import ATTACHMENT_SIZE, pack_attachment

_size = SIZE.pack
_NO_MEMORY = (errno.ENOBUFS, errno.ENOMEM, errno.ETOOMANYREFS)


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
            again; after True, `flush` must be called when the socket is writable again.
        blocks: the session's blocks.
    """

    def __init__(self, sock: socket.socket, watch: Callable[[bool], None], blocks: Blocks) -> None:
        self.sock = sock
        self.outlets: dict[int, Outlet] = {}
        self._watch = watch
        self._lock = Lock()
        self._queues, self._loans = ReaderQueues[Outlet](), Loans[Outlet](blocks)
        self._notes: deque[bytes] = deque()
        self._closed = False
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
            waits = self._queues.due or self._notes or outlet.queue or size > BOUND
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
            self._ready()

    def _queue_joined(self, record: bytes | None) -> None:
        """Queue the messages of a record, unless it can be sent now; None: there is none."""
        if record is None or self._closed:
            return
        if not self._queues.due and not self._notes and self._put(record):
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
            self.fast.ready = not (self._closed or self._queues.count or self._notes)

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
                self._wait(outlet, LaneMessage(b"", b"", record))

    def flush(self) -> None:
        """Send the queued messages, commands first."""
        with self._lock:
            while self._notes:
                if not self._put(self._notes[0]):
                    return
                self._notes.popleft()
            for outlet in sorted(self._queues.due, key=lambda each: not each.command):
                while outlet.is_due:
                    if not self._send_next(outlet):
                        return
            self._ready()
            self._watch(False)

    def on_free(self, number: int) -> None:
        """End a loan, and send the messages that waited for it."""
        with self._lock:
            outlet = self._loans.end(number)
            if outlet is None or not self._queues.update(outlet):
                return
        self.flush()

    def drop_queue(self, outlet: Outlet) -> None:
        """Drop the queue of a key that the reader released."""
        with self._lock:
            self._queues.clear(outlet)
            self._ready()

    def close(self) -> None:
        """Close the connection, which the reader detects. Safe to call twice."""
        with self._lock:
            self._closed = True
            self._queues.due.clear()
            self._notes.clear()
            self._loans.lose()
            if self.fast is not None:
                self.fast.close()
        with contextlib.suppress(OSError):
            self.sock.shutdown(socket.SHUT_RDWR)

    def _wait(self, outlet: Outlet, message: LaneMessage) -> None:
        watched = bool(self._queues.due)
        self._queues.add(outlet, message)
        if self._queues.due and not watched:
            self._watch(True)
        self._ready()

    def _send_next(self, outlet: Outlet) -> bool:
        """Send the first message of a queue; return False if the socket is full."""
        message = outlet.queue[0]
        if message.fence:
            sent = self._put(message.fence)
        elif len(message.payload) <= BOUND:
            sent = self._put(outlet.record(message.attachment, message.payload))
        else:  # in parts also if the system refuses to pass the file
            sent = self._lend_queued(outlet, message) or self._send_parts(outlet, message)
        if sent:
            self._queues.pop(outlet)
        return sent

    def _lend_queued(self, outlet: Outlet, message: LaneMessage) -> bool:
        """Lend a queued message; return False if that is impossible."""
        stored = None if message.at else self._loans.store(message.payload)
        if stored is None:
            return False
        with stored:
            return self._lend(outlet, message.attachment, stored)

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
