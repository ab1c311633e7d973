"""Waiting that can be ended from outside: for a while, or for good."""

from __future__ import annotations

import threading


class Gate:
    """What places share where threads wait for messages; they wait on ``_changed``."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._closed = False
        self._interrupted = False

    @property
    def is_closed(self) -> bool:
        """Whether nothing will come any more."""
        return self._closed

    def wake(self) -> None:
        """Have whoever waits look whether it should go."""
        with self._changed:
            self._changed.notify_all()

    def interrupt(self) -> None:
        """Let whoever waits for a message go, until `resume`."""
        with self._changed:
            self._interrupted = True
            self._changed.notify_all()

    def resume(self) -> None:
        """Let readers wait again."""
        with self._changed:
            self._interrupted = False

    def close(self) -> None:
        """Let everybody go, for good."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
