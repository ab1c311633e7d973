"""What one process takes of the machine, as the kernel counts it (Linux)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import psutil

_FIGURE = re.compile(r"^(Pss|Rss): +(\d+) kB", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Taken:
    """What a process has taken so far.

    Attributes:
        pss: its memory in MB, what it shares with others in parts; the sum over all processes is what is taken.
        rss: its memory in MB, what it shares counted whole.
        seconds: processor time.
    """

    pss: float
    rss: float
    seconds: float


def taken(pid: int) -> Taken:
    """What a process has taken by now."""
    figures = {name: int(value) / 1024 for name, value in _FIGURE.findall(_text(pid))}
    return Taken(figures["Pss"], figures["Rss"], cpu_seconds(pid))


def cpu_seconds(pid: int) -> float:
    """Processor time of a process, s."""
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def _text(pid: int) -> str:
    return Path(f"/proc/{pid}/smaps_rollup").read_text()
