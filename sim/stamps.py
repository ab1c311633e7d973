"""Stamps of a simulation that runs in real time."""

from __future__ import annotations

import logging
import time

from bridge.clock import SystemClock

_log = logging.getLogger(__name__)

_STEP_NS = 50_000_000
"""A larger change of the system clock is a step; a smaller change is an error from reading two clocks in turn."""


class WallStamps:
    """Converts the times at which ticks are due to stamps of the system clock.

    A stamp depends on when its tick is due, not on when the tick is computed, so that ticks which the simulator catches
    up on in a burst have stamps one tick apart. Stamps go back only if the system clock is set back.
    """

    def __init__(self) -> None:
        self._clock = SystemClock(time.time_ns, time.monotonic_ns, poll=0.0)
        _, self._offset, _ = self._clock.read()

    def stamp(self, due: float) -> int:
        """Return the stamp, in ns, of a time in seconds of the monotonic clock."""
        _, offset, error = self._clock.read()
        if abs(offset - self._offset) > _STEP_NS + error:
            _log.warning("the system clock was set by %.3f s; stamps follow it", (offset - self._offset) / 1e9)
            self._offset = offset
        return self._offset + round(due * 1e9)
