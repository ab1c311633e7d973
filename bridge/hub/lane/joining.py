"""Joins the small messages that a thread reads in one go into one record for each reader of a lane.

Without a timer: a thread that reads connections sends what it has joined before it waits again. So a message waits only
while messages are processed that were there before it could be sent, at most `MAX_JOINED` of them.
"""

from __future__ import annotations

import threading
from typing import Protocol

MAX_JOINED = 8
"""Most messages in one record."""

MAX_JOINED_BYTES = 4096
"""Largest payload that is joined with others."""


class JoinedLink(Protocol):
    """A reader's connection with joined messages."""

    def send_joined(self) -> None:
        """Send the joined messages, if there are any."""


class _Thread(threading.local):
    links: dict[JoinedLink, None] | None = None


_thread = _Thread()


def send_later(link: JoinedLink) -> bool:
    """Let this thread send the link's joined messages later; return False if it does not join messages."""
    links = _thread.links
    if links is None:
        return False
    links[link] = None
    return True


def flush_joined() -> None:
    """Send what this thread has joined, before it may wait for something."""
    links = _thread.links
    while links:
        links.popitem()[0].send_joined()


class Joining:
    """Joins the messages of the thread that makes it, which calls `flush` each time before it waits, until `end`."""

    def __init__(self) -> None:
        self._links: dict[JoinedLink, None] = {}
        _thread.links = self._links

    def flush(self) -> None:
        """Send the joined messages."""
        while self._links:
            self._links.popitem()[0].send_joined()

    def end(self) -> None:
        """Send the joined messages, and stop joining."""
        _thread.links = None
        self.flush()
