"""One run of a demo, and whether it makes progress: the state of its parts, its robot's way, what starts."""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from bridge.cli.output import clean
from bridge.daemon.query import Phase, ask_daemon
from bridge.demo.processes import DemoChild, guarded
from bridge.demo.sandbox import SYSTEM_PYTHON, Sandbox, roscore
from bridge.demo.shutdown import Shutdown

STILL_SECONDS = 60.0
"""A demo in which nothing has moved for so long ends; a slow machine moves slowly, and is waited for."""

_METERS, _RADIANS, _WORK = 0.1, math.radians(15.0), 0.5
"""What counts: of a robot's way, of its turning, and seconds of processor time."""

_NUMBERS = re.compile(r"\d+(\.\d+)?")
_MOST = 10_000


class DemoError(RuntimeError):
    """The demo cannot go on; says what is missing and how to mend it."""


def without_numbers(text: str) -> str:
    """A text without its numbers: seconds that are counted, or noise in a place, are nothing new."""
    return _NUMBERS.sub("#", text)


class DemoProgress:
    """Tells whether anything was new lately; ``clock`` gives seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._seen: set[tuple[str, str]] = set()
        self._at: tuple[float, float, float] | None = None
        self._work: dict[int, float] = {}
        self._worked = 0.0
        self._moved = clock()

    def begin(self) -> None:
        """Something else is waited for from now on."""
        self._seen.clear()
        self._moved = self._clock()

    @property
    def still(self) -> float:
        """Seconds since anything moved."""
        return self._clock() - self._moved

    @property
    def stalled(self) -> bool:
        """Whether that is too long."""
        return self.still > STILL_SECONDS

    def note(self, who: str, text: str, *, numbers: bool = False) -> bool:
        """Somebody says something; whether that is new, by its words alone unless its numbers count."""
        entry = who, text if numbers else without_numbers(text)
        if entry in self._seen or len(self._seen) >= _MOST:
            return False
        self._seen.add(entry)
        self._moved = self._clock()
        return True

    def note_pose(self, x: float, y: float, yaw: float) -> None:
        """The robot is there: metres, radians."""
        before = self._at
        if before is not None:
            turned = abs(math.remainder(yaw - before[2], math.tau))
            if math.dist(before[:2], (x, y)) < _METERS and turned < _RADIANS:
                return
        self._at = x, y, yaw
        self._moved = self._clock()

    def note_work(self, pids: Iterable[int]) -> None:
        """These processes are starting: what they compute now is progress."""
        now = {pid: seconds for pid in pids if (seconds := _spent(pid)) is not None}
        self._worked += sum(max(0.0, spent - self._work.get(pid, spent)) for pid, spent in now.items())
        self._work |= now
        if self._worked >= _WORK:
            self._worked, self._moved = 0.0, self._clock()


def _spent(pid: int) -> float | None:
    """Processor time of a process, seconds; None where it has ended."""
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return None
    return float(times.user + times.system)


_ASK_EVERY = 0.5
_MOST_RESTARTS = 3
"""A worker that was started again so often has failed."""

_LAST_LINES = 8
_COMING = {Phase.STARTING.value, "not answering yet"}
_TRY = (
    "What to try: 'midspan doctor' says what this machine lacks; 'free -m' and 'uptime' say whether it has memory left"
    " and how busy it is; then run the demo again."
)


@dataclass(frozen=True, slots=True)
class PartState:
    """One part of a demo: what it does in the daemon's words, its process, and how often it restarted."""

    name: str
    phase: str
    text: str = ""
    pid: int = 0
    restarts: int = 0

    def __str__(self) -> str:
        return ", ".join(filter(None, (f"{self.name}: {self.phase}", self.text)))

    @property
    def failed(self) -> bool:
        """Whether it will not come up by being waited for."""
        return self.phase == Phase.FAILED.value or self.restarts >= _MOST_RESTARTS

    @property
    def coming(self) -> bool:
        """Whether it is coming up: what it computes until then is progress."""
        return self.phase in _COMING

    @property
    def idle(self) -> bool:
        """Whether it says that it does not run as it should."""
        return self.phase != Phase.UP.value or self.text.startswith("waiting")


class Parts:
    """Looks at all parts of a demo; ``starting`` are the process ids of other programs that come up."""

    def __init__(self, sandbox: Sandbox, children: Mapping[str, DemoChild]) -> None:
        self._config, self._children = sandbox.config, children
        self._asked = -_ASK_EVERY
        self._workers: list[PartState] = []
        self.starting: Sequence[int] = ()

    @property
    def all(self) -> list[PartState]:
        """As they were at the last look."""
        answers = bool(self._workers)
        processes = [
            PartState(name, "running" if name != "daemon" or answers else "not answering yet", pid=child.pid)
            for name, child in self._children.items()
        ]
        return [*processes, *self._workers]

    def refresh(self, progress: DemoProgress) -> None:
        """Ask the daemon, now and then, and note what is new."""
        now = time.monotonic()
        if now - self._asked < _ASK_EVERY:
            return
        self._asked = now
        status = ask_daemon(self._config) if "daemon" in self._children else None
        if status is not None:
            self._workers = [
                PartState(clean(worker["worker"]), worker["phase"], clean(worker["text"]), worker["pid"], worker["restarts"])
                for worker in status["workers"]
                if worker["phase"] != Phase.OFF.value
            ]
        for part in self.all:
            progress.note(part.name, f"{part.phase} {part.text}")
        for name, child in self._children.items():
            for line in child.last_output().splitlines():
                progress.note(name, line)
        coming = [part.pid for part in self.all if part.coming]
        progress.note_work(pid for worker in (*coming, *self.starting) for pid in _with_children(worker))

    def up(self, name: str) -> bool:
        """Whether a worker runs."""
        return any(part.name == name and part.phase == Phase.UP.value for part in self._workers)

    @property
    def failed(self) -> PartState | None:
        """One that failed."""
        return next((part for part in self._workers if part.failed), None)

    def failure_text(self, part: PartState) -> str:
        """What to say of a part that failed."""
        again = f" (started again {part.restarts} times)" if part.restarts else ""
        return "\n".join([f"{part}{again}", *self._log_lines([part]), _TRY])

    def stall_text(self, what: str) -> str:
        """What to say where nothing has moved while something was waited for."""
        blamed = [part for part in self.all if part.idle] or self.all
        still = f"nothing has moved for {STILL_SECONDS:.0f} s, and {what} is not there:"
        return "\n".join([still, *(f"  {part}" for part in blamed), *self._log_lines(blamed), _TRY])

    def _log_lines(self, blamed: Iterable[PartState]) -> list[str]:
        """The last lines of the daemon's log, of these parts where there are any of theirs."""
        if "daemon" not in self._children:
            return []
        lines = self._children["daemon"].last_output().splitlines()
        theirs = [line for line in lines if any(part.name in line for part in blamed)] or lines
        return ["The last words of the log:", *(f"  {line}" for line in theirs[-_LAST_LINES:])]


def _with_children(pid: int) -> list[int]:
    """A process and all below it; of the daemon's guard that is the daemon, too."""
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
        if sandbox.config.ros1.enabled:
            master = guarded(SYSTEM_PYTHON, roscore(sandbox.config), "-p", str(sandbox.master_port))
            self._launch("roscore", master, sandbox.ros1_environment())
        daemon = guarded(sys.executable, "-m", "bridge.cli.main", "run", "--config", sandbox.config_file)
        self._launch("daemon", daemon, sandbox.environment())

    def _check_processes(self) -> None:
        """Raise `KeyboardInterrupt` where the demo is interrupted, `DemoError` where a process has ended."""
        self._shutdown.check()
        for child in self._children.values():
            if not child.running:
                raise DemoError(f"{child.name} ended before its time:\n{child.last_output()}")

    def _check(self, what: str) -> None:
        """Raise `DemoError` where something that is waited for will not come: a part failed, or nothing moves."""
        self._fail_with_a_part()
        if self._progress.stalled:
            raise DemoError(self._parts.stall_text(what))

    def _fail_with_a_part(self) -> None:
        failed = self._parts.failed
        if failed is not None:
            raise DemoError(self._parts.failure_text(failed))
