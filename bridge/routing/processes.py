"""Names of processes, by which another worker on the machine knows at once that one has ended.

A process is named by the machine's boot id, the PID namespace, the id and the time of its start, so a name means
nothing to other machines and containers, and an id that was given again is no mistake (proc(5)).
"""

from __future__ import annotations

import os
from pathlib import Path

_PROC = Path("/proc")


def process_name(pid: int = 0) -> str:
    """The name of a process, by default of this one; "" where the system has none."""
    pid = pid or os.getpid()
    place, started = _place(), _started(pid)
    return f"{place} {pid} {started}" if place and started else ""


def has_ended(name: str) -> bool:
    """Whether a process of this machine has ended; False where that cannot be known from here."""
    place, _, process = name.rpartition(" ")[0].rpartition(" ")
    pid, started = process, name.rpartition(" ")[2]
    return bool(place) and place == _place() and pid.isascii() and pid.isdigit() and _started(int(pid)) != started


def _place() -> str:
    try:
        boot = (_PROC / "sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {(_PROC / 'self/ns/pid').stat().st_ino}"
    except OSError:
        return ""


def _started(pid: int) -> str:
    """Time of a process's start in the kernel's ticks, "" where there is no such process or only its remains."""
    try:
        words = (_PROC / str(pid) / "stat").read_text(errors="replace").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if len(words) < 20 or words[0] in "ZX" else words[19]
