"""Finds and removes the leftovers of a demo's run: processes, and files in shared memory."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import time
from pathlib import Path

import psutil

from bridge.demo.sandbox import MARK

_MEMORY = Path("/dev/shm")  # noqa: S108 - where the system keeps POSIX shared memory
_MAPPED = re.compile(rf"{_MEMORY}/\S+")
_OWN = re.compile(r"\d+\.zenoh|fastrtps_[0-9a-f]{16}(_el)?")
"""zenoh's pools and Fast DDS's segments; their names are never reused."""
_END_SECONDS = 0.5
"""Seconds to wait for the end of killed processes and of other uses of their files."""

_LOCK = "_el"
_PORT = re.compile(r"(?:sem\.)?fastrtps_port(\d+)(?:_el|_mutex)?")


def erase(folder: Path, ports: range) -> list[str]:
    """End the remaining processes of a run at once and remove its files in shared memory; return the processes' names.

    Processes are suspended before they are killed, so that none starts another or creates a file meanwhile.
    """
    stopped: list[psutil.Process] = []
    while new := [pid for pid in marked(folder) if pid not in {process_.pid for process_ in stopped}]:
        for pid in new:
            with contextlib.suppress(psutil.Error):
                stopped.append(psutil.Process(pid))
                stopped[-1].suspend()
    used = {file for process in stopped for file in used_by(process.pid)}
    memory = {file for file in used if is_own(file.name, ports)} | _of_ports(ports)
    shared = _shared_ports(used - memory)
    names = []
    for process in stopped:
        with contextlib.suppress(psutil.Error):
            names.append(f"{process.name()} ({process.pid})")
            process.kill()
    end = time.monotonic() + _END_SECONDS
    while True:
        remove_unused(memory)
        remove_unread(shared)
        memory, shared = ({file for file in files if file.exists()} for files in (memory, shared))
        if not (memory or shared or marked(folder)) or time.monotonic() > end:
            return names
        time.sleep(0.02)


class SharedMemory:
    """A run's files in shared memory (Linux), which are known only while its processes use them.

    Attributes:
        own: the files noted so far that only this run uses.
    """

    def __init__(self, folder: Path, ports: range) -> None:
        self._folder, self._ports = folder, ports
        self.own: set[Path] = set()
        self._shared: set[Path] = set()
        """The files of Fast DDS ports that other programs may use too."""

    def note(self) -> None:
        """Add the files that the run's processes use now."""
        used = {file for pid in marked(self._folder) for file in used_by(pid)}
        own_files = {file for file in used if is_own(file.name, self._ports)}
        self.own, self._shared = self.own | own_files, self._shared | _shared_ports(used - own_files)

    def remove(self) -> None:
        """Remove the files once the processes have ended; may be called on any thread.

        This is retried, because another program's zenoh session uses all of these files for a moment when it opens.
        """
        end = time.monotonic() + _END_SECONDS
        while True:
            remove_unused(self.own)
            remove_unread(self._shared)
            if time.monotonic() > end or not any(file.exists() for file in self.own):
                return
            time.sleep(0.02)


def _shared_ports(files: set[Path]) -> set[Path]:
    return {_MEMORY / f"fastrtps_port{match[1]}" for file in files if (match := _PORT.fullmatch(file.name))}


def remove_unused(files: set[Path]) -> list[Path]:
    """Remove the files that no other process uses; return those that existed."""
    unused = {file for file in files if file.exists()}
    if unused:
        unused -= {file for pid in psutil.pids() if pid != os.getpid() for file in used_by(pid)}
    for file in unused:
        file.unlink(missing_ok=True)
    return sorted(unused)


def marked(folder: Path) -> list[int]:
    """Return the process ids of a run's living processes."""
    pids = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.pid != os.getpid() and process.environ().get(MARK) == str(folder):
                pids.append(process.pid)
    return pids


def is_own(name: str, ports: range) -> bool:
    """Return whether a file in shared memory has a name that only the run's files can have."""
    port = _PORT.fullmatch(name)
    return bool(_OWN.fullmatch(name)) or (port is not None and int(port[1]) in ports)


def _of_ports(ports: range) -> set[Path]:
    """Return the files of a ROS domain's ports; a run owns all files of the domain that it holds, in use or not."""
    matches = {file: _PORT.fullmatch(file.name) for file in _MEMORY.iterdir()} if _MEMORY.is_dir() else {}
    return {file for file, port in matches.items() if port is not None and int(port[1]) in ports}


def remove_unread(ports: set[Path]) -> None:
    """Remove the files of those Fast DDS ports that have no reader; a reader holds its port's lock.

    In addition to its domain's ports, each participant uses the machine's first free port, from 7000 on. A participant
    that ended between creating and locking the port leaves no lock, so the port is locked here while it is removed: a
    new participant then sees the port as used, and tries the next.
    """
    for port in ports:
        lock = port.with_name(port.name + _LOCK)
        with contextlib.suppress(OSError), lock.open("ab") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for name in (port.name, f"sem.{port.name}_mutex", lock.name):
                (_MEMORY / name).unlink(missing_ok=True)


def used_by(pid: int) -> set[Path]:
    """Return the files in shared memory that a process uses."""
    used: set[Path] = set()
    with contextlib.suppress(OSError):
        used.update(map(Path, _MAPPED.findall(Path(f"/proc/{pid}/maps").read_text(encoding="utf-8"))))
    with contextlib.suppress(OSError):
        for descriptor in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                used.add(descriptor.readlink())
    return {file for file in used if file.parent == _MEMORY}
