"""Joins the small messages that a thread reads between two waits into one record for each reader of a lane.

This needs no timer, because a thread that reads connections sends the joined messages before it waits again. So a
message waits only while other messages that have already arrived are processed, at most `MAX_JOINED` of them.
"""

from __future__ import annotations

import threading
from typing import Protocol

MAX_JOINED = 8
"""Maximum number of messages in one record."""

MAX_JOINED_BYTES = 4096
"""Maximum size in bytes of a payload that is joined with others."""


class JoinedLink(Protocol):
    """A reader's connection with joined messages."""

    def send_joined(self) -> None:
        """Send the joined messages, if there are any."""


class _Thread(threading.local):
    links: dict[JoinedLink, None] | None = None


_thread = _Thread()


def send_later(link: JoinedLink) -> bool:
    """Have this thread send the link's joined messages later; return False if the thread does not join messages."""
    links = _thread.links
    if links is None:
        return False
    links[link] = None
    return True


def flush_joined() -> None:
    """Send this thread's joined messages; called before the thread may have to wait."""
    links = _thread.links
    while links:
        links.popitem()[0].send_joined()


class Joining:
    """Joins the messages of the thread that creates it, which calls `flush` each time before it waits, until `end`."""

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
