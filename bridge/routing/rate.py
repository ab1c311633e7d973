"""Rate limits of routes."""

from __future__ import annotations

import time

_ARREARS = 0.1
"""Seconds of silence that are made up for: sources jitter, and come in batches where a machine is busy."""


class RateLimit:
    """Lets at most ``rate`` messages a second through; what comes sooner is dropped.

    The mean of a source that jitters is met: what a short silence left over is let through afterwards, but never two
    messages within half a period.
    """

    __slots__ = ("_due", "_gap", "_least", "_period")

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._least = self._period - max(self._period / 2, _ARREARS)
        self._due = 0.0
        self._gap = 0.0

    def passes(self) -> bool:
        """Whether a message that arrives now may pass."""
        now = time.monotonic()
        if now < self._due or now < self._gap:
            return False
        self._due = max(self._due + self._period, now + self._least)
        self._gap = now + self._period / 2
        return True
