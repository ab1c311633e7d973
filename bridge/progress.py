"""Who works is not hung: telling one that computes, or comes further, from one that stands still.

What a process is busy with (`working`) goes to the daemon with its heartbeats, and the steps of a thread are judged by
the processor time that they use. Imports next to nothing: it runs before anything heavy is imported.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NamedTuple

SHARE = 0.01
"""Of a core. Who has used less of it since its last move stands still: a wait that polls each 10 ms uses 0.3 %, and one
that computes gets more even beside fifty others on its core."""

ENDLESS = 10.0
"""Times the limit of standing still: who uses so much processor time in one step is in a loop without an end. No honest
step comes near it: plans over the largest maps and the slowest imports take seconds."""

BUSY_SECONDS = 0.5
"""What takes no longer is not told of."""


class ThreadClock:
    """The processor time of the thread that makes it, for any thread to read; the system keeps it, none is spent."""

    def __init__(self) -> None:
        own = getattr(time, "pthread_getcpuclockid", None)
        self._id: int | None = own(threading.get_ident()) if own is not None else None
        self._seconds = 0.0

    def seconds(self) -> float:
        """Processor time so far; of the whole process where the system tells of no thread's (macOS, Windows)."""
        if self._id is None:
            return time.process_time()
        with suppress(OSError):  # the thread has ended
            self._seconds = time.clock_gettime(self._id)
        return self._seconds


class Movement:
    """Whether something moves: comes to another step, uses processor time, or reads from a disk."""

    def __init__(self, now: float) -> None:
        self.moved = now
        self.step: object = None
        self._first = self._used = 0.0
        self._read = 0

    def move(self, now: float) -> None:
        """It moves, whatever it is at."""
        self.moved, self.step, self._first = now, None, self._used

    def look(self, now: float, step: object, used: float, read: int = 0) -> None:
        """Take a look: another ``step`` is a move; ``used`` is processor seconds, ``read`` what was read from disks."""
        if step != self.step:
            self.moved, self.step, self._first, self._used, self._read = now, step, used, used, read
        elif used - self._used > SHARE * self.still(now) or read > self._read:
            self.moved, self._used, self._read = now, used, read

    def still(self, now: float) -> float:
        """Seconds since its last move."""
        return now - self.moved

    def computed(self) -> float:
        """Processor time seen in the step that it is at."""
        return self._used - self._first


class StepWatch:
    """Judges the steps of one thread from another one; a step may stand still for ``limit`` seconds.

    ``clock`` is the judged thread's, None before it called `begin`; until then a long step hangs.
    """

    def __init__(self, limit: float, clock: ThreadClock | None = None) -> None:
        self.clock = clock
        self._limit = limit
        self._movement = Movement(0.0)

    def begin(self) -> None:
        """The calling thread is the one to judge."""
        self.clock = ThreadClock()

    def judge(self, who: str, since: float | None) -> str:
        """Judge the step that began at ``since`` (monotonic, None between steps); call it again and again.

        Returns words for a step that computes for longer than the limit, else "". Raises `TimeoutError` where it
        stands still, or computes without end.
        """
        if since is None:
            return ""
        now, movement, clock = time.monotonic(), self._movement, self.clock
        lasted = now - since
        movement.look(now, since, clock.seconds() if clock is not None else 0.0)
        if lasted <= self._limit:
            return ""
        if movement.still(now) > self._limit or clock is None:
            msg = f"{who} hangs: it has been in one step for {lasted:.1f} s and computes nothing"
            raise TimeoutError(msg)
        if movement.computed() > ENDLESS * self._limit:
            msg = f"{who} is in a loop without an end: one step has computed for {movement.computed():.0f} s"
            raise TimeoutError(msg)
        return f"computes for {lasted:.0f} s"


class Busy(NamedTuple):
    """What a process is busy with: words, processor seconds spent on it, and blocks read from disks so far."""

    text: str
    used: float
    read: int


class Progress:
    """What this process's main thread is busy with; `working` is the one there is."""

    def __init__(self) -> None:
        self._text = ""
        self._since = 0.0
        self._main: ThreadClock | None = None
        self._waited: tuple[float, ThreadClock | None] = (0.0, None)

    def begin(self, text: str) -> None:
        """The calling thread is the one that works, and this is what it is at from now on."""
        self._main = ThreadClock()
        self._since, self._text = time.monotonic(), text

    def end(self) -> None:
        """It waits for something to do."""
        self._text = ""

    def at(self, text: str) -> None:
        """It comes to another part of what it is busy with."""
        if self._text:
            self._text = text

    @contextmanager
    def busy(self, text: str) -> Iterator[None]:
        """The calling thread is busy meanwhile."""
        self.begin(text)
        try:
            yield
        finally:
            self.end()

    @contextmanager
    def waiting_for(self, clock: ThreadClock) -> Iterator[None]:
        """Another thread works for it meanwhile."""
        spent, _ = self._waited
        self._waited = (spent - clock.seconds(), clock)
        try:
            yield
        finally:
            self._waited = (self._waited[0] + clock.seconds(), None)

    def now(self) -> Busy | None:
        """What it is busy with; None where that is nothing, or only just begun."""
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
"""Of this process."""
