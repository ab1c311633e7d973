"""The shorter path of small messages into the hub, in C (``doorway.c``); None if it was not compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

try:
    from bridge.routing.doorway import Deadline, Doorway
except ImportError:  # there was no compiler, or the system has no lanes
    if not TYPE_CHECKING:
        Doorway = None

        class Deadline:
            """A time on the monotonic clock, in seconds."""

            __slots__ = ("until",)
            until: float


__all__ = ["Deadline", "Doorway"]
