"""Hands messages from the threads of connections to the one that reads, one at a time, without any queue."""

from __future__ import annotations

from yarp_compat.os.gate import Gate
from yarp_compat.ports.message import Message


class Handoff(Gate):
    """A place for one message: who gives waits until it is taken, who takes waits until there is one."""

    def __init__(self) -> None:
        super().__init__()
        self._message: Message | None = None

    def give(self, message: Message) -> bool:
        """Wait until the message was taken; False when the place was closed first."""
        with self._changed:
            self._changed.wait_for(lambda: self._message is None or self._closed)
            if self._closed:
                return False
            self._message = message
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._message is not message or self._closed)
            return self._message is not message

    def take(self, *, will_reply: bool) -> Message | None:
        """Wait for a message; None when interrupted or closed. With ``will_reply`` its sender goes on waiting."""
        with self._changed:
            self._changed.wait_for(lambda: self._message is not None or self._closed or self._interrupted)
            message = self._message
            if message is None or self._closed or self._interrupted:
                return None
            if will_reply and message.wants_reply:
                message.later()
            self._message = None
            self._changed.notify_all()
            return message
