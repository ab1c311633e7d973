"""The shorter path of small messages, in C (``doorway.c``, ``exit.c``); None if it was not compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

try:
    from bridge.routing.doorway import Deadline, Doorway
    from bridge.routing.exit import Exit
except ImportError:  # there was no compiler, or the system has no lanes
    if not TYPE_CHECKING:
        Doorway = Exit = None

        class Deadline:
            """A time on the monotonic clock, in seconds."""

            __slots__ = ("until",)
            until: float


__all__ = ["Deadline", "Doorway", "Exit"]
