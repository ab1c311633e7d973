"""Forks test programs from a process that has already imported their modules, for `tests.support.forks`.

Argument: the descriptor of a packet socket. A request is ``{"args": .., "env": .., "cwd": .., "imports": [..]}`` in
JSON, with four descriptors: the program's standard input, output and error, and a socket that receives the program's
process id and later its exit code. ``args`` are Python's arguments: a file and its arguments, or ``-m``, a module and
its arguments. The server exits with all its programs once the packet socket is closed. It needs only Python's standard
library.
"""

from __future__ import annotations

import ast
import atexit
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
from collections.abc import Sequence
from importlib.abc import InspectLoader
from pathlib import Path
from typing import Any, NoReturn

ROOT = Path(__file__).resolve().parents[2]
LONGEST = 1 << 18
PADDING = " " * 400
"""Last argument of this program: in the list of processes, a forked program's command replaces this program's."""

_TYPED = (
    "builtin_interfaces", "geometry_msgs", "rcl_interfaces", "service_msgs", "std_msgs", "std_srvs",
    "type_description_interfaces",
)  # fmt: skip
"""Packages whose compiled part most nodes load."""

_LATER = {
    "rclpy": (
        "lark", "em", "rosidl_generator_py", "service_msgs.msg", "std_msgs.msg", "std_srvs.srv", "geometry_msgs.msg",
        "type_description_interfaces.msg",
        *(f"{package}.{package}_s__rosidl_typesupport_c" for package in _TYPED),
    ),
    "rospy": ("configparser", "encodings.idna", "std_msgs.msg", "geometry_msgs.msg", "std_srvs.srv"),
    "bridge.adapters.worker": (
        "bridge.config.sections.clock", "bridge.config.sections.hub", "bridge.config.sections.listen",
        "bridge.config.sections.ros", "bridge.metrics.on_demand", "encodings.idna", "encodings.utf_8_sig",
        "rosbags.interfaces",
    ),
    "bridge.adapters.ros1.edge": ("bridge.adapters.ros1.parameters.store", "bridge.adapters.ros1.topics.publisher"),
}  # fmt: skip
"""Modules that most programs with a module import while they run."""

_PR_SET_PDEATHSIG = 1

_seen: set[Path] = set()


def main() -> None:
    """Serve requests; in each forked process, run the requested program."""
    control = socket.socket(fileno=int(sys.argv[1]))
    request = Server(control).run()
    if request is not None:
        become(request)


class Server:
    """The process from which programs are forked. It has one thread, and does not use the modules that it imports."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._poll = select.poll()
        self._poll.register(control, select.POLLIN)
        self._programs: dict[int, tuple[int, socket.socket]] = {}
        """Process ID and notified socket of each program, by its pidfd."""

    def run(self) -> dict[str, Any] | None:
        """Serve until the control socket is closed, and return None; in each forked process, return its request."""
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
        """Fork a process for a program; return True in that process."""
        prepare(request)
        gc.collect()
        gc.freeze()  # otherwise each process's collector writes to shared pages
        wait_for_quiet(request)
        mine, owner = os.getpid(), socket.socket(fileno=passed[3])
        process = os.fork()
        if process:
            for descriptor in passed[:3]:
                os.close(descriptor)
            ends = os.pidfd_open(process)
            self._programs[ends] = process, owner
            self._poll.register(ends, select.POLLIN)
            return False
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != mine:
            os._exit(1)  # the server exited before prctl took effect
        os.setsid()
        send(owner, {"pid": os.getpid()})  # signals reach the group from now on
        owner.close()
        self._control.close()
        for descriptor, (_, other) in self._programs.items():
            os.close(descriptor)
            other.close()
        for number, descriptor in enumerate(passed[:3]):
            os.dup2(descriptor, number)
            os.close(descriptor)
        return True

    def _ended(self, descriptor: int) -> None:
        process, owner = self._programs.pop(descriptor)
        self._poll.unregister(descriptor)
        os.close(descriptor)
        _, status = os.waitpid(process, 0)
        send(owner, {"code": os.waitstatus_to_exitcode(status)})
        owner.close()


def send(owner: socket.socket, message: dict[str, Any]) -> None:
    """Send a message to a program's owner, who may have closed the socket."""
    with contextlib.suppress(OSError):
        owner.send(json.dumps(message).encode())


def prepare(request: dict[str, Any]) -> None:
    """Import a program's modules: the requested ones, those at the top of its files, and those that it needs later."""
    names = list(request["imports"])
    if request["args"][0] != "-m":
        names += imported(Path(request["args"][0]))
    names += [later for name in names for later in _LATER.get(name, ())]
    for name in names:
        with contextlib.suppress(Exception):  # the program itself reports import errors
            importlib.import_module(name)


def wait_for_quiet(request: dict[str, Any]) -> None:
    """Wait until no other thread can hold a lock: Python has none, and those of LTTng, without its daemon, sleep."""
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline and threading.active_count() == 1:
        tasks = [task for task in Path("/proc/self/task").iterdir() if task.name != str(os.getpid())]
        if all((task / "stat").read_text().rpartition(") ")[2].startswith("S") for task in tasks):
            return
        time.sleep(0.001)
    sys.exit(f"{request['args']} cannot be forked, because one of its imports starts threads")


def imported(file: Path) -> list[str]:
    """Return the modules that a program imports, directly or through other files of the tests.

    This process does not import those files itself, because it may lack the search path that a program sets for them.
    """
    if file in _seen:
        return []
    _seen.add(file)
    names: list[str] = []
    for node in ast.parse(file.read_bytes()).body:
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            # a name may be that of a module
            modules = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for module in modules:
            if module.partition(".")[0] != "tests":
                names.append(module)
            elif (source := ROOT.joinpath(*module.split(".")).with_suffix(".py")).is_file():
                names += imported(source)
    return names


def become(request: dict[str, Any]) -> None:
    """Run the program in this process, as a newly started Python would."""
    show([sys.executable, *request["args"]])
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
    sys.argv, sys.orig_argv = args, [sys.executable, *request["args"]]  # used by programs that restart themselves
    sys.modules["__main__"] = module
    assert code is not None
    if request["workers"]:
        from tests.support.forked_workers import install

        install()
    number: int | None = 0
    try:
        exec(code, module.__dict__)
    except SystemExit as err:
        if not isinstance(err.code, int | None):
            raise  # Python prints the text
        number = err.code
    end(number or 0)


def end(code: int) -> NoReturn:
    """End the process as Python does after the main program, except that it keeps the imported modules.

    Freeing them would copy every page that the process still shares with the fork server, and take 0.1 s.
    """
    try:
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
        gc.collect()  # the program's own objects; the others are frozen
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code & 0xFF)


def show(command: Sequence[str]) -> None:
    """Show a command as this process's command, as far as it fits into the space of the fork server's command."""
    fields = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(") ")[2].split()
    begin, end = int(fields[45]), int(fields[46])  # arg_start and arg_end: fields 48 and 49 of proc(5)
    text = b"\0".join(word.encode() for word in command)[: end - begin - 1]
    ctypes.memset(begin, 0, end - begin)
    ctypes.memmove(begin, text, len(text))


if __name__ == "__main__":
    main()
