"""The pace of the simulation: which ticks are due."""

from __future__ import annotations

import math
import time

from sim.base import TICK_NS

_CATCH_UP = 0.05  # seconds to catch up on at once, before messages are handled
_EARLY = 0.002  # seconds by which a tick may be early, since timers are not exact
_FORGIVEN = 0.25  # if the delay exceeds these seconds, missed ticks are left out, so that a base does not rush
_PILED = 0.5  # seconds after a standstill of this process during which queued messages may still arrive
_TICK_WAIT = 0.005  # seconds; shorter ticks run in bundles, and are not counted as late


class Pace:
    """Determines how many ticks are due, and when each was due.

    Args:
        speed: simulated seconds per second.
    """

    def __init__(self, speed: float) -> None:
        self._seconds = TICK_NS / 1e9 / speed
        self._next = -math.inf  # when the next tick is due
        self._owed = 0  # ticks that `due` has counted and `moment` has not reported
        self.begin()
        self.late = 0  # ticks that were late by their duration or more
        self.left_out = 0  # ticks that were skipped because this process stood still
        self._stood = -_PILED

    def begin(self) -> None:
        """Start from now on, so that nothing is due after a pause."""
        self._next = max(self._next, time.monotonic() + self._seconds)

    def stood_still(self) -> bool:
        """Return whether messages that arrive now may have waited while this process stood still."""
        return time.monotonic() - self._stood < _PILED

    def due(self) -> int:
        """Return the number of ticks that are due, and count them as done."""
        now = time.monotonic()
        behind = now - self._next
        if behind > _FORGIVEN:
            missed = int(behind / self._seconds)
            self.left_out += missed
            self._stood = now
            self._next += missed * self._seconds
            behind = now - self._next
        count = int(behind / self._seconds) + 1 if behind > -_EARLY else 0
        count = min(count, max(1, int(_CATCH_UP / self._seconds)))
        self.late += max(0, min(count, int(behind / self._seconds))) if self._seconds >= _TICK_WAIT else 0
        self._next += count * self._seconds
        self._owed = count
        return count

    def moment(self) -> float:
        """Return when the next tick that `due` has counted was due, in seconds of the monotonic clock.

        That is the earliest time at which a tick may run, so it is never in the future.
        """
        moment = self._next - self._owed * self._seconds - _EARLY
        self._owed -= 1
        return moment
