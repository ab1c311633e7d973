"""Files in the folder of POSIX shared memory: whose they are, and which no process uses any more.

Fast DDS 2.14 makes segments ``fastrtps_<16 hex>`` and ports ``fastrtps_port<n>``; whoever uses one holds its lock file
``<name>_el`` locked (flock). zenoh 1.10 makes ``<number>.zenoh`` and holds the file itself locked. Linux tells in
``/proc/locks`` which files are locked, also by other users (seen with both).
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bridge.hub.pools import NAME, is_locked

_SEGMENT = re.compile(r"fastrtps_[0-9a-f]{16}")
_PORT = re.compile(r"fastrtps_port\d+")
_LOCK = re.compile(r"FLOCK .* ([0-9a-f]+):([0-9a-f]+):(\d+) ")
_YOUNG_SECONDS = 10.0
"""A file so young may be just made, and not yet locked."""

_Lock = tuple[int, int, int]
"""Device (major, minor) and inode of a locked file."""


@dataclass(frozen=True, slots=True)
class SharedFile:
    """One file.

    Attributes:
        path: where it is.
        uid: its owner.
        size: its bytes in memory.
        held: whether a living process uses it, None where that cannot be told.
        young: made just now.
    """

    path: Path
    uid: int
    size: int
    held: bool | None
    young: bool

    @property
    def fast_dds(self) -> bool:
        """Whether Fast DDS made it."""
        return not NAME.fullmatch(self.path.name)

    @property
    def port(self) -> bool:
        """Whether it is a port of Fast DDS's; a dead one is taken over when its number comes up again."""
        return _PORT.fullmatch(self.path.name) is not None


def shared_files(folder: Path, proc: Path) -> list[SharedFile]:
    """Segments and ports of Fast DDS and pools of zenoh in a folder.

    Args:
        folder: ``/dev/shm``.
        proc: ``/proc``.
    """
    locks = _locks(proc)
    found: list[SharedFile] = []
    for path in sorted(_entries(folder)):
        with contextlib.suppress(OSError):
            stat = path.stat()
            lock = path if NAME.fullmatch(path.name) else path.with_name(f"{path.name}_el")
            young = time.time() - stat.st_mtime < _YOUNG_SECONDS
            found.append(SharedFile(path, stat.st_uid, stat.st_blocks * 512, _is_held(lock, locks), young))
    return found


def _entries(folder: Path) -> Iterator[Path]:
    with contextlib.suppress(OSError):
        yield from (p for p in folder.iterdir() if any(k.fullmatch(p.name) for k in (_SEGMENT, _PORT, NAME)))


def _locks(proc: Path) -> set[_Lock]:
    try:
        text = (proc / "locks").read_text()
    except OSError:
        return set()
    return {(int(m[1], 16), int(m[2], 16), int(m[3])) for m in _LOCK.finditer(text)}


def _is_held(lock: Path, locks: set[_Lock]) -> bool | None:
    try:
        stat = lock.stat()
    except FileNotFoundError:
        return False
    if (os.major(stat.st_dev), os.minor(stat.st_dev), stat.st_ino) in locks:
        return True
    # in a container the list does not have the locks of other containers: try it
    try:
        return is_locked(lock)
    except OSError:
        return None
