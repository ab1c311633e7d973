"""Is a command still fresh? Commands that waited somewhere are dropped, not delivered late.

Two things age a command: time on the way, seen from source time stamps, and a worker that stood still (stopped by a
signal, suspended or starved) while messages piled up in its sockets, seen from a pulse that missed its beats.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

_BEAT = 0.1
_LATE = 0.5
_STOOD_STILL = 1.0


def _now_ns() -> int:
    """A clock that nobody sets, and that goes on while the machine is suspended where the system has one."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic_ns()


def _now() -> float:
    return _now_ns() / 1e9


class Pulse:
    """Notices that this process stood still.

    Its thread does nothing else: one that also works is late by its work.

    Args:
        went_on: called on that thread with the seconds, when the process stood still for more than one and goes on.
    """

    def __init__(self, went_on: Callable[[float], None] = lambda _: None) -> None:
        self._went_on = went_on
        self._last = _now()
        self._until = 0.0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-pulse", daemon=True)

    def start(self) -> None:
        """Begin to beat."""
        self._last = _now()
        self._thread.start()

    def stop(self) -> None:
        """Beat no more. Safe to call where it never began."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._stopping.wait(_BEAT):
            self.beat()

    def beat(self) -> None:
        """Mark that the process runs."""
        now = _now()
        since = now - self._last
        if since > _LATE:
            # What piled up while we stood still is still being read from sockets for a moment.
            self._until = now + _LATE
        self._last = now  # after that: who asks between the two must not take us for awake all the time
        if since > _STOOD_STILL:
            self._went_on(since)

    def stood_still(self, timeout: float) -> bool:
        """Whether a message that arrives now may have waited longer than ``timeout`` seconds in front of us."""
        now = _now()
        return now < self._until or now - self._last > max(timeout, 0.3)


STEP_NS = 100_000_000
"""A time stamp that lies farther behind its predecessor is a clock that was set back, and not a message overtaken."""

HOLD = 0.5
"""Seconds in which the quickest message is looked for, and none counts as fresh."""


class AgeGate:
    """Age of messages of one source by their time stamps, whatever the offset between the two clocks.

    The least difference between arrival and time stamp that was ever seen stands for the offset plus the shortest way;
    what exceeds it is time spent waiting. The least difference is forgotten slowly, so that drifting clocks do not
    make everything look old. Arrival is taken from a clock that nobody sets; where the source's own is set back, the
    least difference is looked for anew. So it is at the start, for a source whose first message looks old.
    """

    __slots__ = ("_held_until", "_least", "_newest", "_seen")

    def __init__(self) -> None:
        self._least: int | None = None
        self._newest = 0
        self._seen = self._held_until = 0.0

    def age(self, source_time_ns: int) -> float:
        """Seconds that this message waited on its way, beyond the quickest one of its source.

        Infinite where a newer one came before it, and while the quickest one is looked for.
        """
        arrival = _now_ns()
        difference, now = arrival - source_time_ns, arrival / 1e9
        newest, self._newest = self._newest, source_time_ns
        if self._least is None and time.time_ns() - source_time_ns > STEP_NS:
            # Either its clock is behind, or what piled up before it comes first, as DDS does for a new reader.
            self._held_until = now + HOLD
        if self._least is None or difference < self._least:
            self._least = difference
        elif newest - source_time_ns > STEP_NS:
            self._least, self._held_until = difference, now + HOLD
        elif source_time_ns < newest:
            self._newest = newest
            return math.inf
        else:
            self._least += int(min(now - self._seen, 10.0) * 1e5)  # 100 ppm
        self._seen = now
        return math.inf if now < self._held_until else (difference - self._least) / 1e9
