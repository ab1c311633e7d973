"""Shared memory of zenoh sessions that died.

zenoh 1.10 keeps a session's shared memory in files ``<number>.zenoh``, which each process that uses one holds locked
(flock). Those that nobody uses any more are removed here, as zenoh does where it uses shared memory itself. But a
session that received from a dead one holds that one's pool for the rest of its life (seen with 1.10, and nothing makes
it let go), so each death of a sender would cost another pool, until there is no room.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from pathlib import Path

from bridge.hub.zenoh_config import POOL

FOLDER = Path("/dev/shm")  # noqa: S108 - where the system keeps POSIX shared memory
YOUNG_SECONDS = 5.0
"""A file so young may be just made, and not yet locked."""

NAME = re.compile(r"\d+\.zenoh")
_LOCK = re.compile(r"FLOCK\s+\S+\s+\S+\s+(\d+) [0-9a-f]+:[0-9a-f]+:(\d+) ")


def clean(folder: Path = FOLDER) -> int:
    """Remove the files of dead sessions that nobody uses, and only those; how many."""
    removed = 0
    for file in _files(folder):
        with contextlib.suppress(OSError):
            if time.time() - file.stat().st_mtime > YOUNG_SECONDS and not is_locked(file):
                file.unlink(missing_ok=True)
                removed += 1
    return removed


def orphans(folder: Path = FOLDER, proc: Path = Path("/proc")) -> int:
    """At least so many pools of dead sessions are held by living processes, of which each has one pool at most."""
    try:
        locks = [(int(m[2]), int(m[1])) for m in _LOCK.finditer((proc / "locks").read_text())]
    except OSError:
        return 0
    pools = set()
    for file in _files(folder):
        with contextlib.suppress(OSError):
            stat = file.stat()
            if stat.st_size == POOL:
                pools.add(stat.st_ino)
    held: dict[int, set[int]] = {}
    for inode, pid in locks:
        if inode in pools:
            held.setdefault(inode, set()).add(pid)
    return _more_pools_than_holders(list(held.values()))


def _more_pools_than_holders(held: list[set[int]]) -> int:
    """Summed over those that share holders: hubs that have nothing to do with each other do not count together."""
    more = 0
    while held:
        together, pids = 1, held.pop()
        while near := [holders for holders in held if holders & pids]:
            held = [holders for holders in held if not holders & pids]
            together += len(near)
            pids = pids.union(*near)
        more += max(0, together - len(pids))
    return more


def is_locked(file: Path) -> bool:
    """Whether a living process holds a lock (flock) on the file; raises `OSError` where that cannot be found out."""
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
