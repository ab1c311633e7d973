"""Which of the network's participants could never be reached through our shared memory.

Fast DDS offers shared memory to every participant whose GUID prefix begins with the same four bytes: those of this
host. It does not see that one belongs to another user, or to a container with a /dev/shm of its own, and then delivers
nothing without a word. The prefix's bytes 4 and 5 are the low half of the process id (seen with Fast DDS 2.14.5), so
a participant that can share memory with us has a process of our user with that id here.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from bridge.adapters.ros2.mark import is_marked

_HOST = slice(0, 4)
_PID = slice(4, 6)
_NOTE = "udp-alone"


def strangers(prefixes: Iterable[bytes], own: bytes, proc: Path = Path("/proc")) -> list[bytes]:
    """Those of this host's participants that no process of our user on this host can be."""
    return [
        prefix
        for prefix in prefixes
        if prefix[_HOST] == own[_HOST] and not is_marked(prefix) and not _is_ours(prefix, proc)
    ]


def _is_ours(prefix: bytes, proc: Path) -> bool:
    mine = os.geteuid()
    try:
        largest = int((proc / "sys/kernel/pid_max").read_text())
    except (OSError, ValueError):
        largest = 1 << 22
    for pid in range(int.from_bytes(prefix[_PID], "little"), largest + 1, 1 << 16):
        try:
            if (proc / str(pid)).stat().st_uid == mine:
                return True
        except OSError:
            continue
    return False


def note(folder: Path) -> None:
    """Have the next starts use UDP alone, until the machine is booted anew."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _NOTE).write_text(_boot())


def noted(folder: Path) -> bool:
    """Whether `note` was called since the machine was booted."""
    try:
        return (folder / _NOTE).read_text() == _boot()
    except OSError:
        return False


def _boot() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""
