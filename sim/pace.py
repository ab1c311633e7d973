"""How fast the simulation's time passes beside ours."""

from __future__ import annotations

import time

from sim.simulation import TICK_NS

_MOST = 0.05
"""Seconds for which it catches up at one go: messages are to be heard in between."""

_EARLY = 0.002
"""Seconds before its time that a tick may come: timers are not exact."""

_FORGIVEN = 0.25
"""Seconds behind after which what was missed is left out: a base does not rush to make up for a stop."""


class Pace:
    """Says how many ticks are due.

    Args:
        speed: seconds of the simulation in one of ours.

    Attributes:
        late: ticks that came a tick's time or more behind.
        left_out: ticks that never came, since this process stood still.
    """

    def __init__(self, speed: float) -> None:
        self._seconds = TICK_NS / 1e9 / speed
        self.begin()
        self.late = 0
        self.left_out = 0
        self._stood = -_PILED

    def begin(self) -> None:
        """Begin from now on: after a pause nothing is due."""
        self._next = time.monotonic() + self._seconds

    def stood_still(self) -> bool:
        """Whether what is heard now may have waited while this process stood still."""
        return time.monotonic() - self._stood < _PILED

    def due(self) -> int:
        """The ticks that are due now; they count as done."""
        now = time.monotonic()
        behind = now - self._next
        if behind > _FORGIVEN:
            missed = int(behind / self._seconds)
            self.left_out += missed
            self._stood = now
            self._next += missed * self._seconds
            behind = now - self._next
        count = int(behind / self._seconds) + 1 if behind > -_EARLY else 0
        count = min(count, max(1, int(_MOST / self._seconds)))
        self.late += max(0, min(count, int(behind / self._seconds))) if self._seconds >= _TICK_WAIT else 0
        self._next += count * self._seconds
        return count


_PILED = 0.5
"""Seconds after a stop in which what piled up meanwhile is still being heard."""

_TICK_WAIT = 0.005
"""Ticks that follow each other closer than this, in seconds, come in bundles: that is no lateness."""
