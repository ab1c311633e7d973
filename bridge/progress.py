"""Detects hung processes and threads: those that neither compute nor make progress.

A process reports its current step (`working`) to the daemon with its heartbeats. The steps of a thread are judged by
the processor time that they use. This module imports very little, because it runs before any large import.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NamedTuple

from bridge.ticks import until_tick

SHARE = 0.01
"""Share of a core. A step that uses less than this makes no progress. A wait that polls every 10 ms uses 0.3 %; a
computation gets more than this even if it shares its core with fifty others."""

ENDLESS = 10.0
"""Multiple of the limit for time without progress. A step that uses more processor time than that is in an endless
loop, because even plans over the largest maps and the slowest imports take only seconds."""

BUSY_SECONDS = 0.5
"""Steps shorter than this are not reported."""


class ThreadClock:
    """The processor time of the thread that creates this object; any thread may read it."""

    def __init__(self) -> None:
        clock_id = getattr(time, "pthread_getcpuclockid", None)
        self._id: int | None = clock_id(threading.get_ident()) if clock_id is not None else None
        self._seconds = 0.0

    def seconds(self) -> float:
        """Return the processor time so far, in seconds; on macOS and Windows that of the whole process."""
        if self._id is None:
            return time.process_time()
        with suppress(OSError):  # the thread has ended
            self._seconds = time.clock_gettime(self._id)
        return self._seconds


class Movement:
    """Detects progress: a new step, used processor time, or reads from a disk."""

    def __init__(self, now: float) -> None:
        self.moved = now
        self.step: object = None
        self._first = self._used = 0.0
        self._read = 0

    def move(self, now: float) -> None:
        """Record progress, whether or not the step has changed."""
        self.moved, self.step, self._first = now, None, self._used

    def update(self, now: float, step: object, used: float, read: int = 0) -> None:
        """Update with the current step, its processor time in seconds, and the number of blocks read from disks."""
        if step != self.step:
            self.moved, self.step, self._first, self._used, self._read = now, step, used, used, read
        elif used - self._used > SHARE * self.still(now) or read > self._read:
            self.moved, self._used, self._read = now, used, read

    def still(self, now: float) -> float:
        """Return the seconds since the last progress."""
        return now - self.moved

    def computed(self) -> float:
        """Return the processor time of the current step, in seconds."""
        return self._used - self._first


class StepWatch:
    """Judges the steps of one thread from another thread; a step may make no progress for at most ``limit`` seconds.

    ``clock`` is the clock of the judged thread, None until that thread calls `begin`; until then, any long step counts
    as hung.
    """

    def __init__(self, limit: float, clock: ThreadClock | None = None) -> None:
        self.clock = clock
        self._limit = limit
        self._movement = Movement(0.0)

    def begin(self) -> None:
        """Start judging the calling thread."""
        self.clock = ThreadClock()

    def judge(self, name: str, since: float | None) -> str:
        """Judge the step that began at ``since`` (monotonic, None between steps); call it repeatedly.

        Return a text for a step that has been computing for longer than the limit, else "". Raises `TimeoutError` if
        the step makes no progress, or computes endlessly.
        """
        if since is None:
            return ""
        now, movement, clock = time.monotonic(), self._movement, self.clock
        lasted = now - since
        movement.update(now, since, clock.seconds() if clock is not None else 0.0)
        if lasted <= self._limit:
            return ""
        if movement.still(now) > self._limit or clock is None:
            msg = f"{name} hangs: it has been in one step for {lasted:.1f} s and computes nothing"
            raise TimeoutError(msg)
        if movement.computed() > ENDLESS * self._limit:
            msg = f"{name} is in an endless loop: one step has computed for {movement.computed():.0f} s"
            raise TimeoutError(msg)
        return f"computes for {lasted:.0f} s"


class Busy(NamedTuple):
    """The current step of a process: text, processor seconds spent on it, and blocks read from disks so far."""

    text: str
    used: float
    read: int


class Progress:
    """The current step of this process's main thread; `working` is the only instance."""

    def __init__(self) -> None:
        self._text = ""
        self._since = 0.0
        self._main: ThreadClock | None = None
        self._waited: tuple[float, ThreadClock | None] = (0.0, None)

    def begin(self, text: str) -> None:
        """Begin a step on the calling thread, whose processor time counts from now on."""
        self._main = ThreadClock()
        self._since, self._text = time.monotonic(), text

    def end(self) -> None:
        """End the step; the thread is idle."""
        self._text = ""

    def at(self, text: str) -> None:
        """Change the text of the current step, if any."""
        if self._text:
            self._text = text

    @contextmanager
    def busy(self, text: str) -> Iterator[None]:
        """Report a step of the calling thread during the context."""
        self.begin(text)
        try:
            yield
        finally:
            self.end()

    @contextmanager
    def waiting_for(self, clock: ThreadClock) -> Iterator[None]:
        """Also count the processor time of another thread during the context."""
        spent, _ = self._waited
        self._waited = (spent - clock.seconds(), clock)
        try:
            yield
        finally:
            self._waited = (self._waited[0] + clock.seconds(), None)

    @property
    def pause(self) -> float:
        """Seconds until the next call of `now`, if each step that lasts for twice `BUSY_SECONDS` must be reported."""
        # half a tick after the main thread's heartbeat, so that this short step does not count as one
        return BUSY_SECONDS if self._text else until_tick(2 * BUSY_SECONDS, BUSY_SECONDS)

    def now(self) -> Busy | None:
        """Return the current step; None if the thread is idle, or the step is shorter than `BUSY_SECONDS`."""
        text, main = self._text, self._main
        if not text or main is None or time.monotonic() - self._since < BUSY_SECONDS:
            return None
        spent, other = self._waited
        return Busy(text, round(main.seconds() + spent + (other.seconds() if other is not None else 0.0), 4), _read())


def _read() -> int:
    try:
        import resource
    except ImportError:  # Windows
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_inblock


working = Progress()
"""The progress of this process."""
