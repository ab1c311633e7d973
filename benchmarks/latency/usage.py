"""What a benchmark's processes take of the machine: processor time, memory, threads and descriptors (Linux)."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bridge.demo.traces import marked

_TICKS = os.sysconf("SC_CLK_TCK")
_USER, _SYSTEM = 11, 12  # proc(5): fields of /proc/PID/stat behind the command's name
WORKERS = ("ros1", "ros2")
DAEMON = ("supervisor", "router", *WORKERS)
"""The processes of the daemon."""


@dataclass(frozen=True, slots=True)
class Usage:
    """One process over a time.

    Attributes:
        cpu: processor time, in percent of one core.
        rss: memory at the end, in MB.
        threads: threads at the end.
        descriptors: open descriptors at the end.
    """

    cpu: float
    rss: float
    threads: int
    descriptors: int

    def __str__(self) -> str:
        return f"{self.cpu:6.2f} % CPU  {self.rss:7.1f} MB  {self.threads:4d} threads  {self.descriptors:5d} files"


class Meter:
    """Measures processes from one moment on.

    Args:
        pids: the processes by name; see `processes`.
    """

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._pids = dict(pids)
        self.start()

    def start(self) -> None:
        """Measure from now on."""
        self._began = time.monotonic()
        self._seconds = {name: _seconds(pid) for name, pid in self._pids.items()}

    def read(self) -> dict[str, Usage]:
        """What each process took since the start."""
        passed = time.monotonic() - self._began
        return {
            name: Usage(
                100 * (_seconds(pid) - self._seconds[name]) / passed,
                _memory(pid),
                sum(1 for _ in Path(f"/proc/{pid}/task").iterdir()),
                sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()),
            )
            for name, pid in self._pids.items()
        }


def text(title: str, used: Mapping[str, Usage]) -> str:
    """The figures of every process, a line each."""
    return "\n".join([f"{title}:", *(f"  {name:<22}{usage}" for name, usage in used.items())])


def total(used: Mapping[str, Usage], names: tuple[str, ...]) -> float:
    """Processor time of some processes together, in percent of one core."""
    return sum(used[name].cpu for name in names)


def processes(folder: Path) -> dict[str, int]:
    """Process ids of the daemon's processes and of the ROS master by their names, of those started in a folder."""
    found = {_name(Path(f"/proc/{pid}/cmdline").read_text().split("\0")): pid for pid in marked(folder)}
    return {name: found[name] for name in (*DAEMON, "rosmaster")}


def _name(words: list[str]) -> str:
    if "bridge.cli.main" in words and "worker" in words:
        return words[words.index("worker") + 1]
    if words[1:4] == ["-m", "bridge.cli.main", "run"]:
        return "supervisor"
    return "rosmaster" if any(word.endswith("rosmaster") for word in words) else ""


def _seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[_USER]) + int(fields[_SYSTEM])) / _TICKS


def _memory(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
