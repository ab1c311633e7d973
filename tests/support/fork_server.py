"""Forks programs of the tests from a process that has imported what they import; `tests.support.forks` asks it.

Argument: the descriptor of a socket of packets. A request is ``{"args": .., "env": .., "cwd": .., "imports": [..]}`` in
JSON, with four descriptors: the program's standard input, output and error, and a socket that is told the number of its
process, and later its exit code. ``args`` are those of Python: a file and its arguments, or ``-m``, a module and these.
It ends, and all its programs with it, once nobody can ask it any more. It runs with Python's standard library alone.
"""

from __future__ import annotations

import ast
import contextlib
import ctypes
import gc
import importlib.util
import json
import os
import select
import signal
import socket
import sys
import threading
import time
import types
from importlib.abc import InspectLoader
from pathlib import Path
from typing import Any

LONGEST = 1 << 18
_PR_SET_PDEATHSIG = 1

_seen: set[Path] = set()


def main() -> None:
    """Serve; go on as the program in each process that is forked."""
    control = socket.socket(fileno=int(sys.argv[1]))
    request = Server(control).run()
    if request is not None:
        become(request)


class Server:
    """The process from which the others are forked: it has one thread, and uses nothing of what it imports."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._poll = select.poll()
        self._poll.register(control, select.POLLIN)
        self._programs: dict[int, tuple[int, socket.socket]] = {}
        """By the descriptor that tells its end: each process, and whom to tell."""

    def run(self) -> dict[str, Any] | None:
        """Serve until nobody asks any more, and return None; in each forked process, return its request."""
        while True:
            for descriptor, _ in self._poll.poll():
                if descriptor in self._programs:
                    self._ended(descriptor)
                    continue
                data, passed, _, _ = socket.recv_fds(self._control, LONGEST, 4)
                if not data:
                    return None
                request: dict[str, Any] = json.loads(data)
                if self._fork(request, passed):
                    return request

    def _fork(self, request: dict[str, Any], passed: list[int]) -> bool:
        """Make a process for a program; True in that process."""
        prepare(request)
        gc.collect()
        gc.freeze()  # or the collector of each process would write to what they share
        wait_for_quiet(request)
        mine, told = os.getpid(), socket.socket(fileno=passed[3])
        process = os.fork()
        if process:
            for descriptor in passed[:3]:
                os.close(descriptor)
            ends = os.pidfd_open(process)
            self._programs[ends] = process, told
            self._poll.register(ends, select.POLLIN)
            return False
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != mine:
            os._exit(1)  # it ended before this process asked to be ended with it
        os.setsid()
        tell(told, {"pid": os.getpid()})  # signals reach the group from now on
        told.close()
        self._control.close()
        for descriptor, (_, other) in self._programs.items():
            os.close(descriptor)
            other.close()
        for number, descriptor in enumerate(passed[:3]):
            os.dup2(descriptor, number)
            os.close(descriptor)
        return True

    def _ended(self, descriptor: int) -> None:
        process, told = self._programs.pop(descriptor)
        self._poll.unregister(descriptor)
        os.close(descriptor)
        _, status = os.waitpid(process, 0)
        tell(told, {"code": os.waitstatus_to_exitcode(status)})
        told.close()


def tell(who: socket.socket, what: dict[str, Any]) -> None:
    """Say something to who asked for a program, and may have forgotten it."""
    with contextlib.suppress(OSError):
        who.send(json.dumps(what).encode())


def prepare(request: dict[str, Any]) -> None:
    """Import what a program will: what it names, and what its file and those beside it import at their tops."""
    names = list(request["imports"])
    if request["args"][0] != "-m":
        names += imported(Path(request["args"][0]))
    for name in names:
        with contextlib.suppress(Exception):  # the program says itself what it cannot import
            importlib.import_module(name)


def wait_for_quiet(request: dict[str, Any]) -> None:
    """No other thread may hold a lock: Python has none, and those of a tracer that is not there (LTTng) sleep."""
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline and threading.active_count() == 1:
        tasks = [task for task in Path("/proc/self/task").iterdir() if task.name != str(os.getpid())]
        if all((task / "stat").read_text().rpartition(") ")[2].startswith("S") for task in tasks):
            return
        time.sleep(0.001)
    sys.exit(f"{request['args']} imports something that starts threads, and cannot be forked after that")


def imported(file: Path) -> list[str]:
    """Modules that a program imports, and those of the files beside it, but not these: other programs have others."""
    if file in _seen:
        return []
    _seen.add(file)
    names: list[str] = []
    for node in ast.parse(file.read_bytes()).body:
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            modules = [node.module]
        for module in modules:
            beside = file.with_name(f"{module.partition('.')[0]}.py")
            names += imported(beside) if beside.is_file() else [module]
    return names


def become(request: dict[str, Any]) -> None:
    """Run the program in this process, as Python would that had just been started with it."""
    os.environ.clear()
    os.environ.update(request["env"])
    os.chdir(request["cwd"])
    args = request["args"]
    module = types.ModuleType("__main__")
    if args[0] == "-m":
        sys.path.insert(0, request["cwd"])
        spec = importlib.util.find_spec(args[1])
        assert spec is not None
        assert isinstance(spec.loader, InspectLoader)
        module.__spec__, module.__file__, args = spec, spec.origin, [str(spec.origin), *args[2:]]
        code = spec.loader.get_code(spec.name)
    else:
        sys.path.insert(0, str(Path(args[0]).parent))
        module.__file__ = args[0]
        code = compile(Path(args[0]).read_bytes(), args[0], "exec")
    sys.argv, sys.orig_argv = args, [sys.executable, *request["args"]]  # what a program runs itself again with
    sys.modules["__main__"] = module
    assert code is not None
    exec(code, module.__dict__)


if __name__ == "__main__":
    main()
