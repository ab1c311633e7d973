"""What a run of the demo could leave behind: processes, and files in shared memory."""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

import psutil

from bridge.demo.place import MARK

_MEMORY = Path("/dev/shm")  # noqa: S108 - where the system keeps POSIX shared memory
_MAPPED = re.compile(rf"{_MEMORY}/\S+")
_OWN = re.compile(r"\d+\.zenoh|fastrtps_[0-9a-f]{16}(_el)?")
"""zenoh's pools and Fast DDS's segments; their names are never used again."""
_PORT = re.compile(r"(?:sem\.)?fastrtps_port(\d+)(?:_el|_mutex)?")


def sweep(folder: Path) -> list[str]:
    """End what is left of the processes that were started for a run in this folder; returns their names."""
    left = []
    for pid in marked(folder):
        with contextlib.suppress(psutil.Error):
            process = psutil.Process(pid)
            left.append(f"{process.name()} ({process.pid})")
            process.kill()
            process.wait(2.0)
    return left


def shared_memory(folder: Path, ports: range) -> set[Path]:
    """Files in shared memory that are a run's own and in use now (Linux; empty elsewhere).

    Args:
        folder: the run's.
        ports: those of its ROS domain; other ports' files are everybody's.
    """
    return {file for pid in marked(folder) for file in _used_by(pid) if is_own(file.name, ports)}


def remove_unused(files: set[Path]) -> list[Path]:
    """Remove those files that are still there and that no process uses; returns them."""
    there = {file for file in files if file.exists()}
    if there:
        there -= {file for pid in psutil.pids() for file in _used_by(pid)}
    for file in there:
        file.unlink(missing_ok=True)
    return sorted(there)


def marked(folder: Path) -> list[int]:
    """Process ids of a run's living processes."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.pid != os.getpid() and process.environ().get(MARK) == str(folder):
                found.append(process.pid)
    return found


def is_own(name: str, ports: range) -> bool:
    """Whether a file's name in shared memory can only be a run's own."""
    port = _PORT.fullmatch(name)
    return bool(_OWN.fullmatch(name)) or (port is not None and int(port[1]) in ports)


def _used_by(pid: int) -> set[Path]:
    used: set[Path] = set()
    with contextlib.suppress(OSError):
        used.update(map(Path, _MAPPED.findall(Path(f"/proc/{pid}/maps").read_text())))
    with contextlib.suppress(OSError):
        for descriptor in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                used.add(descriptor.readlink())
    return {file for file in used if file.parent == _MEMORY}
