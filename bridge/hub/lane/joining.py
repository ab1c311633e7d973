"""Joins the small messages that a thread reads between two waits into one record for each reader of a lane.

This needs no timer, because a thread that reads connections sends the joined messages before it waits again. So a
message waits only while other messages that have already arrived are processed, at most `MAX_JOINED` of them. Without
the compiled module (``links.c``) no messages are joined.
"""

from __future__ import annotations

from bridge.hub.lane import numbering

MAX_JOINED = 8
"""Maximum number of messages in one record; as in ``links.c``."""

MAX_LINKS = 8
"""Maximum number of readers to which C sends a publisher's messages; as in ``links.c``."""

MAX_JOINED_BYTES = 4096
"""Maximum size in bytes of a payload that is joined with others; as in ``links.h``."""


def flush_joined() -> None:
    """Send this thread's joined messages; called before the thread may have to wait."""
    if numbering.flush is not None:
        numbering.flush()


class Joining:
    """Joins the messages of the thread that creates it, which calls `flush` each time before it waits, until `end`."""

    def __init__(self) -> None:
        if numbering.join is not None:
            numbering.join(True)

    def flush(self) -> None:
        """Send the joined messages."""
        flush_joined()

    def end(self) -> None:
        """Send the joined messages, and stop joining."""
        if numbering.join is not None:
            numbering.join(False)
        flush_joined()
