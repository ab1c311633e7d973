"""Forks the workers of a forked daemon, because imports take most of a worker's start.

`install` runs in the daemon's process, which has imported the workers' modules and has no other thread. A worker is a
child with its own session, environment, pipes and lock, as if it had been started. It shares no state with the daemon,
which uses only modules of `bridge.daemon` and `bridge.config`. A worker is started as usual if its environment differs
from the daemon's in variables that Python or the dynamic linker read at a start.
"""

from __future__ import annotations

import atexit
import gc
import logging
import os
import runpy
import signal
import subprocess
import sys
import traceback
import weakref
from collections.abc import Mapping, Sequence
from typing import IO, Any, NoReturn

from tests.support import fork_server

WORKERS = (
    "bridge.adapters.ros1.edge", "bridge.adapters.ros2.edge", "bridge.adapters.worker", "bridge.adapters.yarp.edge",
    "bridge.adapters.zenoh.dialects", "bridge.cli.daemon.run", "bridge.hub.router", "bridge.modules.worker",
    "bridge.record.worker", "navigation.base_control.module", "navigation.gateway.module",
    "navigation.localization_server.module", "navigation.map2d_server.module", "navigation.robot_goto.module",
    "navigation.robot_path_planner.module", "sim.simulator", "dartpy", "numpy.random", "rosbags.interfaces",
)  # fmt: skip
"""Modules of workers to import before the daemon is forked."""

_AT_START = ("PYTHON", "LD_", "MALLOC_", "GLIBC_", "MIDSPAN_")
"""Prefixes of variables that a process reads at its start or at imports."""

_PATHS = {"LD_LIBRARY_PATH", "PYTHONPATH"}
_CHILD = "bridge.cli.child"


class ForkedWorker:
    """A forked worker, with the part of `subprocess.Popen` that the daemon uses."""

    def __init__(self, pid: int, stdin: IO[bytes] | None, stdout: IO[bytes] | None, stderr: IO[bytes] | None) -> None:
        self.pid, self.stdin, self.stdout, self.stderr = pid, stdin, stdout, stderr
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, or None while the worker runs."""
        return self._wait(os.WNOHANG)

    def wait(self) -> int:
        """Wait until the worker exits, and return the exit code."""
        code = self._wait(0)
        assert code is not None
        return code

    def _wait(self, options: int) -> int | None:
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, options)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode


def install() -> None:
    """Let the daemon in this process fork its workers."""
    from bridge.daemon import worker_channel

    start = worker_channel._start

    def fork(command: list[str], env: Mapping[str, str], lock: Any, **stdio: Any) -> Any:
        if not can_fork(command, env):
            return start(command, env, lock, **stdio)
        process = _forked(command, env, lock.passed_on, stdio)
        lock.write(process.pid, "daemon")
        return process

    worker_channel._start = fork


def can_fork(command: Sequence[str], env: Mapping[str, str]) -> bool:
    """Return whether a command is that of a worker that can share this process's start."""
    return _CHILD in command and _early(env) == _early(os.environ) and _libraries(env) <= _libraries(os.environ)


def _early(env: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that a process reads at its start or at imports, except search paths."""
    return {name: value for name, value in env.items() if name.startswith(_AT_START) and name not in _PATHS}


def _libraries(env: Mapping[str, str]) -> set[str]:
    return set(filter(None, env.get("LD_LIBRARY_PATH", "").split(os.pathsep)))


def _forked(
    command: list[str], env: Mapping[str, str], passed: Sequence[int], stdio: Mapping[str, Any]
) -> ForkedWorker:
    """Fork a worker; ``stdio`` are files or `subprocess.PIPE`, as for `subprocess.Popen`."""
    theirs: list[int] = []
    ours: list[IO[bytes] | None] = []
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if stdio[name] != subprocess.PIPE:
            theirs.append(os.dup(stdio[name].fileno()))
            ours.append(None)
            continue
        ends = os.pipe()
        theirs.append(ends[0 if number == 0 else 1])
        ours.append(os.fdopen(ends[1 if number == 0 else 0], "wb" if number == 0 else "rb", buffering=0))
    gc.freeze()  # otherwise the worker's collector writes to shared pages
    pid = os.fork()
    if pid == 0:
        _become(command, env, theirs, passed)
    gc.unfreeze()
    for descriptor in theirs:
        os.close(descriptor)
    return ForkedWorker(pid, *ours)


def _become(command: list[str], env: Mapping[str, str], stdio: Sequence[int], passed: Sequence[int]) -> NoReturn:
    """Run the worker in this process, as a newly started Python would."""
    code: object = 1
    try:
        os.setsid()
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGCHLD, signal.SIGUSR1):
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
        for number, descriptor in enumerate(stdio):
            os.dup2(descriptor, number)
        _close_others(passed)
        _forget_exit_handlers()
        _forget_logging()
        os.environ.clear()
        os.environ.update(env)
        fork_server.show(command)
        module = command.index(_CHILD)
        sys.argv = command[module:]
        sys.orig_argv = list(command)
        for path in reversed(env.get("PYTHONPATH", "").split(os.pathsep)):
            if path and path not in sys.path:
                sys.path.insert(0, path)
        del sys.modules["__main__"]
        runpy.run_module(_CHILD, run_name="__main__", alter_sys=True)
        code = 0
    except SystemExit as err:
        code = err.code
    except BaseException:
        traceback.print_exc()
    finally:
        fork_server.end(code if isinstance(code, int) else int(code is not None))


def _close_others(passed: Sequence[int]) -> None:
    """Close the daemon's descriptors."""
    first = 3
    for keep in sorted(passed):
        os.closerange(first, keep)
        first = keep + 1
    os.closerange(first, int(os.sysconf("SC_OPEN_MAX")))


def _forget_exit_handlers() -> None:
    """Remove the daemon's exit handlers, such as those of temporary folders, but keep the log's."""
    atexit._clear()
    weakref.finalize._registry.clear()  # type: ignore[attr-defined]
    weakref.finalize._registered_with_atexit = False  # type: ignore[attr-defined]
    atexit.register(logging.shutdown)


def _forget_logging() -> None:
    """Remove the daemon's log handlers."""
    for logger in [logging.getLogger(), *map(logging.getLogger, logging.root.manager.loggerDict)]:
        logger.handlers.clear()
        logger.filters.clear()
        logger.setLevel(logging.NOTSET)
    logging.root.setLevel(logging.WARNING)
