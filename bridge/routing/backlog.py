"""Messages that are held until their publishers are known, or until the worker has the lease."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

Message = TypeVar("Message")


@dataclass(frozen=True, slots=True, eq=False)
class HeldMessage(Generic[Message]):
    """A held message; ``since``: time of its arrival (monotonic seconds)."""

    source: Hashable
    message: Message
    size: int
    since: float


class Backlog(Generic[Message]):
    """A bounded queue of held messages in order of arrival, which drops the oldest. Thread-safe.

    It holds at most ``most`` messages and ``room`` bytes (not counting the newest message), and calls ``dropped`` for
    each message that it drops.

    Attributes:
        line: the held messages; never another object.
    """

    def __init__(self, most: int, room: int, dropped: Callable[[], None]) -> None:
        self._most, self._room, self._dropped = most, room, dropped
        self._lock = threading.Lock()
        self.line: deque[HeldMessage[Message]] = deque()
        self._bytes = 0
        self._judged = 0.0

    def __len__(self) -> int:
        return len(self.line)

    def holds(self, source: Hashable) -> bool:
        """Return whether messages of a publisher are held."""
        if not self.line:
            return False
        with self._lock:
            return any(waiting.source == source for waiting in self.line)

    def add(self, source: Hashable, message: Message, size: int) -> None:
        """Append a message of ``size`` bytes."""
        self.put_back(HeldMessage(source, message, size, time.monotonic()))

    def put_back(self, waiting: HeldMessage[Message]) -> None:
        """Append a message that was held before."""
        with self._lock:
            self.line.append(waiting)
            self._bytes += waiting.size
            while len(self.line) > self._most or (self._bytes > self._room and len(self.line) > 1):
                self._bytes -= self.line.popleft().size
                self._dropped()

    def keep(self, source: Hashable, message: Message, size: int, depth: int) -> int:
        """Append a message, keep only the publisher's newest ``depth`` messages, and return how many were removed."""
        with self._lock:
            older = [waiting for waiting in self.line if waiting.source == source]
            excess = older[: max(len(older) - depth + 1, 0)]
            for waiting in excess:
                self.line.remove(waiting)
                self._bytes -= waiting.size
        self.add(source, message, size)
        return len(excess)

    def overdue(self, seconds: float) -> float:
        """Return the arrival time (monotonic seconds) before which messages are overdue.

        Overdue messages were held for ``seconds``, and already at the last call. So a process that was suspended checks
        for a message's publisher once more before it drops the message.
        """
        now = time.monotonic()
        before, self._judged = min(now - seconds, self._judged), now
        return before

    def pop_matching(self, wanted: Callable[[HeldMessage[Message]], bool]) -> list[HeldMessage[Message]]:
        """Remove and return the messages for which ``wanted`` returns True, in their order."""
        if not self.line:
            return []
        with self._lock:
            popped = [waiting for waiting in self.line if wanted(waiting)]
            for waiting in popped:
                self.line.remove(waiting)
            self._bytes -= sum(waiting.size for waiting in popped)
        return popped
