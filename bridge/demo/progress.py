"""One run of a demo, and its progress: new states and output of its parts, the robot's motion, and processor time."""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil
from typing_extensions import override

from bridge.daemon.query import Phase, ask_daemon
from bridge.demo.processes import DemoChild, guarded
from bridge.demo.sandbox import SYSTEM_PYTHON, Sandbox, roscore
from bridge.demo.shutdown import Shutdown
from bridge.text import clean

STILL_SECONDS = 60.0
"""A demo ends after this time without progress. A slow machine still makes progress, so the demo waits for it."""

_METERS, _RADIANS, _WORK = 0.1, math.radians(15.0), 0.5
"""Thresholds of progress: the robot's translation and rotation, and seconds of processor time."""

_NUMBERS = re.compile(r"\d+(\.\d+)?")
_MOST = 10_000


class DemoError(RuntimeError):
    """The demo cannot continue; the text has the reason and the cure."""


def without_numbers(text: str) -> str:
    """Return a text without its numbers, because counted seconds and noisy positions are not progress."""
    return _NUMBERS.sub("#", text)


class DemoProgress:
    """Detects whether there was progress recently; ``clock`` returns seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._seen: set[tuple[str, str]] = set()
        self._at: tuple[float, float, float] | None = None
        self._work: dict[int, float] = {}
        self._worked = 0.0
        self._progressed_at = clock()

    def begin(self) -> None:
        """Restart for the next condition to wait for."""
        self._seen.clear()
        self._progressed_at = self._clock()

    @property
    def still(self) -> float:
        """Seconds since the last progress."""
        return self._clock() - self._progressed_at

    @property
    def stalled(self) -> bool:
        """Whether there has been no progress for too long."""
        return self.still > STILL_SECONDS

    def note(self, who: str, text: str, *, numbers: bool = False) -> bool:
        """Record a text from a source; return whether it is new. Numbers are ignored unless ``numbers`` is set."""
        entry = who, text if numbers else without_numbers(text)
        if entry in self._seen or len(self._seen) >= _MOST:
            return False
        self._seen.add(entry)
        self._progressed_at = self._clock()
        return True

    def note_pose(self, x: float, y: float, yaw: float) -> None:
        """Record the robot's pose, in meters and radians."""
        before = self._at
        if before is not None:
            turned = abs(math.remainder(yaw - before[2], math.tau))
            if math.dist(before[:2], (x, y)) < _METERS and turned < _RADIANS:
                return
        self._at = x, y, yaw
        self._progressed_at = self._clock()

    def note_work(self, pids: Iterable[int]) -> None:
        """Record the processor time of starting processes, which counts as progress."""
        now = {pid: seconds for pid in pids if (seconds := _spent(pid)) is not None}
        self._worked += sum(max(0.0, spent - self._work.get(pid, spent)) for pid, spent in now.items())
        self._work |= now
        if self._worked >= _WORK:
            self._worked, self._progressed_at = 0.0, self._clock()


def _spent(pid: int) -> float | None:
    """Return a process's processor time in seconds; None if it has ended."""
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return None
    return float(times.user + times.system)


_ASK_EVERY = 0.5
_MOST_RESTARTS = 3
"""A worker that was restarted this often has failed."""

_LAST_LINES = 8
_COMING = {Phase.STARTING.value, "not answering yet"}
_TRY = (
    "'midspan doctor' shows what this machine lacks, 'free -m' and 'uptime' whether it is out of memory or overloaded;"
    " then run the demo again."
)


@dataclass(frozen=True, slots=True)
class PartState:
    """One part of a demo: its phase as reported by the daemon, its process, and its restarts."""

    name: str
    phase: str
    text: str = ""
    pid: int = 0
    restarts: int = 0

    @override
    def __str__(self) -> str:
        return ", ".join(filter(None, (f"{self.name}: {self.phase}", self.text)))

    @property
    def failed(self) -> bool:
        """Whether waiting for the part is pointless."""
        return self.phase == Phase.FAILED.value or self.restarts >= _MOST_RESTARTS

    @property
    def coming(self) -> bool:
        """Whether the part is starting, so that its processor time counts as progress."""
        return self.phase in _COMING

    @property
    def idle(self) -> bool:
        """Whether the part reports that it is not working."""
        return self.phase != Phase.UP.value or self.text.startswith("waiting")


class Parts:
    """The state of all parts of a demo; ``starting`` are the process ids of other starting programs."""

    def __init__(self, sandbox: Sandbox, children: Mapping[str, DemoChild]) -> None:
        self._config, self._children = sandbox.config, children
        self._asked = -_ASK_EVERY
        self._workers: list[PartState] = []
        self.starting: Sequence[int] = ()

    @property
    def all(self) -> list[PartState]:
        """The parts at the last refresh."""
        answers = bool(self._workers)
        processes = [
            PartState(name, "running" if name != "daemon" or answers else "not answering yet", pid=child.pid)
            for name, child in self._children.items()
        ]
        return [*processes, *self._workers]

    def refresh(self, progress: DemoProgress) -> None:
        """Query the daemon, at a limited rate, and record new states and output as progress."""
        now = time.monotonic()
        if now - self._asked < _ASK_EVERY:
            return
        self._asked = now
        status = ask_daemon(self._config) if "daemon" in self._children else None
        if status is not None:
            self._workers = [
                PartState(clean(worker.worker), worker.phase, clean(worker.text), worker.pid, worker.restarts)
                for worker in status.workers
                if worker.phase != Phase.OFF.value
            ]
        for part in self.all:
            progress.note(part.name, f"{part.phase} {part.text}")
        for name, child in self._children.items():
            for line in child.last_output().splitlines():
                progress.note(name, line)
        coming = [part.pid for part in self.all if part.coming]
        progress.note_work(pid for worker in (*coming, *self.starting) for pid in _with_children(worker))

    def up(self, name: str) -> bool:
        """Return whether a worker runs."""
        return any(part.name == name and part.phase == Phase.UP.value for part in self._workers)

    @property
    def failed(self) -> PartState | None:
        """A failed part, or None."""
        return next((part for part in self._workers if part.failed), None)

    def failure_text(self, part: PartState) -> str:
        """Return the error message for a failed part."""
        again = f" (restarted {part.restarts} times)" if part.restarts else ""
        return "\n".join([f"{part}{again}", *self._log_lines([part]), _TRY])

    def stall_text(self, what: str) -> str:
        """Return the error message if nothing has progressed while waiting for ``what``."""
        blamed = [part for part in self.all if part.idle] or self.all
        still = f"no progress for {STILL_SECONDS:.0f} s while waiting for {what}:"
        return "\n".join([still, *(f"  {part}" for part in blamed), *self._log_lines(blamed), _TRY])

    def _log_lines(self, blamed: Iterable[PartState]) -> list[str]:
        """Return the last lines of the daemon's log that mention these parts, or of the whole log if none does."""
        if "daemon" not in self._children:
            return []
        lines = self._children["daemon"].last_output().splitlines()
        theirs = [line for line in lines if any(part.name in line for part in blamed)] or lines
        return ["Last lines of the log:", *(f"  {line}" for line in theirs[-_LAST_LINES:])]


def _with_children(pid: int) -> list[int]:
    """Return a process and all its descendants, which for the daemon's guard include the daemon."""
    try:
        process = psutil.Process(pid)
        return [pid, *(child.pid for child in process.children(recursive=True))]
    except (psutil.Error, ValueError):
        return []


class DemoRun:
    """The processes of one run of a demo."""

    def __init__(self, sandbox: Sandbox, shutdown: Shutdown) -> None:
        self._sandbox, self._shutdown = sandbox, shutdown
        self._children: dict[str, DemoChild] = {}
        self._progress, self._parts = DemoProgress(), Parts(sandbox, self._children)
        self._began = time.monotonic()

    def _launch(self, name: str, command: Sequence[Path | str], env: Mapping[str, str]) -> None:
        with self._shutdown.held():
            self._children[name] = DemoChild(name, command, env, self._sandbox.folder)

    def _launch_roscore_and_daemon(self) -> None:
        sandbox = self._sandbox
        program = None if sandbox.config.ros1.embedded_uri else roscore(sandbox.config)
        if program is not None:
            master = guarded(SYSTEM_PYTHON, program, "-p", str(sandbox.master_port))
            self._launch("roscore", master, sandbox.ros1_environment())
        daemon = guarded(sys.executable, "-m", "bridge.cli.main", "run", "--config", sandbox.config_file)
        self._launch("daemon", daemon, sandbox.environment())

    def _check_processes(self) -> None:
        """Raise `KeyboardInterrupt` if the demo is interrupted, `DemoError` if a process has ended."""
        self._shutdown.check()
        for child in self._children.values():
            if not child.running:
                raise DemoError(f"{child.name} ended unexpectedly:\n{child.last_output()}")

    def _check(self, what: str) -> None:
        """Raise `DemoError` if waiting is pointless: a part has failed, or nothing progresses."""
        self._fail_with_a_part()
        if self._progress.stalled:
            raise DemoError(self._parts.stall_text(what))

    def _fail_with_a_part(self) -> None:
        failed = self._parts.failed
        if failed is not None:
            raise DemoError(self._parts.failure_text(failed))
