"""What came to a buffered port and was not read yet: the newest message only, or in strict mode all of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from yarp_compat.os.gate import Gate
from yarp_compat.ports.message import Message

LIMIT = 64 << 20
"""Bytes that wait in strict mode; whoever sends more, waits for the reader."""


class Inbox(Gate):
    """Messages from the threads of connections to the one that reads."""

    def __init__(self) -> None:
        super().__init__()
        self.strict = False
        self.dropped = 0
        self._messages: deque[Message] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, message: Message) -> None:
        """Keep a message: in strict mode behind the others, else in their place."""
        with self._changed:
            if self.strict:
                self._changed.wait_for(lambda: self._bytes < LIMIT or self._closed)
            else:
                self.dropped += len(self._messages)
                self._messages.clear()
                self._bytes = 0
            if not self._closed:
                self._messages.append(message)
                self._bytes += memoryview(message.payload).nbytes
                self._changed.notify_all()

    def take(self, *, wait: bool, stopped: Callable[[], bool] | None = None) -> Message | None:
        """The oldest message; None when there is none, or when the inbox was closed.

        Args:
            wait: for one to come.
            stopped: tells that waiting should end, looked at after `wake`; by default when the inbox is interrupted.
        """
        over = stopped or (lambda: self._interrupted)
        with self._changed:
            if wait:
                self._changed.wait_for(lambda: self._messages or self._closed or over())
            if self._closed or over() or not self._messages:
                return None
            message = self._messages.popleft()
            self._bytes -= memoryview(message.payload).nbytes
            self._changed.notify_all()
            return message

    def close(self) -> None:
        """Let everybody go, for good."""
        super().close()
        with self._changed:
            self._messages.clear()
            self._bytes = 0
