"""When the messages of a bag are due: the bag's time on a monotonic clock, with pause and step."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from enum import Enum

LATE = 0.2
"""Lag of a message in seconds above which the bag's time is set back to the message, so as not to run ahead of it."""

MAX_STEPS = 1000
"""Maximum number of pending steps."""

_NS = 1e9

Wait = Callable[[threading.Condition, float | None], object]
"""Waits on the condition for a number of seconds; None: until it is notified."""


class Due(Enum):
    """What to do now."""

    MESSAGE = "message"
    STEP = "step"
    """The message is due because of a step during a pause."""
    CLOCK = "clock"
    PAUSED = "paused"
    """A pause has started."""
    STOPPED = "stopped"


def _wait(condition: threading.Condition, seconds: float | None) -> object:
    return condition.wait(seconds)


class Timeline:
    """The bag's time. It never passes a message that has not been played, so no clock is ahead of the messages.

    One thread waits for the `next` event; any thread may pause, step and stop.

    Args:
        rate: seconds of the bag per second.
        paused: whether to start paused.
        clock_hz: rate of `Due.CLOCK`, even during a pause; 0: never.
        now: returns the seconds of a monotonic clock.
        wait: see `Wait`.

    Attributes:
        late: delay of the last message in seconds.
        behind: total lag in seconds because messages could not keep up.
    """

    def __init__(
        self,
        rate: float = 1.0,
        *,
        paused: bool = False,
        clock_hz: float = 0.0,
        now: Callable[[], float] = time.monotonic,
        wait: Wait = _wait,
    ) -> None:
        self.rate = rate
        self.late = self.behind = 0.0
        self._now, self._wait = now, wait
        self._changed = threading.Condition()
        self._paused, self._pause_pending = paused, False
        self._steps = 0
        self._stopped = False
        self._period = 1.0 / clock_hz if clock_hz else 0.0
        self._clock_due = now()
        self._at = self._next = 0
        self._since = now()

    @property
    def paused(self) -> bool:
        """Whether the bag's time is stopped."""
        return self._paused

    @property
    def stopped(self) -> bool:
        return self._stopped

    def begin(self, time_ns: int) -> None:
        """Set the bag's time, which runs from now on unless it is paused."""
        with self._changed:
            self._at = self._next = time_ns
            self._since = self._clock_due = self._now()

    def now_ns(self) -> int:
        """Return the bag's current time, in nanoseconds since 1970."""
        with self._changed:
            return self._position()

    def _position(self) -> int:
        if self._paused:
            return self._at
        passed = int((self._now() - self._since) * self.rate * _NS)
        return min(self._at + passed, self._next)

    def next(self, time_ns: int) -> Due:
        """Wait until a message of this time is due, or for another event, after which the caller has to wait again.

        Deadlines count from when the bag's time started to run, so that the excess of long waits does not add up.
        """
        with self._changed:
            self._next = max(self._next, time_ns)
            while True:
                now = self._now()
                if (due := self._event_before(now)) is not None:
                    return due
                deadline = self._deadline()
                if deadline is not None and now >= deadline:
                    self._record_delay(now, now - deadline)
                    return Due.MESSAGE
                ends = [end for end in (deadline, self._clock_due if self._period else None) if end is not None]
                # a thread can wait for 292 years at once, and a bag's times span 584, more at a low rate
                self._wait(self._changed, min(min(ends) - now, threading.TIMEOUT_MAX) if ends else None)

    def _event_before(self, now: float) -> Due | None:
        """Return an event that precedes the message."""
        if self._stopped:
            return Due.STOPPED
        if self._pause_pending:
            self._pause_pending = False
            return Due.PAUSED
        if self._period and now >= self._clock_due:
            self._clock_due = max(self._clock_due + self._period, now)
            return Due.CLOCK
        if self._paused and self._steps:
            self._steps -= 1
            self._at, self.late = self._next, 0.0
            return Due.STEP
        return None

    def _deadline(self) -> float | None:
        if self._paused:
            return None
        return self._since + (self._next - self._at) / (self.rate * _NS)

    def _record_delay(self, now: float, late: float) -> None:
        self.late = late
        if late > LATE:
            self.behind += late
            self._at, self._since = self._next, now

    def pause(self, paused: bool) -> None:
        """Stop the bag's time, or let it continue."""
        with self._changed:
            if paused == self._paused:
                return
            if paused:
                self._at = self._position()
            self._paused = self._pause_pending = paused
            self._since = self._now()
            self._steps = 0
            self._changed.notify_all()

    def publish(self, command: Callable[[], object]) -> bool:
        """Publish a command unless the play is paused; return whether it was published.

        After `pause` has returned, no command is published, not even one that was due before.
        """
        with self._changed:
            if self._paused:
                return False
            command()
            return True

    def step(self) -> bool:
        """Play one message while paused; return False if the play is not paused, or too many steps are pending."""
        with self._changed:
            if not self._paused or self._steps >= MAX_STEPS:
                return False
            self._steps += 1
            self._changed.notify_all()
            return True

    def stop(self) -> None:
        """Let `next` return `Due.STOPPED` from now on."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
