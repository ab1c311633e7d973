"""The messages that a lane's writer has queued for one reader."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

from bridge.hub.lane.blocks import StoredMessage
from bridge.hub.lane.wire import BOUND

MAX_WAITING = 64 << 20
"""Maximum number of bytes queued for one reader; the newest message of each key is queued in any case."""

MAX_LOANS = 4
"""Maximum number of messages of a key that are lent to one reader; further ones wait until it has returned one."""


class LaneMessage:
    """A queued message, or the record of a fence.

    Attributes:
        at: number of bytes that were already sent in parts.
        begun: whether it is being written to a block or sent in parts, so that it is no longer dropped.
        lends: whether it may be lent; otherwise it is sent in parts, or as one record if it is small.
        stored: the message in a block, once it can be lent.
    """

    __slots__ = ("at", "attachment", "begun", "fence", "lends", "payload", "stored")

    def __init__(self, attachment: bytes, payload: bytes, fence: bytes = b"") -> None:
        self.attachment, self.payload, self.fence = attachment, payload, fence
        self.at, self.begun, self.lends = 0, False, len(payload) > BOUND
        self.stored: StoredMessage | None = None

    def release(self) -> None:
        """Stop using the block, if the message is in one."""
        stored, self.stored = self.stored, None
        if stored is not None:
            stored.release()


class KeyQueue:
    """The queue of one key for one reader.

    Attributes:
        command: whether its messages are sent before all others.
        depth: maximum number of queued messages.
        dropped: number of dropped messages.
        fences: number of fences among the queued messages.
        loans: number of messages lent to the reader.
        queue: the queued messages and fences.
    """

    def __init__(self) -> None:
        self.command, self.depth = False, 1
        self.queue: deque[LaneMessage] = deque()
        self.dropped = self.fences = self.loans = 0

    @property
    def may_lend(self) -> bool:
        """Whether the reader may have another message at the same time."""
        return self.loans < MAX_LOANS

    @property
    def is_due(self) -> bool:
        """Whether something is queued that does not have to wait until the reader has returned a message."""
        if not self.queue:
            return False
        first = self.queue[0]
        return self.may_lend or len(first.payload) <= BOUND or first.at > 0


Queue = TypeVar("Queue", bound=KeyQueue)


class ReaderQueues(Generic[Queue]):
    """The queues of one reader's keys. Not thread-safe: the lock of the reader's link guards them.

    Attributes:
        due: the queues from which something can be sent once the socket has room, the next one first.
        commands: those of them with commands.
        count: number of queued messages and fences.
        dropped: number of dropped messages.
    """

    def __init__(self) -> None:
        self.due: dict[Queue, None] = {}
        self.commands: dict[Queue, None] = {}
        self.count = self.dropped = 0
        self._bytes = 0

    def add(self, queue: Queue, message: LaneMessage) -> None:
        """Queue a message or a fence, and drop the oldest messages of the key if there are too many.

        A message that has begun is not dropped: otherwise a fast publisher of large messages might never complete one.
        """
        begun = bool(queue.queue) and queue.queue[0].begun
        queue.queue.append(message)
        queue.fences += bool(message.fence)
        self.count += 1
        self._bytes += len(message.payload)
        while (left := len(queue.queue) - queue.fences - begun) > queue.depth or (
            self._bytes > MAX_WAITING and left > 1
        ):
            self._remove(
                queue, next(at for at, queued in enumerate(queue.queue) if not queued.fence and not queued.begun)
            )
            queue.dropped += 1
            self.dropped += 1
        self.update(queue)

    def first(self) -> Queue | None:
        """Return the queue from which to send next; None if none is due."""
        return next(iter(self.commands or self.due), None)

    def rotate(self, queue: Queue) -> None:
        """Let the other queues send before this one."""
        if queue in self.due:
            del self.due[queue]
            self.due[queue] = None

    def pop(self, queue: Queue) -> None:
        """Remove the first message or fence of a queue, which was sent."""
        self._remove(queue, 0)
        self.update(queue)

    def clear(self, queue: Queue) -> None:
        """Remove everything from a queue, without counting it as dropped."""
        while queue.queue:
            self._remove(queue, 0)
        self.update(queue)

    def update(self, queue: Queue) -> bool:
        """Add a queue to the due ones, or remove it, after a change of its messages or loans; return if it is new."""
        before = len(self.due)
        if queue.is_due:
            self.due[queue] = None
            if queue.command:
                self.commands[queue] = None
        else:
            self.due.pop(queue, None)
            self.commands.pop(queue, None)
        return len(self.due) > before

    def _remove(self, queue: Queue, at: int) -> None:
        message = queue.queue[at]
        del queue.queue[at]
        message.release()
        queue.fences -= bool(message.fence)
        self.count -= 1
        self._bytes -= len(message.payload)
