"""Forks Python test programs instead of starting them, because imports take most of a start.

For each interpreter and start environment (variables read by Python or the dynamic linker), one process imports the
programs' modules (`tests.support.fork_server`), and is forked for each program. A program has its own environment,
session, output and exit code, and shares no state with others: the process that is forked does not use the modules that
it imports.
"""

from __future__ import annotations

import array
import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

from tests.support.fork_server import PADDING
from tests.support.forked_workers import WORKERS

SERVER = Path(__file__).with_name("fork_server.py")
_TESTS = SERVER.parents[1]
PYTHONS = (sys.executable, "/usr/bin/python3")
"""The interpreters of Midspan and of ROS 1."""

DAEMON = ("bridge.config.load", "bridge.daemon.worker_main", "bridge.daemon.supervisor")
"""Imports of `midspan run` and of a single worker. A forked daemon starts its workers as usual."""

DAEMON_AND_WORKERS = (*DAEMON, *WORKERS)
"""Imports of `midspan run` that forks its workers, see `tests.support.forked_workers`."""

COMMAND = (
    *DAEMON, "bridge.client.session", "bridge.hub.router", "bridge.messages.json", "bridge.messages.registry", "numpy",
)  # fmt: skip
"""Imports of a command that queries a hub or a daemon, in addition to the command's own module."""

_AT_START = ("PYTHON", "LD_", "_ROS_WHEELS", "MALLOC_", "GLIBC_", "MIDSPAN_", "HIDDEN_OS")
"""Prefixes of variables that Python, the linker, Midspan or `tests.support.other_os` read at a start or import."""

_servers: dict[tuple[str, ...], Server] = {}
_lock = threading.Lock()
_commands: dict[int, str] = {}


def can_fork(args: Sequence[str]) -> bool:
    """Return whether a command is a Python test program; other commands are started as usual."""
    return len(args) > 1 and args[0] in PYTHONS and Path(args[1]).is_relative_to(_TESTS)


def close() -> None:
    """End all forked programs."""
    with _lock:
        for server in _servers.values():
            server.close()
        _servers.clear()


def command_of(pid: int) -> str:
    """Return the command of a forked program, which its process may show only in part."""
    return _commands.get(pid, "")


class Server:
    """A process that forks programs."""

    def __init__(self, python: str, env: Mapping[str, str]) -> None:
        self._log: IO[bytes] = tempfile.NamedTemporaryFile(prefix="midspan-test-", suffix=".log")  # noqa: SIM115
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [python, "-P", str(SERVER), str(theirs.fileno()), PADDING],
                env={**env, "OPENBLAS_NUM_THREADS": "1"},  # NumPy would start threads when it is imported
                stdin=subprocess.PIPE,
                stdout=self._log,
                stderr=self._log,
                start_new_session=True,
                pass_fds=(theirs.fileno(),),
            )

    def ask(self, request: bytes, descriptors: Sequence[int]) -> None:
        """Request the fork of a program."""
        packed = array.array("i", descriptors)
        self._control.sendmsg([request], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, packed)])

    def output(self) -> str:
        """Return the server's error output."""
        return Path(self._log.name).read_text(encoding="utf-8", errors="replace")

    @property
    def ended(self) -> bool:
        """Return whether the process has exited."""
        return self._process.poll() is not None

    def close(self) -> None:
        """End the process and all its programs."""
        self._control.close()
        self._process.wait()
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._log.close()


def server_for(python: str, env: Mapping[str, str], *, workers: bool = False) -> Server:
    """Return the process to fork from; processes for daemons with their workers also import what workers use."""
    early = {name: value for name, value in env.items() if name.startswith(_AT_START)}
    key = (python, "workers" if workers else "", *(f"{name}={early[name]}" for name in sorted(early)))
    with _lock:
        server = _servers.get(key)
        if server is None or server.ended:
            if server is not None:
                server.close()
            # other variables keep the test process's values, except ROS's, because an edge in that process has set its
            # own rmw, which rcl checks when it is imported
            foreign = (*_AT_START, "ROS_", "RMW_")
            others = {name: value for name, value in os.environ.items() if not name.startswith(foreign)}
            server = _servers[key] = Server(python, {**others, **early})
        return server


class Forked:
    """A forked program, with the part of `subprocess.Popen` that the tests use.

    Args:
        args: the interpreter; a file, or ``-m`` and a module; and the arguments.
        env: the program's environment.
        log: file for standard error, and for standard output unless it is piped.
        pipes: whether standard input and output are pipes of text.
        imports: modules to import beforehand, in addition to those that a file imports at its top.
    """

    def __init__(
        self,
        args: Sequence[str],
        env: Mapping[str, str],
        log: IO[bytes],
        *,
        pipes: bool = False,
        imports: Sequence[str] = (),
    ) -> None:
        self.args = list(args)
        self.returncode: int | None = None
        self.stdin: IO[str] | None = None
        self.stdout: IO[str] | None = None
        request = {"args": self.args[1:], "env": dict(env), "cwd": str(Path.cwd()), "imports": list(imports)}
        workers = set(WORKERS) <= set(imports)
        self._owner, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with contextlib.ExitStack() as passed:
            passed.enter_context(theirs)
            if pipes:
                (reads, our_in), (our_out, writes) = os.pipe(), os.pipe()
                self.stdin, self.stdout = os.fdopen(our_in, "w"), os.fdopen(our_out)
            else:
                reads, writes = os.open(os.devnull, os.O_RDONLY), os.dup(log.fileno())
            passed.callback(os.close, reads)
            passed.callback(os.close, writes)
            server = server_for(self.args[0], env, workers=workers)
            server.ask(
                json.dumps({**request, "workers": workers}).encode(), [reads, writes, log.fileno(), theirs.fileno()]
            )
        started = self._receive(None)
        if not started or "pid" not in started:
            for end in (self._owner, self.stdin, self.stdout):
                if end is not None:
                    end.close()
            msg = f"{' '.join(self.args)} was not forked: {server.output()}"
            raise AssertionError(msg)
        self.pid = started["pid"]
        _commands[self.pid] = " ".join(self.args)

    def _receive(self, seconds: float | None) -> dict[str, int] | None:
        """Return the server's next message about the process: None after a timeout, empty if the server has exited."""
        waiting = select.poll()
        waiting.register(self._owner, select.POLLIN)
        if not waiting.poll(None if seconds is None else max(0.0, seconds) * 1000):
            return None
        data = self._owner.recv(1 << 10)
        message: dict[str, int] = json.loads(data) if data else {}
        return message

    def poll(self) -> int | None:
        """Return the exit code, or None while the program runs."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait until the program exits, and return its exit code; raises `subprocess.TimeoutExpired`."""
        if self.returncode is None:
            message = self._receive(timeout)
            if message is None:
                assert timeout is not None
                raise subprocess.TimeoutExpired(self.args, timeout)
            self.returncode = message.get("code", -signal.SIGKILL)  # the server was killed, and its programs with it
            self._owner.close()
        return self.returncode

    def kill(self) -> None:
        """Send SIGKILL if the program still runs."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)
