"""The queue between zenoh's threads, which receive messages, and the writer thread; it is limited in bytes."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from threading import Condition, Lock
from typing import NamedTuple

from bridge.client.topics import TopicKey
from bridge.hub.graph.tokens import Origin
from bridge.record.status import RecordedTopic

LARGE = 64 << 10
"""Minimum size in bytes of a large message; large messages leave an eighth of the queue to the others."""

_BATCH = 8 << 20
_OVERHEAD = 512
"""Approximate overhead of a waiting message in bytes."""


@dataclass(slots=True)
class TopicCounts:
    """The counts of a topic's messages.

    Attributes:
        name: the recorded name.
        messages: number of written messages, which were passed to the operating system and can be read.
        bytes: size of their CDR.
        pending: number and bytes of the messages in the chunk that is not written yet.
        dropped: number of dropped messages by reason: ``queue``, ``disk``.
    """

    name: str
    key: TopicKey
    messages: int = 0
    bytes: int = 0
    pending: tuple[int, int] = (0, 0)
    dropped: Counter[str] = field(default_factory=Counter)

    def count_written(self) -> None:
        """Count the pending messages as written."""
        messages, size = self.pending
        self.messages, self.bytes, self.pending = self.messages + messages, self.bytes + size, (0, 0)

    def count_dropped(self, reason: str) -> None:
        """Count the pending messages as dropped."""
        self.dropped[reason] += self.pending[0]
        self.pending = (0, 0)

    def status(self) -> RecordedTopic:
        """Return the entry of the status document."""
        kind, dropped = self.key.type_name, dict(self.dropped)
        return RecordedTopic(topic=self.name, type=kind, messages=self.messages, bytes=self.bytes, dropped=dropped)


class RecordedMessage(NamedTuple):
    """A received message.

    ``gid`` identifies its publisher, ``origin`` the publisher's foreign network; times are in nanoseconds since 1970.
    ``clock_offset`` is the difference of ``log_time`` from a clock that is never set (`bridge.clock.steady_ns`).
    """

    counts: TopicCounts
    gid: bytes
    origin: Origin | None
    sequence: int
    log_time: int
    publish_time: int
    clock_offset: int
    data: bytes


class ArrivalQueue:
    """The waiting messages in order. A full queue drops and counts new messages, large ones first.

    Args:
        limit: maximum size of the waiting messages in bytes.

    Attributes:
        max_bytes: maximum size of the waiting messages so far, in bytes.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._condition = Condition(Lock())
        self._waiting: deque[RecordedMessage] = deque()
        self._bytes = self.max_bytes = 0
        self._batch = min(_BATCH, limit // 4)
        self._woken = self._waits = False

    def has_room(self, size: int) -> bool:
        """Return whether a message of ``size`` bytes would be queued now."""
        return self._bytes + size <= (self._limit - self._limit // 8 if size >= LARGE else self._limit)

    def put(self, arrival: RecordedMessage) -> None:
        """Queue a message. Safe to call from any thread."""
        size = len(arrival.data)
        with self._condition:
            if not self.has_room(size):
                arrival.counts.dropped["queue"] += 1
                return
            self._waiting.append(arrival)
            self._bytes += size + _OVERHEAD
            if self._waits and self._bytes >= self._batch:
                self._waits = False
                self._condition.notify()

    def pop_all(self, seconds: float) -> deque[RecordedMessage]:
        """Return all waiting messages after ``seconds``, or earlier if a batch is full or `wake` is called.

        Only one thread may call it. Messages are batched, because waking the thread for each message would cost more
        than writing it.
        """
        with self._condition:
            if not (self._woken or self._bytes >= self._batch):
                self._waits = True
                self._condition.wait(seconds)
            self._woken = self._waits = False
            waiting, self._waiting = self._waiting, deque()
            self.max_bytes = max(self.max_bytes, self._bytes)
            return waiting

    def release(self, arrival: RecordedMessage) -> None:
        """Free the bytes of a message that `pop_all` returned."""
        with self._condition:
            self._bytes -= len(arrival.data) + _OVERHEAD

    def wake(self) -> None:
        """Make `pop_all` return at once."""
        with self._condition:
            self._woken = True
            self._condition.notify()
