"""Messages that wait until it is known whether their publishers may pass."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

Message = TypeVar("Message")


@dataclass(frozen=True, slots=True, eq=False)
class Waiting(Generic[Message]):
    """A message that waits; ``since``: when it came (monotonic seconds)."""

    source: Hashable
    message: Message
    size: int
    since: float


class Backlog(Generic[Message]):
    """A bounded line of waiting messages, in order of their coming; the oldest make room. For any thread.

    ``most`` messages wait, and ``room`` bytes but for the newest message; ``dropped`` is called for each that goes.
    """

    def __init__(self, most: int, room: int, dropped: Callable[[], None]) -> None:
        self._most, self._room, self._dropped = most, room, dropped
        self._lock = threading.Lock()
        self._line: deque[Waiting[Message]] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._line)

    def add(self, source: Hashable, message: Message, size: int) -> None:
        """Have a message of so many bytes wait."""
        self.put_back(Waiting(source, message, size, time.monotonic()))

    def put_back(self, waiting: Waiting[Message]) -> None:
        """Have a message wait that waited before, behind all others."""
        with self._lock:
            self._line.append(waiting)
            self._bytes += waiting.size
            while len(self._line) > self._most or (self._bytes > self._room and len(self._line) > 1):
                self._bytes -= self._line.popleft().size
                self._dropped()

    def keep(self, source: Hashable, message: Message, size: int, depth: int) -> int:
        """The same where only the newest ``depth`` of a publisher wait; how many older ones of it went."""
        with self._lock:
            older = [waiting for waiting in self._line if waiting.source == source]
            over = older[: max(len(older) - depth + 1, 0)]
            for waiting in over:
                self._line.remove(waiting)
                self._bytes -= waiting.size
        self.add(source, message, size)
        return len(over)

    def take(self, wanted: Callable[[Waiting[Message]], bool]) -> list[Waiting[Message]]:
        """Take out those that are wanted, in their order."""
        if not self._line:
            return []
        with self._lock:
            taken = [waiting for waiting in self._line if wanted(waiting)]
            gone = set(taken)
            self._line = deque(waiting for waiting in self._line if waiting not in gone)
            self._bytes -= sum(waiting.size for waiting in taken)
        return taken
