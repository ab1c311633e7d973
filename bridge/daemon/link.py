"""The daemon's line to one worker's process, and the kind that is made of pipes."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import signal
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from bridge.daemon import log
from bridge.daemon.lock import Lock
from bridge.daemon.loop import Loop
from bridge.daemon.protocol import (
    Command,
    Lines,
    Log,
    Owner,
    ProtocolError,
    Report,
    decode_report,
    encode_command,
)
from bridge.daemon.workers import WorkerKind, child_command

logger = logging.getLogger("midspan.daemon")

READ_SIZE = 1 << 16
LONGEST_LOG_LINE = 8 << 10


@dataclass(frozen=True, slots=True)
class Exit:
    """How a worker's process ended.

    Attributes:
        code: as `subprocess.Popen.returncode`; None where it was no child of this daemon.
    """

    code: int | None

    def __str__(self) -> str:
        if self.code is None:
            return "ended"
        if self.code >= 0:
            return f"ended with exit code {self.code}"
        try:
            return f"killed by {signal.Signals(-self.code).name}"
        except ValueError:
            return f"killed by signal {-self.code}"


class LinkListener(Protocol):
    """What a link tells; called from the daemon's loop."""

    def on_report(self, report: Report) -> None:
        """The worker said something."""

    def on_gone(self, ended: Exit) -> None:
        """The worker's process has ended, and the link is closed."""


class Link(ABC):
    """One worker's process, as the daemon sees it."""

    def __init__(self, loop: Loop, listener: LinkListener) -> None:
        self._loop = loop
        self._listener = listener
        self._outgoing = b""

    @property
    @abstractmethod
    def pid(self) -> int:
        """Process id, 0 while it is not known."""

    @property
    @abstractmethod
    def owner(self) -> Owner:
        """Who started it, and so who stops it."""

    @abstractmethod
    def poll(self) -> None:
        """Look whether the process has ended; called often."""

    @abstractmethod
    def kill(self, number: signal.Signals) -> None:
        """Send a signal; SIGKILL reaches also what the worker started."""

    @abstractmethod
    def detach(self) -> None:
        """Close the link and let the process be."""

    @abstractmethod
    def _writer(self) -> int:
        """Descriptor that commands are written to, -1 where there is none (yet)."""

    def send(self, command: Command) -> None:
        """Send a command; never blocks, what does not fit now is sent when it does."""
        waiting = bool(self._outgoing)
        self._outgoing += encode_command(command)
        if not waiting:
            self._flush()

    def _flush(self) -> None:
        writer = self._writer()
        if writer < 0:
            return
        self._loop.on_writable(writer, None)
        try:
            while self._outgoing:
                self._outgoing = self._outgoing[os.write(writer, self._outgoing) :]
        except BlockingIOError:
            self._loop.on_writable(writer, self._flush)
        except OSError:
            self._outgoing = b""  # its end is seen by `poll`

    def _report(self, line: bytes) -> None:
        try:
            self._listener.on_report(decode_report(line))
        except ProtocolError as err:
            logger.warning("worker %d sent %s", self.pid, err)


def read_some(file: int) -> bytes | None:
    """What can be read now: None where nothing is there yet, empty at the end."""
    try:
        return os.read(file, READ_SIZE)
    except BlockingIOError:
        return None
    except OSError:
        return b""


def kill_group(pid: int, number: signal.Signals) -> None:
    """Signal a process that leads a group; SIGKILL goes to the whole group."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if number is signal.SIGKILL:
            os.killpg(pid, number)
        else:
            os.kill(pid, number)


class PipeLink(Link):
    """A child whose pipes are the protocol: it stops when this daemon ends, however it does."""

    def __init__(
        self, loop: Loop, listener: LinkListener, kind: WorkerKind, env: Mapping[str, str], lock: Lock
    ) -> None:
        super().__init__(loop, listener)
        self._process = subprocess.Popen(
            child_command(kind.name, "--supervised"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=dict(env),
            bufsize=0,
            start_new_session=True,  # a Ctrl-C in the daemon's terminal is the daemon's to handle
            pass_fds=(lock.fileno(),),
        )
        lock.write(self._process.pid, "daemon")
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._stdin = self._process.stdin.fileno()
        self._stdout = self._process.stdout.fileno()
        self._stderr = self._process.stderr.fileno()
        self._reports = Lines()
        self._log = Lines(LONGEST_LOG_LINE)
        for file in (self._stdin, self._stdout, self._stderr):
            fcntl.fcntl(file, fcntl.F_SETFL, fcntl.fcntl(file, fcntl.F_GETFL) | os.O_NONBLOCK)
        loop.on_readable(self._stdout, self._read_reports)
        loop.on_readable(self._stderr, self._read_log)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def owner(self) -> Owner:
        """Always this daemon."""
        return "daemon"

    def _writer(self) -> int:
        return self._stdin

    def _read_reports(self) -> None:
        data = read_some(self._stdout)
        if data == b"":
            self._loop.on_readable(self._stdout, None)
        for line in self._reports.feed(data or b""):
            self._report(line)

    def _read_log(self) -> None:
        data = read_some(self._stderr)
        if data == b"":
            self._loop.on_readable(self._stderr, None)
        lines = self._log.feed(data or b"") if data != b"" else self._log.end()
        for line in lines:
            self._listener.on_report(Log(*log.split_priority(line.decode(errors="replace"))))

    def poll(self) -> None:
        """Look whether the process has ended; then end what it left behind, and read its last words."""
        # Not reaped yet, so that its number still names its group.
        if os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            return
        kill_group(self.pid, signal.SIGKILL)
        code = self._process.wait()
        self._read_reports()
        self._read_log()
        for line in self._log.end():
            self._listener.on_report(Log(*log.split_priority(line.decode(errors="replace"))))
        self.detach()
        self._listener.on_gone(Exit(code))

    def kill(self, number: signal.Signals) -> None:
        """Send a signal."""
        kill_group(self.pid, number)

    def detach(self) -> None:
        """Close the pipes."""
        for file in (self._stdin, self._stdout, self._stderr):
            self._loop.forget(file)
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            assert pipe is not None
            pipe.close()
