"""Cleans up the shared memory that killed zenoh sessions leave in ``/dev/shm``.

zenoh 1.10 keeps a session's shared memory in files ``<number>.zenoh``. Each process that uses such a file holds a lock
on it (flock). `clean` removes the unlocked files, as zenoh itself does when it uses shared memory. But a session that
received messages from another session holds the sender's pool until the receiving session closes, even if the sender
was killed (zenoh 1.10). So each killed sender costs another pool, until the memory is full; see `orphans`.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
import time
from pathlib import Path
from typing import NamedTuple

from bridge.hub.zenoh_config import POOL

FOLDER = Path("/dev/shm")  # noqa: S108 - the system's folder for POSIX shared memory
YOUNG_SECONDS = 5.0
"""A file younger than this may not be locked yet."""

RESTART = "restart this worker ('kill PID' with the pid in 'midspan status'; the daemon starts it again)"

NAME = re.compile(r"\d+\.zenoh")
_LOCK = re.compile(r"FLOCK\s+\S+\s+\S+\s+(\d+) ([0-9a-f]+):([0-9a-f]+):(\d+) ")


class _Inode(NamedTuple):
    """A file, identified by its device and its inode number."""

    major: int
    minor: int
    number: int


def room_trouble(size: int, folder: Path = FOLDER) -> str:
    """Return why ``size`` bytes do not fit into the system's shared memory, and how to fix that, or ""."""
    if sys.platform != "linux":  # other systems do not expose it as a folder
        return ""
    try:
        room = os.statvfs(folder)
    except OSError as err:
        return f"{folder}: {err.strerror}; mount it"
    if room.f_flag & os.ST_RDONLY:
        return f"{folder} is mounted read-only; mount it writable"
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"{folder} is not writable for this user; its mode should be 1777"
    free = room.f_bavail * room.f_frsize
    if room.f_blocks and free < size:
        return f"{folder} has less room than the required {size / 1e6:.0f} MB; remove files or enlarge it"
    return ""


def clean(folder: Path = FOLDER) -> int:
    """Remove the files that no process uses; return their number."""
    removed = 0
    for file in _files(folder):
        with contextlib.suppress(OSError):
            if time.time() - file.stat().st_mtime > YOUNG_SECONDS and not is_locked(file):
                file.unlink(missing_ok=True)
                removed += 1
    return removed


def orphans(folder: Path = FOLDER, proc: Path = Path("/proc")) -> int:
    """Return a lower bound for the number of killed sessions' pools that running processes hold.

    It relies on each process creating at most one pool.
    """
    try:
        text = (proc / "locks").read_text(encoding="utf-8")
    except OSError:
        return 0
    locks = [(_Inode(int(m[2], 16), int(m[3], 16), int(m[4])), int(m[1])) for m in _LOCK.finditer(text)]
    pools = set()
    for file in _files(folder):
        with contextlib.suppress(OSError):
            stat = file.stat()
            if stat.st_size == POOL:
                pools.add(_Inode(os.major(stat.st_dev), os.minor(stat.st_dev), stat.st_ino))
    holders: dict[_Inode, set[int]] = {}
    for inode, pid in locks:
        if inode in pools:
            holders.setdefault(inode, set()).add(pid)
    return _surplus_pools(list(holders.values()))


def _surplus_pools(holders: list[set[int]]) -> int:
    """Return the number of pools in excess of one per process, summed over the groups of processes that share pools.

    Hubs that share no process are separate groups.
    """
    surplus = 0
    while holders:
        count, group = 1, holders.pop()
        while neighbors := [pids for pids in holders if pids & group]:
            holders = [pids for pids in holders if not pids & group]
            count += len(neighbors)
            group = group.union(*neighbors)
        surplus += max(0, count - len(group))
    return surplus


def is_locked(file: Path) -> bool:
    """Return whether a running process holds a lock (flock) on a file; raises `OSError` if that is unknown."""
    import fcntl

    descriptor = os.open(file, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    else:
        return False
    finally:
        os.close(descriptor)


def _files(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if NAME.fullmatch(path.name)]
    except OSError:
        return []
