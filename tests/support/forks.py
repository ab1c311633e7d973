"""Python programs of the tests, forked where they would be started: most of a start goes into what they import.

For each interpreter and environment that Python or the dynamic linker read at a start, one process imports what the
programs import (`tests.support.fork_server`), and is forked for each of them. A program has its own environment,
session, output and exit code, and nothing of another: the process that is forked uses nothing of what it imports.
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

SERVER = Path(__file__).with_name("fork_server.py")
_TESTS = SERVER.parents[1]
PYTHONS = (sys.executable, "/usr/bin/python3")
"""Midspan's own, and ROS 1's."""

DAEMON = ("bridge.config.load", "bridge.daemon.process", "bridge.daemon.supervisor")
"""What `midspan run` and a worker that runs alone import. A daemon that is forked starts its workers as any does."""

_AT_START = ("PYTHON", "LD_", "_ROS_WHEELS", "MALLOC_", "GLIBC_", "MIDSPAN_")
"""Beginnings of the names of variables that Python, the linker or Midspan read as they start or are imported."""

_servers: dict[tuple[str, ...], Server] = {}
_lock = threading.Lock()
_names: dict[int, str] = {}


def possible(args: Sequence[str]) -> bool:
    """Whether such a command is a program of the tests in Python; others are started as their users start them."""
    return len(args) > 1 and args[0] in PYTHONS and Path(args[1]).is_relative_to(_TESTS)


def close() -> None:
    """End all that was forked."""
    with _lock:
        for server in _servers.values():
            server.close()
        _servers.clear()


def name_of(pid: int) -> str:
    """The command of a program that was forked, whose own process does not show it."""
    return _names.get(pid, "")


class Server:
    """A process that forks programs."""

    def __init__(self, python: str, env: Mapping[str, str]) -> None:
        self._log: IO[bytes] = tempfile.NamedTemporaryFile(prefix="midspan-test-", suffix=".log")  # noqa: SIM115
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [python, "-P", str(SERVER), str(theirs.fileno())],
                env={**env, "OPENBLAS_NUM_THREADS": "1"},  # NumPy would start threads when it is imported
                stdin=subprocess.PIPE,
                stdout=self._log,
                stderr=self._log,
                start_new_session=True,
                pass_fds=(theirs.fileno(),),
            )

    def ask(self, request: bytes, descriptors: Sequence[int]) -> None:
        """Have a program forked."""
        packed = array.array("i", descriptors)
        self._control.sendmsg([request], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, packed)])

    def output(self) -> str:
        """What it says where it fails."""
        return Path(self._log.name).read_text(errors="replace")

    @property
    def ended(self) -> bool:
        """Whether it is no more."""
        return self._process.poll() is not None

    def close(self) -> None:
        """End it, and with it all its programs."""
        self._control.close()
        self._process.wait()
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._log.close()


def server_for(python: str, env: Mapping[str, str]) -> Server:
    """The process to fork from."""
    early = {name: value for name, value in env.items() if name.startswith(_AT_START)}
    key = (python, *(f"{name}={early[name]}" for name in sorted(early)))
    with _lock:
        server = _servers.get(key)
        if server is None or server.ended:
            if server is not None:
                server.close()
            # the rest is as the tests' own, for what tells them from other processes
            others = {name: value for name, value in os.environ.items() if not name.startswith((*_AT_START, "ROS_"))}
            server = _servers[key] = Server(python, {**others, **early})
        return server


class Forked:
    """A forked program, with what the tests use of `subprocess.Popen`.

    Args:
        args: the interpreter; a file or ``-m`` and a module; its arguments.
        env: its environment.
        log: where its standard error goes, and its output where that is not piped.
        pipes: whether its input and output are pipes of text.
        imports: modules to import beforehand, beside those that a file imports at its top.
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
        self._told, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with contextlib.ExitStack() as passed:
            passed.enter_context(theirs)
            if pipes:
                (reads, our_in), (our_out, writes) = os.pipe(), os.pipe()
                self.stdin, self.stdout = os.fdopen(our_in, "w"), os.fdopen(our_out)
            else:
                reads, writes = os.open(os.devnull, os.O_RDONLY), os.dup(log.fileno())
            passed.callback(os.close, reads)
            passed.callback(os.close, writes)
            server = server_for(self.args[0], env)
            server.ask(json.dumps(request).encode(), [reads, writes, log.fileno(), theirs.fileno()])
        said = self._hear(None)
        if not said or "pid" not in said:
            for end in (self._told, self.stdin, self.stdout):
                if end is not None:
                    end.close()
            msg = f"{' '.join(self.args)} was not forked: {server.output()}"
            raise AssertionError(msg)
        self.pid = said["pid"]
        _names[self.pid] = " ".join(self.args)

    def _hear(self, seconds: float | None) -> dict[str, int] | None:
        """What is told of the process: None where nothing is in so many seconds, empty where nobody tells any more."""
        waiting = select.poll()
        waiting.register(self._told, select.POLLIN)
        if not waiting.poll(None if seconds is None else max(0.0, seconds) * 1000):
            return None
        data = self._told.recv(1 << 10)
        said: dict[str, int] = json.loads(data) if data else {}
        return said

    def poll(self) -> int | None:
        """The exit code, None while it runs."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; the exit code. Raises `subprocess.TimeoutExpired`."""
        if self.returncode is None:
            said = self._hear(timeout)
            if said is None:
                assert timeout is not None
                raise subprocess.TimeoutExpired(self.args, timeout)
            self.returncode = said.get("code", -signal.SIGKILL)  # who told is dead, and its programs with it
            self._told.close()
        return self.returncode

    def kill(self) -> None:
        """SIGKILL, where it still runs."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)
