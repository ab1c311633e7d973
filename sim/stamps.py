"""Stamps of a simulation that runs in real time."""

from __future__ import annotations

import logging
import time

_log = logging.getLogger(__name__)

_STEP_NS = 50_000_000
"""A change of the system clock that is a step. Smaller ones are errors of reading two clocks on a busy machine."""


class WallStamps:
    """Converts the times at which ticks are due to stamps of the system clock.

    A stamp depends on when its tick is due, not on when it is computed: ticks that the simulator catches up on in a
    burst have stamps one tick apart. Stamps go back only if the system clock is set back.
    """

    def __init__(self) -> None:
        self._offset = _offset()[0]

    def stamp(self, due: float) -> int:
        """Return the stamp, in ns, of a time in seconds of the monotonic clock."""
        offset, error = _offset()
        if abs(offset - self._offset) > _STEP_NS + error:
            _log.warning("the system clock was set by %.3f s; stamps follow it", (offset - self._offset) / 1e9)
            self._offset = offset
        return self._offset + round(due * 1e9)


def _offset() -> tuple[int, int]:
    """Return the system clock minus the monotonic clock, and how far that may be off, in ns."""
    before = time.monotonic_ns()
    wall = time.time_ns()
    after = time.monotonic_ns()
    return wall - before, after - before
