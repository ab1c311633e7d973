"""Passes messages from connection threads to the reader: one at a time, or through an inbox."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from yarp_compat.interruptible import interruptible
from yarp_compat.overriding import override
from yarp_compat.ports.message import PortMessage


class Gate:
    """The base class of `Handoff` and `Inbox`: threads wait on ``_changed``."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self.is_closed = False  # when set, no message follows
        self._interrupted = False

    def wake(self) -> None:
        """Wake up waiting threads, so that they check whether to continue waiting."""
        with self._changed:
            self._changed.notify_all()

    def interrupt(self) -> None:
        """Release waiting readers, until `resume`."""
        with self._changed:
            self._interrupted = True
            self._changed.notify_all()

    def resume(self) -> None:
        """Let readers wait again."""
        with self._changed:
            self._interrupted = False

    def close(self) -> None:
        """Release all waiting threads permanently."""
        with self._changed:
            self.is_closed = True
            self._changed.notify_all()

    def _wait_for(self, condition: Callable[[], bool]) -> None:
        """Wait on the reader's thread, often the main one, until a condition is true."""
        interruptible(lambda seconds: self._changed.wait_for(condition, seconds))


class Handoff(Gate):
    """A slot for one message: the connection waits until it is read, the reader until one arrives."""

    def __init__(self) -> None:
        super().__init__()
        self._message: PortMessage | None = None

    def deliver(self, message: PortMessage) -> bool:
        """Pass a message to the reader and wait until it is read; return False if the slot was closed first."""
        with self._changed:
            self._changed.wait_for(lambda: self._message is None or self.is_closed)
            if self.is_closed:
                return False
            self._message = message
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._message is not message or self.is_closed)
            return self._message is not message

    def receive(self, *, will_reply: bool) -> PortMessage | None:
        """Wait for a message; return None if interrupted or closed. With ``will_reply`` its sender keeps waiting."""
        with self._changed:
            self._wait_for(lambda: self._message is not None or self.is_closed or self._interrupted)
            message = self._message
            if message is None or self.is_closed or self._interrupted:
                return None
            if will_reply and message.wants_reply:
                message.later()
            self._message = None
            self._changed.notify_all()
            return message


LIMIT = 64 << 20  # bytes of queued messages in strict mode beyond which senders wait for the reader


class Inbox(Gate):
    """A queue of unread messages: the newest only, or in strict mode all of them."""

    def __init__(self) -> None:
        super().__init__()
        self.strict = False
        self.dropped = 0
        self._messages: deque[PortMessage] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, message: PortMessage) -> None:
        """Queue a message: in strict mode after the others, else in their place.

        The sender of a replaced request that waits for a reply gets an empty one.
        """
        with self._changed:
            if self.strict:
                self._changed.wait_for(lambda: self._bytes < LIMIT or self.is_closed)
            else:
                self.dropped += len(self._messages)
                for replaced in self._messages:
                    replaced.give_up()
                self._messages.clear()
                self._bytes = 0
            if not self.is_closed:
                self._messages.append(message)
                self._bytes += memoryview(message.payload).nbytes
                self._changed.notify_all()

    def pop(self, *, wait: bool, stopped: Callable[[], bool] | None = None) -> PortMessage | None:
        """Remove and return the oldest message; None if the inbox is empty or closed. ``wait``: wait for one.

        ``stopped``, checked after `wake`, ends waiting; by default an interrupt does.
        """
        over = stopped or (lambda: self._interrupted)
        with self._changed:
            if wait:
                self._wait_for(lambda: bool(self._messages) or self.is_closed or over())
            if self.is_closed or over() or not self._messages:
                return None
            message = self._messages.popleft()
            self._bytes -= memoryview(message.payload).nbytes
            self._changed.notify_all()
            return message

    @override
    def close(self) -> None:
        """Release all waiting threads permanently, and discard the messages."""
        super().close()
        with self._changed:
            self._messages.clear()
            self._bytes = 0
