"""Rate limits of routes."""

from __future__ import annotations

import time


class RateLimit:
    """Lets at most ``rate`` messages a second through; what comes sooner is dropped."""

    __slots__ = ("_due", "_period")

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._due = 0.0

    def passes(self) -> bool:
        """Whether a message that arrives now may pass."""
        now = time.monotonic()
        if now < self._due:
            return False
        # A source at nearly the limit's rate jitters; the schedule keeps its phase so that the mean rate is met.
        self._due = max(self._due + self._period, now + self._period / 2)
        return True
