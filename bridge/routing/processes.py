"""Process names, by which workers on the same machine detect at once that another worker's process has exited.

The name of a process contains the machine's boot id, the PID namespace, the process id and its start time, so that it
is invalid on other machines and in other containers, and does not match a reused id (proc(5)).
"""

from __future__ import annotations

import os
from pathlib import Path

_PROC = Path("/proc")


def process_name(pid: int = 0) -> str:
    """Return the name of a process, by default the calling process; "" if the system has no /proc."""
    pid = pid or os.getpid()
    place, started = process_space(), _start_of(pid)
    return f"{place} {pid} {started}" if place and started else ""


def has_ended(name: str) -> bool:
    """Return whether a process on this machine has ended; False if that cannot be determined here."""
    place, _, process = name.rpartition(" ")[0].rpartition(" ")
    pid, started = process, name.rpartition(" ")[2]
    return (
        bool(place) and place == process_space() and pid.isascii() and pid.isdigit() and _start_of(int(pid)) != started
    )


def process_space() -> str:
    """Return the machine's boot id and the PID namespace, within which process ids are unique; "" if unknown."""
    try:
        boot = (_PROC / "sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
        return f"{boot} {(_PROC / 'self/ns/pid').stat().st_ino}"
    except OSError:
        return ""


def _start_of(pid: int) -> str:
    """Return the start time of a process in the kernel's ticks, "" if it does not exist or is a zombie."""
    try:
        fields = (_PROC / str(pid) / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if len(fields) < 20 or fields[0] in "ZX" else fields[19]
