"""A process's use of memory and processor, as counted by the kernel (Linux)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import psutil

_FIGURE = re.compile(r"^(Pss|Rss): +(\d+) kB", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class ProcessUsage:
    """A process's use so far.

    Attributes:
        pss: memory in MiB, with its share of shared pages; the sum over all processes is the total use.
        rss: memory in MiB, with all shared pages.
        seconds: processor time, seconds.
    """

    pss: float
    rss: float
    seconds: float


def process_usage(pid: int) -> ProcessUsage:
    """Return a process's use so far."""
    figures = {name: int(value) / 1024 for name, value in _FIGURE.findall(_text(pid))}
    return ProcessUsage(figures["Pss"], figures["Rss"], cpu_seconds(pid))


def cpu_seconds(pid: int) -> float:
    """Return a process's processor time, in seconds."""
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def _text(pid: int) -> str:
    return Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="utf-8")
