"""The daemon's line to a worker that outlives it: found by its control socket, or started for that socket."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from bridge.config.model import Config
from bridge.daemon import log, state
from bridge.daemon.link import Exit, Link, LinkListener, kill_group, read_some
from bridge.daemon.lock import Lock
from bridge.daemon.loop import Loop
from bridge.daemon.protocol import Hello, Lines, Log, NewConfig, Owner, ProtocolError, decode_report, encode_command
from bridge.daemon.workers import WorkerKind, child_command

logger = logging.getLogger("midspan.daemon")

_LAST_WORDS = 4096


class OutlivingLink(Link):
    """A worker with a control socket, started by this daemon, by an earlier one, or by a service of its own."""

    def __init__(self, loop: Loop, listener: LinkListener, kind: WorkerKind, config: Config) -> None:
        super().__init__(loop, listener)
        self._path = state.control_socket(config, kind.name)
        self._output = state.worker_output(config, kind.name)
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._lines = Lines()
        self._pid = 0
        self._owner: Owner = "daemon"
        self._connected = False

    def adopt(self) -> bool:
        """Connect to a worker that is already there; False where none is."""
        sock = _connect(self._path)
        if sock is None:
            return False
        self._socket = sock
        self._connected = True
        self._loop.on_readable(sock.fileno(), self._read)
        self._flush()
        return True

    def spawn(self, kind: WorkerKind, config: Config, env: Mapping[str, str], lock: Lock) -> None:
        """Start one; `poll` connects to it as soon as its socket is there."""
        with self._open_output() as output, _unnamed_file() as first:
            first.write(encode_command(NewConfig(config)))
            first.seek(0)
            self._process = subprocess.Popen(
                child_command(kind.name, "--supervised", "--control"),
                stdin=first,
                stdout=subprocess.DEVNULL,
                stderr=output,
                env=dict(env),
                start_new_session=True,
                pass_fds=(lock.fileno(),),
            )
        self._pid = self._process.pid
        lock.write(self._pid, "daemon")

    def _open_output(self) -> IO[bytes]:
        """Where its stderr goes: to nobody where the state folder takes no file."""
        try:
            return self._output.open("wb")
        except OSError as err:
            logger.warning("cannot write %s: %s; the worker's last words will not be told", self._output, err.strerror)
            return Path(os.devnull).open("wb")

    @property
    def pid(self) -> int:
        """Process id, 0 before an adopted one has told it."""
        return self._pid

    @property
    def owner(self) -> Owner:
        """Who started it."""
        return self._owner

    def _writer(self) -> int:
        return self._socket.fileno() if self._socket is not None else -1

    def _read(self) -> None:
        data = read_some(self._writer())
        if data is None:
            return
        if not data:
            self._disconnect()
            self.poll()
            return
        for line in self._lines.feed(data):
            self._take(line)

    def _take(self, line: bytes) -> None:
        try:
            report = decode_report(line)
        except ProtocolError:
            self._report(line)
            return
        if isinstance(report, Hello):
            self._pid, self._owner = report.pid, report.owner
        self._listener.on_report(report)

    def poll(self) -> None:
        """Look whether the process has ended; connect where that is not done yet."""
        if self._process is not None:
            code = self._process.poll()
            if code is not None:
                self._tell_last_words()
                self.detach()
                self._listener.on_gone(Exit(code))
                return
        if self._socket is None and not self.adopt() and self._connected and self._process is None:
            self._listener.on_gone(Exit(None))

    def _tell_last_words(self) -> None:
        with contextlib.suppress(OSError), self._output.open("rb") as output:
            output.seek(max(0, output.seek(0, os.SEEK_END) - _LAST_WORDS))
            for line in output.read().decode(errors="replace").splitlines():
                self._listener.on_report(Log(*log.split_priority(line)))

    def kill(self, number: signal.Signals) -> None:
        """Send a signal."""
        if self._pid:
            kill_group(self._pid, number)

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._loop.forget(self._socket.fileno())
            self._socket.close()
            self._socket = None

    def detach(self) -> None:
        """Close the connection; the worker goes on."""
        self._disconnect()


def _unnamed_file() -> IO[bytes]:
    """A file for a child to read; in memory where the system has such, whatever the disks are like."""
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
