"""Resource use of a benchmark's processes: processor time, memory, threads and descriptors (Linux)."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import psutil
from typing_extensions import override

from benchmarks.footprints.measured import cpu_seconds
from bridge.demo.leftovers import marked

WORKERS = ("ros1", "ros2")
DAEMON = ("supervisor", "router", *WORKERS)
"""The processes of the daemon."""


@dataclass(frozen=True, slots=True)
class Usage:
    """A process's use over a period.

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

    @override
    def __str__(self) -> str:
        return f"{self.cpu:6.2f} % CPU  {self.rss:7.1f} MB  {self.threads:4d} threads  {self.descriptors:5d} files"


class Meter:
    """Measures processes over a period.

    Args:
        pids: the processes by name; see `processes`.

    Attributes:
        seconds: length of the last measurement.
    """

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._processes = {name: psutil.Process(pid) for name, pid in pids.items()}
        self.seconds = 0.0
        self.start()

    def start(self) -> None:
        """Start a new measurement."""
        self._began = time.monotonic()
        self._seconds = {name: cpu_seconds(process.pid) for name, process in self._processes.items()}

    def read(self) -> dict[str, Usage]:
        """Return each process's use since the start."""
        self.seconds = passed = time.monotonic() - self._began
        return {
            name: Usage(
                100 * (cpu_seconds(process.pid) - self._seconds[name]) / passed,
                process.memory_info().rss / 1e6,
                process.num_threads(),
                process.num_fds(),
            )
            for name, process in self._processes.items()
        }


def text(title: str, used: Mapping[str, Usage]) -> str:
    """Return the figures of every process, one per line."""
    return "\n".join([f"{title}:", *(f"  {name:<22}{usage}" for name, usage in used.items())])


def total(used: Mapping[str, Usage], names: tuple[str, ...]) -> float:
    """Return the total processor time of some processes, in percent of one core."""
    return sum(used[name].cpu for name in names)


def processes(folder: Path) -> dict[str, int]:
    """Return the process ids, by name, of the daemon's processes and the ROS master of the run in this folder."""
    result = _named(folder)
    return {name: result[name] for name in (*DAEMON, "rosmaster")}


def daemon_processes(folder: Path) -> dict[str, int]:
    """Return the process ids of the daemon's workers by name, and of the daemon itself as `daemon`."""
    result = {"daemon" if name == "supervisor" else name: pid for name, pid in _named(folder).items()}
    return {name: pid for name, pid in result.items() if name not in ("", "rosmaster")}


def _named(folder: Path) -> dict[str, int]:
    return {_name(Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8").split("\0")): pid for pid in marked(folder)}


def _name(command: list[str]) -> str:
    if "bridge.cli.child" in command and "worker" in command:
        return command[command.index("worker") + 1]
    if command[1:4] == ["-m", "bridge.cli.main", "run"]:
        return "supervisor"
    return "rosmaster" if any(argument.endswith("rosmaster") for argument in command) else ""
