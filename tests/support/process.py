"""Processes that tests start: each has its own process group and output file, and is always stopped."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import threading
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from tests.support import forks
from tests.support.forks import Forked

_OUTPUT_CHARACTERS = 6000

DAEMON_SECONDS = 40.0
"""Seconds for a daemon's stop on a busy machine; it stops within `bridge.daemon.supervisor.STOP_SECONDS` otherwise."""

_running: weakref.WeakSet[Process] = weakref.WeakSet()


class Process:
    """A process with its own process group, whose stderr (and stdout, unless piped) goes to a file.

    Test programs, and programs with ``imports`` (modules to import before the fork), are forked; see
    `tests.support.forks`. Other programs are started.
    """

    popen: subprocess.Popen | Forked

    def __init__(
        self,
        args: Sequence[str | Path],
        env: Mapping[str, str] | None = None,
        *,
        pipes: bool = False,
        imports: Sequence[str] = (),
    ) -> None:
        self._log: IO[bytes] = tempfile.NamedTemporaryFile(prefix="midspan-test-", suffix=".log")  # noqa: SIM115
        self.args = [str(a) for a in args]
        if imports or forks.can_fork(self.args):
            self.popen = Forked(self.args, os.environ if env is None else env, self._log, pipes=pipes, imports=imports)
            _running.add(self)
            return
        self.popen = subprocess.Popen(
            self.args,
            env=None if env is None else dict(env),
            stdin=subprocess.PIPE if pipes else subprocess.DEVNULL,
            stdout=subprocess.PIPE if pipes else self._log,
            stderr=self._log,
            start_new_session=True,
            text=True if pipes else None,
        )
        _running.add(self)

    @property
    def pid(self) -> int:
        """Return the process ID, which is also the ID of the group."""
        return self.popen.pid

    def output(self) -> str:
        """Return what the process has written to its log so far."""
        return Path(self._log.name).read_text(encoding="utf-8", errors="replace")

    def signal(self, number: int) -> None:
        """Send a signal to the whole group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, number)

    def stop(self, seconds: float = 6.0) -> int:
        """Send SIGTERM, wait, then send SIGKILL to the group; return the exit code.

        A daemon needs `DAEMON_SECONDS`: its router outlives it if it is killed.
        """
        if self.popen.poll() is None:
            self.signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.popen.wait(seconds)
        self.signal(signal.SIGKILL)
        code = self.popen.wait()
        _running.discard(self)
        for pipe in (self.popen.stdin, self.popen.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        self._log.close()
        return code

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.stop()


def run_forked(
    args: Sequence[str | Path],
    env: Mapping[str, str] | None = None,
    *,
    imports: Sequence[str],
    seconds: float = 60.0,
) -> subprocess.CompletedProcess[str]:
    """Run a forked Python program until it exits, as `subprocess.run` runs a started one; its input is empty.

    Raises `subprocess.TimeoutExpired` after ``seconds``.
    """
    with Process(args, env, pipes=True, imports=imports) as process:
        assert process.popen.stdin is not None
        assert process.popen.stdout is not None
        process.popen.stdin.close()
        timer = threading.Timer(seconds, process.signal, (signal.SIGKILL,))
        timer.start()
        try:
            out = process.popen.stdout.read()
            code = process.popen.wait()
        finally:
            expired = not timer.is_alive()
            timer.cancel()
            timer.join()
        if expired:
            raise subprocess.TimeoutExpired(process.args, seconds, out, process.output())
        return subprocess.CompletedProcess(process.args, code, out, process.output())


def outputs() -> list[tuple[str, str]]:
    """Return the command and the last output of each process that was not stopped, to report a failed test."""
    sections = []
    for process in sorted(_running, key=lambda process: process.pid):
        with contextlib.suppress(OSError):
            if text := process.output()[-_OUTPUT_CHARACTERS:]:
                sections.append((f"process {process.pid}: {' '.join(process.args)[-200:]}", text))
    return sections


def is_stopped(pid: int) -> bool:
    """Return whether all threads of a process are stopped; some continue for a moment after SIGSTOP."""
    try:
        stats = [file.read_text() for file in Path(f"/proc/{pid}/task").glob("*/stat")]
    except OSError:  # a thread has ended meanwhile
        return False
    return all(stat.rpartition(") ")[2].startswith("T") for stat in stats)
