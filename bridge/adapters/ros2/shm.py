"""Fast DDS's files in shared memory: how much room there is, whose they are, which are left behind.

Fast DDS 2.14 makes ``fastrtps_<hex>`` (a segment) and ``fastrtps_port<n>`` (a port), each with a lock file
``<name>_el`` that every living user holds locked (flock), and a semaphore ``sem.<port>_mutex``.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterable
from pathlib import Path

from bridge.hub.pools import FOLDER, YOUNG_SECONDS, is_locked

LARGEST_SEGMENT = 64 * 1024 * 1024
SMALLEST_SEGMENT = 8 * 1024 * 1024
"""Below it shared memory is not worth having: large messages would go in pieces again."""

_LOCK = re.compile(r"^(fastrtps_(?:[0-9a-f]{16}|port\d+))_el$")


def segment_size(folder: Path = FOLDER) -> int:
    """Bytes for our segment: an eighth of what is free, at most 64 MiB; 0 where that is too little."""
    try:
        stat = os.statvfs(folder)
    except OSError:
        return 0
    size = min(LARGEST_SEGMENT, stat.f_bavail * stat.f_frsize // 8)
    return size if size >= SMALLEST_SEGMENT else 0


def other_users(folder: Path = FOLDER) -> bool:
    """Whether living Fast DDS participants of other users share the folder."""
    mine = os.getuid()
    for lock in _locks(folder):
        with contextlib.suppress(OSError):
            if lock.stat().st_uid != mine and is_locked(lock):
                return True
    return False


def clean(folder: Path = FOLDER) -> int:
    """Remove the segments of dead participants, and only those; how many.

    Ports stay: Fast DDS itself replaces a dead one when its number comes up again, and would meet us at it; but for
    those of our own dead, see `clean_ports`. A segment's name is never used again.
    """
    removed = 0
    for lock in _locks(folder):
        name = lock.name.removesuffix("_el")
        with contextlib.suppress(OSError):
            old = time.time() - lock.stat().st_mtime > YOUNG_SECONDS
            if old and "port" not in name and not is_locked(lock):
                (folder / name).unlink(missing_ok=True)
                lock.unlink(missing_ok=True)
                removed += 1
    return removed


def clean_ports(numbers: Iterable[int], folder: Path = FOLDER) -> None:
    """Remove ports of our own dead participants, which no other one takes up; but for those that are still in use.

    Others have a dead participant's ports open until they learn of its death.
    """
    import fcntl

    for number in numbers:
        port = f"fastrtps_port{number}"
        with contextlib.suppress(OSError):  # there is none, or it is in use
            descriptor = os.open(folder / f"{port}_el", os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                for name in (port, f"sem.{port}_mutex", f"{port}_el"):
                    (folder / name).unlink(missing_ok=True)
            finally:
                os.close(descriptor)


def _locks(folder: Path) -> list[Path]:
    try:
        return [p for p in folder.iterdir() if _LOCK.match(p.name)]
    except OSError:
        return []
