"""The daemon's channel to one worker process: pipes, or the control socket of a worker that outlives the daemon."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import signal
import socket
import subprocess
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol

from typing_extensions import override

from bridge import state_file
from bridge.config.model import Config
from bridge.daemon import log, protocol
from bridge.daemon.lock import Lock
from bridge.daemon.workers import WorkerKind, supervised_command
from yarp_compat.selector_loop import SelectorLoop

logger = logging.getLogger("midspan.daemon")

READ_SIZE = 1 << 16
LONGEST_LOG_LINE = 8 << 10


@dataclass(frozen=True, slots=True)
class Exit:
    """The end of a worker's process: `subprocess.Popen.returncode`, None if it is not a child of this daemon."""

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


class ChannelListener(Protocol):
    """Callbacks of a channel, on the daemon's loop."""

    def on_report(self, report: protocol.Report) -> None:
        """Handle a report of the worker."""

    def on_exit(self, ended: Exit) -> None:
        """Handle the exit of the worker's process; the channel is closed by now."""


class WorkerChannel(ABC):
    """The daemon's connection to one worker process.

    Attributes:
        pid: process id, 0 while unknown.
        owner: who started the process, and will stop it.
        started_here: whether this daemon started the process.
    """

    def __init__(self, loop: SelectorLoop, listener: ChannelListener) -> None:
        self.pid = 0
        self.owner: protocol.Owner = "daemon"
        self.started_here = False
        self._loop = loop
        self._listener = listener
        self._outgoing = b""

    @abstractmethod
    def poll(self) -> None:
        """Check for the exit of the process; called often."""

    def kill(self, number: signal.Signals) -> None:
        """Send a signal; SIGKILL also goes to the worker's own child processes."""
        if self.pid:
            kill_group(self.pid, number)

    @abstractmethod
    def detach(self) -> None:
        """Close the channel and leave the process running."""

    @abstractmethod
    def _writer(self) -> int:
        """Descriptor that commands are written to, -1 before the connection."""

    def send(self, command: protocol.Command) -> None:
        """Send a command without blocking: data that the pipe cannot hold is sent later."""
        waiting = bool(self._outgoing)
        self._outgoing += protocol.encode_command(command)
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
            self._outgoing = b""  # `poll` detects the exit

    def _report(self, line: bytes) -> None:
        try:
            report = protocol.decode_report(line)
        except protocol.ProtocolError as err:
            logger.warning("worker %d sent %s", self.pid, err)
            return
        if isinstance(report, protocol.Unknown):
            logger.debug("worker %d sent a report of another version: %s", self.pid, ", ".join(report.keys))
        else:
            self._on_report(report)

    def _on_report(self, report: protocol.Report) -> None:
        self._listener.on_report(report)

    def _log_lines(self, lines: Iterable[bytes]) -> None:
        """Report the worker's lines on stderr as log lines."""
        for line in lines:
            self._listener.on_report(protocol.LogLine(*log.split_priority(line.decode(errors="replace"))))


def read_some(file: int) -> bytes | None:
    """Read without blocking: return None before data arrives, b"" at the end."""
    try:
        return os.read(file, READ_SIZE)
    except BlockingIOError:
        return None
    except OSError:
        return b""


def kill_group(pid: int, number: signal.Signals) -> None:
    """Send a signal to the leader of a process group; SIGKILL goes to the whole group."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if number is signal.SIGKILL:
            os.killpg(pid, number)
        else:
            os.kill(pid, number)


class PipeChannel(WorkerChannel):
    """A child connected by pipes: it stops when this daemon exits, even if the daemon is killed."""

    def __init__(
        self, loop: SelectorLoop, listener: ChannelListener, kind: WorkerKind, env: Mapping[str, str], lock: Lock
    ) -> None:
        super().__init__(loop, listener)
        self._process = subprocess.Popen(
            supervised_command(kind.name),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=dict(env),
            bufsize=0,
            start_new_session=True,  # only the daemon handles a Ctrl-C in its terminal
            pass_fds=(lock.fileno(),),
        )
        self.pid, self.started_here = self._process.pid, True
        lock.write(self.pid, "daemon")
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._stdin = self._process.stdin.fileno()
        self._stdout = self._process.stdout.fileno()
        self._stderr = self._process.stderr.fileno()
        self._reports = protocol.Lines()
        self._log = protocol.Lines(LONGEST_LOG_LINE)
        for file in (self._stdin, self._stdout, self._stderr):
            fcntl.fcntl(file, fcntl.F_SETFL, fcntl.fcntl(file, fcntl.F_GETFL) | os.O_NONBLOCK)
        loop.on_readable(self._stdout, self._read_reports)
        loop.on_readable(self._stderr, self._read_log)

    @override
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
        self._log_lines(self._log.feed(data) if data else self._log.end() if data == b"" else [])

    @override
    def poll(self) -> None:
        """Check for the exit of the process; then kill the rest of its group, and read its last output."""
        # Not reaped yet, so that its id still names its group.
        if os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            return
        kill_group(self.pid, signal.SIGKILL)
        code = self._process.wait()
        self._read_reports()
        self._read_log()
        self._log_lines(self._log.end())
        self.detach()
        self._listener.on_exit(Exit(code))

    @override
    def detach(self) -> None:
        for file in (self._stdin, self._stdout, self._stderr):
            self._loop.unwatch(file)
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            assert pipe is not None
            pipe.close()


_LAST_OUTPUT = 4096


class SocketChannel(WorkerChannel):
    """A worker with a control socket, started by this daemon, by an earlier one, or by a separate service."""

    def __init__(self, loop: SelectorLoop, listener: ChannelListener, kind: WorkerKind, config: Config) -> None:
        super().__init__(loop, listener)
        self._path = state_file.control_socket(config, kind.name)
        self._output = state_file.worker_output(config, kind.name)
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._lines = protocol.Lines()
        self._connected = False

    def adopt(self) -> bool:
        """Connect to the worker; return False if it does not run."""
        sock = _connect(self._path)
        if sock is None:
            return False
        self._close_start()
        self._socket = sock
        self._connected = True
        self._loop.on_readable(sock.fileno(), self._read)
        self._flush()
        return True

    def spawn(self, kind: WorkerKind, config: Config, env: Mapping[str, str], lock: Lock) -> None:
        """Start a worker; `poll` connects to it as soon as its socket exists."""
        with self._open_output() as output, _unnamed_file() as first:
            first.write(protocol.encode_command(protocol.NewConfig(config)))
            first.seek(0)
            self._process = subprocess.Popen(
                supervised_command(kind.name, "--control"),
                stdin=first,
                stdout=subprocess.PIPE,
                stderr=output,
                env=dict(env),
                start_new_session=True,
                pass_fds=(lock.fileno(),),
            )
        self.pid, self.started_here = self._process.pid, True
        lock.write(self.pid, "daemon")
        assert self._process.stdout is not None
        os.set_blocking(self._process.stdout.fileno(), False)
        self._loop.on_readable(self._process.stdout.fileno(), self._read_start)

    def _open_output(self) -> IO[bytes]:
        """Open the file for its stderr, /dev/null if the state folder is not writable."""
        try:
            return self._output.open("wb")
        except OSError as err:
            logger.warning("cannot write %s: %s; the worker's last output will be lost", self._output, err.strerror)
            return Path(os.devnull).open("wb")

    @override
    def _writer(self) -> int:
        return self._socket.fileno() if self._socket is not None else -1

    def _read_start(self) -> None:
        """Read the reports of its start, before its socket exists."""
        assert self._process is not None
        assert self._process.stdout is not None
        data = read_some(self._process.stdout.fileno())
        if data == b"":
            self._close_start()
        for line in self._lines.feed(data or b""):
            self._report(line)

    def _close_start(self) -> None:
        if self._process is not None and self._process.stdout is not None and not self._process.stdout.closed:
            self._loop.unwatch(self._process.stdout.fileno())
            self._process.stdout.close()
            self._lines = protocol.Lines()

    def _read(self) -> None:
        data = read_some(self._writer())
        if data is None:
            return
        if not data:
            self._disconnect()
            self.poll()
            return
        for line in self._lines.feed(data):
            self._report(line)

    @override
    def _on_report(self, report: protocol.Report) -> None:
        if isinstance(report, protocol.Hello):
            self.pid, self.owner = report.pid, report.owner
        super()._on_report(report)

    @override
    def poll(self) -> None:
        """Check for the exit of the process; connect if not connected yet."""
        if self._process is not None:
            code = self._process.poll()
            if code is not None:
                self._log_last_output()
                self.detach()
                self._listener.on_exit(Exit(code))
                return
        if self._socket is None and not self.adopt() and self._connected and self._process is None:
            self._listener.on_exit(Exit(None))

    def _log_last_output(self) -> None:
        with contextlib.suppress(OSError), self._output.open("rb") as output:
            output.seek(max(0, output.seek(0, os.SEEK_END) - _LAST_OUTPUT))
            self._log_lines(output.read().splitlines())

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._loop.unwatch(self._socket.fileno())
            self._socket.close()
            self._socket = None

    @override
    def detach(self) -> None:
        """Close the connection; the worker continues."""
        self._close_start()
        self._disconnect()


def _unnamed_file() -> IO[bytes]:
    """Open a temporary file for a child to read; on Linux in memory, so that a full disk does not matter."""
    return os.fdopen(os.memfd_create("midspan"), "w+b") if sys.platform == "linux" else tempfile.TemporaryFile()


def _connect(path: Path) -> socket.socket | None:
    sock = socket.socket(socket.AF_UNIX)
    sock.setblocking(False)  # a Unix socket connects at once or not at all
    try:
        sock.connect(str(path))
    except OSError:
        sock.close()
        return None
    return sock
