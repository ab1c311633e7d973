"""The age of commands: old commands are dropped instead of being delivered late.

A command ages on its path, which source timestamps show, and in the sockets of a worker that stalls (because it is
stopped by a signal, suspended or starved), which missed beats of a `StallDetector` show.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable

from bridge.clock import steady, steady_ns
from bridge.ticks import until_tick

_log = logging.getLogger(__name__)

_BEAT = 0.1
_REST_BEAT = 0.25
"""Seconds between beats while no commands arrive, because each wake-up costs an idle process 50 to 100 us. This is
shorter than what `StallDetector.stood_still` counts as a stall, so that the first command is checked as strictly."""

_REST_SECONDS = 5.0
_LATE = 0.5
_STOOD_STILL = 1.0


class StallDetector:
    """Detects stalls of this process, on a separate thread.

    ``resumed`` is called on that thread after a stall of more than one second, with its duration in seconds; ``pause``
    is the current time between two beats, in seconds.
    """

    def __init__(self, resumed: Callable[[float], None] = lambda _: None) -> None:
        self._resumed = resumed
        self._last = steady()
        self._until = 0.0
        self.last_stall = 0.0
        """Duration in seconds of the last stall of more than half a second."""
        self.stalls = 0
        """Number of such stalls."""
        self._asked = self._last
        self.pause = _BEAT
        self._stopping = False
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-stall", daemon=True)

    def start(self) -> None:
        self._last = steady()
        self._thread.start()

    def stop(self) -> None:
        """Stop beating. Safe to call before `start`."""
        self._stopping = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._stopping:
            if self._wake.wait(until_tick(self.pause)):
                self._wake.clear()
            else:
                try:
                    self.beat()
                except Exception:  # without this thread, each command would count as old
                    _log.exception("recovering from a suspension failed")
                self.pause = _REST_BEAT if self._last - self._asked > _REST_SECONDS else _BEAT

    def beat(self) -> None:
        """Note that the process runs, and detect a stall since the last beat."""
        now = steady()
        since = now - self._last
        if since > _LATE:
            # Messages that accumulated during the stall are still being read from sockets.
            self._until = now + _LATE
            self.last_stall, self.stalls = since, self.stalls + 1
        self._last = now  # last, so that no concurrent reader misses the stall
        if since > _STOOD_STILL:
            self._resumed(since)

    def stood_still(self, timeout: float) -> bool:
        """Return whether a message that arrives now may have waited here for over ``timeout`` s (at least 0.3 s)."""
        now = self._asked = steady()
        if self.pause != _BEAT:
            self.pause = _BEAT
            self._wake.set()
        return now < self._until or now - self._last > max(timeout, 0.3)

    def hung(self, seconds: float) -> bool:
        """Return whether a message that arrives now may have waited while this process hung for longer than that."""
        now = steady()
        return now - self._last > seconds or (now < self._until and self.last_stall > seconds)


STEP_NS = 100_000_000
"""Larger steps back between timestamps mean that the clock was set back, not that messages were reordered; in ns."""

_COUNTED_NS, _APART = 10_000, 0.001
"""A source's clock stands if timestamps of messages that arrive ``_APART`` s apart differ by less than this, in ns.

zenoh's hybrid logical clock adds 0.23 ns for each message of its session until the system clock has caught up.
"""

HOLD = 0.5
"""Seconds for determining the smallest delay, during which no message counts as fresh."""

CONFIRM = 2.0
"""Seconds for which the delay must stay the same before a clock counts as set back during a pause of its messages."""

_STEADY_NS = 10_000_000
"""A delay stays the same if it decreases by less than this, in ns, as that of a backlog does while it is read, and
never exceeds the first one by more than `STEP_NS`, as that of a queue does while it fills."""


class AgeGate:
    """Determines the age of one source's messages from their timestamps, for any offset between the two clocks.

    The smallest difference between arrival and timestamp is the clocks' offset plus the shortest delay; any excess is
    waiting time. The smallest difference grows slowly, so that drifting clocks do not make all messages look old. The
    arrival is measured by a clock that is never set. The smallest difference is determined again if the source's clock
    is set back, or if the first message looks old. While the source's clock stands, the age is unknown and counts as 0.

    A source's clock was set back, although no timestamp goes back, if the difference grew

    - by as much as this machine's clock was set back or slewed: the source is on this machine;
    - by less than the pause before the message, and then stays the same for `CONFIRM` seconds.
    """

    __slots__ = ("_confirmed_at", "_held_until", "_least", "_newest", "_offset", "_seen", "_step")

    def __init__(self) -> None:
        self._least: int | None = None
        self._newest = self._offset = 0
        self._seen = self._held_until = self._confirmed_at = 0.0
        self._step: int | None = None  # the difference after a pause in which the source's clock may have been set back

    def age(self, source_time_ns: int) -> float:
        """Return a message's extra delay in seconds; infinity after a newer message, or while the offset is unknown."""
        arrival = steady_ns()
        offset = time.time_ns() - arrival  # changes if this machine's clock is set
        difference, now = arrival - source_time_ns, arrival / 1e9
        newest, self._newest = self._newest, source_time_ns
        step, self._step = self._step, None
        if self._least is None and offset + difference > STEP_NS:
            # Either the source's clock is slow, or older messages arrive first, as with DDS for a new reader.
            self._held_until = now + HOLD
        if self._least is None or difference < self._least:
            self._least, self._offset = difference, offset
        elif self._follows_this_clock(difference, offset):
            self._least, self._offset = self._least + self._offset - offset, offset
        elif newest - source_time_ns > STEP_NS:
            self._least, self._offset, self._held_until = difference, offset, now + HOLD
        elif source_time_ns < newest:
            self._newest = newest
            return math.inf
        elif source_time_ns - newest < _COUNTED_NS and now - self._seen > _APART:
            self._least, self._offset = difference, offset
        elif self._was_set(difference, now, step):
            self._least, self._offset, self._step = difference, offset, None
        else:
            self._least += int(min(now - self._seen, 10.0) * 1e5)  # 100 ppm
        self._seen = now
        return math.inf if now < self._held_until else (difference - self._least) / 1e9

    def _follows_this_clock(self, difference: int, offset: int) -> bool:
        """Return whether the difference grew because this machine's clock, which the source uses, was set back."""
        assert self._least is not None
        grown, back = difference - self._least, self._offset - offset
        if grown < STEP_NS // 2 and abs(back) > STEP_NS:  # the source does not use this machine's clock
            self._offset = offset
        return grown > STEP_NS and abs(grown - back) < STEP_NS

    def _was_set(self, difference: int, now: float, step: int | None) -> bool:
        """Return whether the source's clock was set back during a pause: the difference has grown once, and stays.

        ``step`` is the difference after the pause; None if the previous message was not old.
        """
        assert self._least is not None
        grown = difference - self._least
        if grown <= STEP_NS or (step is None and now - self._seen < grown / 1e9):
            return False
        if step is None or step - difference > _STEADY_NS:
            step = difference
            self._confirmed_at = now + CONFIRM
        elif difference - step > STEP_NS:  # a queue that fills
            self._confirmed_at = now + CONFIRM
        self._step = step
        return now >= self._confirmed_at
