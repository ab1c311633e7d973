"""The daemon's channel to one worker process: pipes, or the control socket of a worker that outlives the daemon."""

from __future__ import annotations

import contextlib
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
from typing import IO, Any, Protocol

from typing_extensions import override

from bridge import state_file
from bridge.config.model import Config
from bridge.daemon import local_socket, log, processes, protocol, streams
from bridge.daemon.exit_watch import ExitWatch
from bridge.daemon.lock import Lock
from bridge.daemon.workers import WorkerKind, supervised_command
from yarp_compat.selector_loop import SelectorLoop

logger = logging.getLogger("midspan.daemon")

LONGEST_LOG_LINE = 8 << 10


@dataclass(frozen=True, slots=True)
class Exit:
    """The end of a worker's process: `subprocess.Popen.returncode`, None if it is not a child of this daemon."""

    code: int | None

    @override
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
        """Handle a report from the worker."""

    def on_exit(self, ended: Exit) -> None:
        """Handle the exit of the worker's process; the channel is already closed."""


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
        self._commands: streams.Writer

    @property
    @abstractmethod
    def needs_polls(self) -> bool:
        """Whether `poll` has to be called often; otherwise the loop reports the exit of the process."""

    @abstractmethod
    def poll(self) -> None:
        """Check for the exit of the process."""

    def stop(self) -> None:
        self.send(protocol.Stop())
        if self.pid:
            processes.terminate(self.pid)

    def dump_stacks(self) -> None:
        """Let the process log the stacks of its threads."""
        if self.pid:
            processes.dump_stacks(self.pid)

    def kill(self) -> None:
        """Kill the process and its own child processes."""
        if self.pid:
            processes.kill(self.pid)

    @abstractmethod
    def detach(self) -> None:
        """Close the channel and leave the process running."""

    def send(self, command: protocol.Command) -> None:
        """Send a command without blocking."""
        self._commands.write(protocol.encode_command(command))

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


def _start(command: list[str], env: Mapping[str, str], lock: Lock, **stdio: Any) -> subprocess.Popen[bytes]:
    """Start a worker's process that inherits the lock, and that does not receive a Ctrl-C in the daemon's terminal."""
    process = subprocess.Popen(
        command,
        env=dict(env),
        bufsize=0,
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # on Windows
        pass_fds=lock.passed_on,
        **stdio,
    )
    lock.write(process.pid, "daemon")
    return process


class PipeChannel(WorkerChannel):
    """A child connected by pipes: it stops when this daemon exits, even if the daemon is killed."""

    def __init__(
        self, loop: SelectorLoop, listener: ChannelListener, kind: WorkerKind, env: Mapping[str, str], lock: Lock
    ) -> None:
        super().__init__(loop, listener)
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        self._process = _start(supervised_command(kind.name), env, lock, **pipes)
        self.pid, self.started_here = self._process.pid, True
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._reports = protocol.Lines()
        self._log = protocol.Lines(LONGEST_LOG_LINE)
        self._commands = streams.writer(loop, self._process.stdin)
        self._readers = (
            streams.reader(loop, self._process.stdout, self._on_reports),
            streams.reader(loop, self._process.stderr, self._on_log),
        )
        self._exit = ExitWatch(loop, self.pid, self.poll)

    def _on_reports(self, data: bytes) -> None:
        for line in self._reports.feed(data):
            self._report(line)

    def _on_log(self, data: bytes) -> None:
        self._log_lines(self._log.feed(data) if data else self._log.end())

    @property
    @override
    def needs_polls(self) -> bool:
        return not self._exit.active

    @override
    def poll(self) -> None:
        """Check for the exit of the process; then kill the rest of its group, and read its last output."""
        if not self._has_exited():
            return
        processes.kill(self.pid)
        code = self._process.wait()
        for reader in self._readers:
            reader.drain()
        self._log_lines(self._log.end())
        self.detach()
        self._listener.on_exit(Exit(code))

    def _has_exited(self) -> bool:
        if hasattr(os, "waitid"):  # does not reap the process, so that its id still names its group
            return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        return self._process.poll() is not None

    @override
    def detach(self) -> None:
        self._exit.close()
        for stream in (self._commands, *self._readers):
            stream.close()


_LAST_OUTPUT = 4096
_CONNECT_SECONDS = 0.25
"""Maximum time that the daemon's loop waits for a hung worker to accept a connection; Unix sockets need no wait."""


class SocketChannel(WorkerChannel):
    """A worker with a control socket, started by this daemon, by an earlier one, or by a separate service."""

    def __init__(self, loop: SelectorLoop, listener: ChannelListener, kind: WorkerKind, config: Config) -> None:
        super().__init__(loop, listener)
        self._path = state_file.control_socket(config, kind.name)
        self._output = state_file.worker_output(config, kind.name)
        self._process: subprocess.Popen[bytes] | None = None
        self._exit: ExitWatch | None = None
        self._start_reports: streams.Reader | None = None
        self._socket: socket.socket | None = None
        self._start_lines, self._lines = protocol.Lines(), protocol.Lines()
        self._connected = False
        self._newest: protocol.NewConfig | None = None
        self._to_socket = self._commands = streams.SelectedWriter(loop)

    def adopt(self) -> bool:
        """Connect to the worker; return False if it does not run."""
        try:
            sock = local_socket.connect(self._path, _CONNECT_SECONDS)
        except OSError:
            return False
        sock.setblocking(False)
        self._lines = protocol.Lines()  # the previous connection may have ended within a line
        self._socket = sock
        self._connected = True
        self._loop.on_readable(sock, self._read)
        self._to_socket.attach(sock, sock.send, sock.close)
        return True

    def spawn(self, kind: WorkerKind, config: Config, env: Mapping[str, str], lock: Lock) -> None:
        """Start a worker; `poll` connects to it as soon as its socket exists."""
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)  # left by a dead predecessor: another program may have its port now
        with self._open_output() as output, _unnamed_file() as first:
            first.write(protocol.encode_command(protocol.NewConfig(config)))
            first.seek(0)
            command = supervised_command(kind.name, "--control")
            self._process = _start(command, env, lock, stdin=first, stdout=subprocess.PIPE, stderr=output)
        self.pid, self.started_here = self._process.pid, True
        assert self._process.stdout is not None
        self._start_reports = streams.reader(self._loop, self._process.stdout, self._on_start)
        self._exit = ExitWatch(self._loop, self.pid, self.poll)

    def _open_output(self) -> IO[bytes]:
        """Open the file for the worker's stderr, or /dev/null if the state folder is not writable."""
        try:
            return self._output.open("wb")
        except OSError as err:
            logger.warning("cannot write %s: %s; the worker's last output will be lost", self._output, err.strerror)
            return Path(os.devnull).open("wb")

    def _on_start(self, data: bytes) -> None:
        """Handle the worker's reports until it has accepted the connection to its socket."""
        for line in self._start_lines.feed(data):
            self._report(line)

    def _close_start(self) -> None:
        if self._start_reports is not None:
            self._start_reports.close()
            self._start_reports = None

    def _read(self) -> None:
        assert self._socket is not None
        try:
            data = self._socket.recv(streams.READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._disconnect()
            self.poll()
            return
        for line in self._lines.feed(data):
            self._report(line)

    def _read_rest(self) -> None:
        """Read the last reports of a process that has exited; one of them may be the reason."""
        if self._start_reports is not None:
            self._start_reports.drain()
        data = b"-"
        while self._socket is not None and data:
            try:
                data = self._socket.recv(streams.READ_SIZE)
            except OSError:
                return
            for line in self._lines.feed(data):
                self._report(line)

    @override
    def _on_report(self, report: protocol.Report) -> None:
        if isinstance(report, protocol.Hello):
            self.pid, self.owner = report.pid, report.owner
            self._close_start()
        super()._on_report(report)

    @property
    @override
    def needs_polls(self) -> bool:
        return self._socket is None or (self._exit is not None and not self._exit.active)

    @override
    def poll(self) -> None:
        """Check for the exit of the process; connect if not connected yet."""
        if self._process is not None:
            code = self._process.poll()
            if code is not None:
                self._read_rest()
                self._log_last_output()
                self.detach()
                with contextlib.suppress(OSError):
                    self._path.unlink(missing_ok=True)  # a killed process leaves its socket
                self._listener.on_exit(Exit(code))
                return
        if self._socket is not None:
            return
        if self.adopt():
            if self._newest is not None:  # the previous connection may have ended before it arrived
                self.send(self._newest)
        elif self._connected and self._process is None:
            self._listener.on_exit(Exit(None))

    @override
    def send(self, command: protocol.Command) -> None:
        if isinstance(command, protocol.NewConfig):
            self._newest = command
        super().send(command)

    def _log_last_output(self) -> None:
        with contextlib.suppress(OSError), self._output.open("rb") as output:
            output.seek(max(0, output.seek(0, os.SEEK_END) - _LAST_OUTPUT))
            self._log_lines(output.read().splitlines())

    def _disconnect(self) -> None:
        self._to_socket.close()
        self._socket = None

    @override
    def detach(self) -> None:
        """Close the connection; the worker continues."""
        if self._exit is not None:
            self._exit.close()
        self._close_start()
        self._disconnect()


def _unnamed_file() -> IO[bytes]:
    """Open a temporary file for a child to read; in memory if possible, so that a full disk does not matter."""
    if sys.platform == "linux" and hasattr(os, "memfd_create"):  # a Python for an old glibc lacks it
        return os.fdopen(os.memfd_create("midspan"), "w+b")
    return tempfile.TemporaryFile()
