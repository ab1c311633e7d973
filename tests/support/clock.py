"""A clock that a test sets; it replaces the module `time` in a tested module."""

from __future__ import annotations


class Clock:
    """The monotonic clock; ``now`` is its time in seconds."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now
