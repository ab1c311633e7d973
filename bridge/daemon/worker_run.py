"""One run of a worker's process: its reports and its progress."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from enum import Enum

from bridge.concurrency import Backoff
from bridge.progress import ENDLESS, Busy, Movement

_STACK_SECONDS = 0.3
"""Seconds for a hung worker to log the stacks of its threads before SIGKILL."""

_DOUBLED = 2
"""Maximum number of times that the limit for a start without progress is doubled."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Limits in seconds.

    Attributes:
        heartbeat: a worker that neither sends a heartbeat nor computes for this time is killed and restarted.
        start: longest time without progress while starting; it doubles after each such failure, up to a limit.
        patience: a starting worker without progress for this time no longer delays the start of others.
        stop: from the stop request until SIGKILL.
        apply: longest wait until a group of workers has applied a configuration, or has stopped, before others get it.
        retry: pause before a worker that cannot work here is started again.
        service_poll: interval of polling for a worker that a separate service runs.
        exit_poll: interval of polling for the exit of an earlier daemon's worker.
    """

    heartbeat: float = 5.0
    start: float = 60.0
    patience: float = 3.0
    stop: float = 2.8
    apply: float = 6.0
    retry: float = 30.0
    service_poll: float = 0.2
    exit_poll: float = 0.05


class Progress(Enum):
    """Whether a process makes progress."""

    NORMAL = "normal"
    LATE = "late"  #: without progress for longer than the limit; reported once
    HUNG = "hung"
    ENDLESS = "in an endless loop"


class WorkerRun:
    """The current process of a worker.

    Attributes:
        started: when the process started, on the monotonic clock.
        beat_at: when the last heartbeat arrived; None before the first.
        failure: why the process ends, as far as it is known.
        reloading: whether the worker has not applied its new configuration yet.
        running: whether the worker's health has been "running".
        killed: whether the daemon has killed the process.
    """

    def __init__(self) -> None:
        self.started = time.monotonic()
        self.beat_at: float | None = None
        self.failure = ""
        self.reloading = self.running = self.killed = False
        self._movement = Movement(self.started)
        self._late_at: float | None = None

    def on_busy(self, busy: Busy) -> None:
        """Handle a report of the current step."""
        self._movement.update(time.monotonic(), busy.text, busy.used, busy.read)

    def on_heartbeat(self) -> None:
        """Handle a heartbeat."""
        self.beat_at = time.monotonic()
        self._movement.move(self.beat_at)
        self._late_at = None

    @property
    def still(self) -> float:
        """Seconds without progress, computation or a heartbeat."""
        return self._movement.still(time.monotonic())

    @property
    def endless_step(self) -> str:
        """The current step, with its processor time."""
        return f"{self._movement.step} has computed for {self._movement.computed():.0f} s"

    def forgive(self, seconds: float) -> None:
        """Do not count ``seconds`` in which the daemon itself did not run."""
        # a report that waited meanwhile has counted as progress already
        self._movement.moved = min(self._movement.moved + seconds, time.monotonic())

    def progress(self, limit: float) -> Progress:
        """Return the progress of the process; ``limit`` is the longest time without progress, in seconds.

        It is `Progress.LATE` before it is `Progress.HUNG`, even if this is not called for longer than `_STACK_SECONDS`.
        """
        if self._movement.computed() > ENDLESS * limit:
            return Progress.ENDLESS
        now, still = time.monotonic(), self.still
        if still > limit and self._late_at is None:
            self._late_at = now
            return Progress.LATE
        if self._late_at is not None and still > limit + _STACK_SECONDS and now > self._late_at + _STACK_SECONDS:
            return Progress.HUNG
        return Progress.NORMAL


@dataclass(slots=True)
class RunHistory:
    """The earlier runs of a worker.

    Attributes:
        restarts: how many of them crashed.
        ended: how the last run that crashed ended, "" if none crashed.
        stalled_starts: how many made no progress while starting, since the last heartbeat.
        backoff: the pauses after crashes.
    """

    restarts: int = 0
    ended: str = ""
    stalled_starts: int = 0
    backoff: Backoff = field(default_factory=Backoff)

    def start_limit(self, timing: Timing) -> float:
        """Return the longest time without progress while starting, in seconds."""
        return timing.start * (1 << min(self.stalled_starts, _DOUBLED))
