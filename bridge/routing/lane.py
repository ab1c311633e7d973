"""A thread of one route's own, for messages that may have to wait for a slow link of the hub.

zenoh fits a message larger than a packet in between what a congested link still has to send, and waits up to 0.2 s for
that. On a thread that serves all topics of a side, that wait would be everybody's.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

_log = logging.getLogger(__name__)


Message = TypeVar("Message")


class Lane(Generic[Message]):
    """A bounded queue and the thread that empties it, made when the first message comes. The oldest make room.

    Args:
        name: of the thread.
        depth: messages that wait at most.
        room: bytes that wait at most, but for the newest message.
        carry: called with each message, in order.
        dropped: called for each one that made room.
    """

    def __init__(
        self, name: str, depth: int, room: int, carry: Callable[[Message], None], dropped: Callable[[], None]
    ) -> None:
        self._name, self._depth, self._room = name, depth, room
        self._carry, self._dropped = carry, dropped
        self._condition = threading.Condition()
        self._queue: deque[tuple[int, Message]] = deque()
        self._bytes = 0
        self._carrying = self._closed = False
        self._thread: threading.Thread | None = None

    @property
    def busy(self) -> bool:
        """Whether a message waits or is under way, so that a later one must wait for its turn."""
        return bool(self._queue) or self._carrying  # in this order: `_run` sets the one before it empties the other

    def put(self, message: Message, size: int) -> None:
        """Queue a message of so many bytes."""
        with self._condition:
            if self._closed:
                return
            self._add(message, size)
            while len(self._queue) > self._depth or (self._bytes > self._room and len(self._queue) > 1):
                self._bytes -= self._queue.popleft()[0]
                self._dropped()

    def offer(self, message: Message, size: int) -> bool:
        """Queue a message of so many bytes where there is room for it, and make none; whether it was queued."""
        with self._condition:
            full = len(self._queue) >= self._depth or (self._queue and self._bytes + size > self._room)
            if self._closed or full:
                return False
            self._add(message, size)
            return True

    def _add(self, message: Message, size: int) -> None:
        self._queue.append((size, message))
        self._bytes += size
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()
        self._condition.notify()

    def close(self) -> None:
        """Drop what waits, and end the thread. Safe to call twice."""
        with self._condition:
            self._closed = True
            self._queue.clear()
            self._condition.notify()
        if self._thread is not None:
            self._thread.join(2.0)

    def _run(self) -> None:
        while True:
            with self._condition:
                self._carrying = False
                while not self._queue and not self._closed:
                    self._condition.wait()
                if self._closed:
                    return
                self._carrying = True
                size, message = self._queue.popleft()
                self._bytes -= size
            try:
                self._carry(message)
            except Exception:
                _log.exception("%s: one message failed", self._name)
