"""Is a command still fresh? Commands that waited somewhere are dropped, not delivered late.

Two things age a command: time on the way, seen from source time stamps, and a worker that stood still (stopped by a
signal, suspended or starved) while messages piled up in its sockets, seen from beats that a `StallDetector` missed.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

_BEAT = 0.1
_REST_BEAT = 0.25
"""Between beats once nobody has asked for a while: waking up costs a process that has nothing to do 50 to 100 us. Less
than what `StallDetector.stood_still` takes for a standstill, so that what comes first is judged as strictly."""

_REST_SECONDS = 5.0
_LATE = 0.5
_STOOD_STILL = 1.0


def _now_ns() -> int:
    """A clock that is never set, and that runs while the machine is suspended where the system has one."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic_ns()


def _now() -> float:
    return _now_ns() / 1e9


class StallDetector:
    """Notices that this process stood still, on a thread that does nothing else: its work would make it late.

    ``went_on`` is called there with the seconds, of more than one; ``pause`` is the seconds between two beats, now.
    """

    def __init__(self, went_on: Callable[[float], None] = lambda _: None) -> None:
        self._went_on = went_on
        self._last = _now()
        self._until = 0.0
        self._asked = self._last
        self.pause = _BEAT
        self._stopping = False
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-stall", daemon=True)

    def start(self) -> None:
        """Begin to beat."""
        self._last = _now()
        self._thread.start()

    def stop(self) -> None:
        """Stop beating. Safe to call before `start`."""
        self._stopping = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._stopping:
            if self._wake.wait(self.pause):
                self._wake.clear()
            else:
                self.beat()
                self.pause = _REST_BEAT if self._last - self._asked > _REST_SECONDS else _BEAT

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
        now = self._asked = _now()
        if self.pause != _BEAT:
            self.pause = _BEAT
            self._wake.set()
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
        """Seconds that a message waited beyond the quickest; infinite behind a newer one, or while that is sought."""
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
