"""Locks in the state folder: one daemon for each name, one process for each of its workers.

An flock(2) lasts as long as any process has its file open, so it also ends if the process is killed, and a child
inherits it. Windows' locks end with their process too, but no child inherits them: there a worker locks its file
itself.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import socket
import sys
from dataclasses import dataclass
from pathlib import Path

from bridge.daemon.protocol import Owner
from bridge.routing.processes import process_space

if sys.platform == "win32":
    import msvcrt

    _FAR = 1 << 30
    """Offset of the locked byte. Windows lets no other process read it, so it is after the holder's text."""

    def _lock(file: int) -> None:
        os.lseek(file, _FAR, os.SEEK_SET)
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(file: int) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


logger = logging.getLogger("midspan.daemon")

INHERITED = sys.platform != "win32"
"""Whether a process that the daemon starts inherits its lock."""


@dataclass(frozen=True, slots=True)
class Holder:
    """The process that holds a lock, read from the lock's file; ``space`` is where its process id is unique."""

    pid: int
    machine: str
    owner: Owner
    space: str = ""

    @property
    def is_here(self) -> bool:
        """Whether the holder is a process of this machine (a state folder may be shared over the network).

        The host name matches even after a restart of the machine, and ``space`` even after a change of the host name.
        """
        return self.machine == socket.gethostname() or self.space == process_space() != ""


class Lock:
    """An exclusive lock on a file; acquire it with `try_lock`, release it with `close` (or by exiting)."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as err:
            if err.errno not in {errno.EROFS, errno.ENOSPC, errno.EACCES, errno.EDQUOT}:
                raise
            # an existing file is enough, because a lock needs no write access
            self._file = os.open(path, os.O_RDONLY)

    def try_lock(self) -> bool:
        """Try to lock, for this process or a process that it starts; return False if another process holds the lock."""
        try:
            _lock(self._file)
        except (BlockingIOError, PermissionError):
            return False
        return True

    def write(self, pid: int, owner: Owner) -> None:
        """Write the holder into the file: this process, or the child that inherits the lock. Errors are only logged."""
        holder = {"pid": pid, "machine": socket.gethostname(), "owner": owner, "space": process_space()}
        text = json.dumps(holder)
        try:
            os.ftruncate(self._file, 0)
            os.lseek(self._file, 0, os.SEEK_SET)
            os.write(self._file, text.encode())
        except OSError as err:
            logger.warning("cannot write the holder into %s: %s", self.path, err.strerror)

    def holder(self) -> Holder | None:
        """Return the holder; None if the file does not name one."""
        try:
            os.lseek(self._file, 0, os.SEEK_SET)
            data = json.loads(os.read(self._file, 4096))
            owner: Owner = "service" if data["owner"] == "service" else "daemon"
            return Holder(int(data["pid"]), str(data["machine"]), owner, str(data.get("space", "")))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            return None

    @property
    def passed_on(self) -> tuple[int, ...]:
        """The descriptors for a child that is to hold the lock; empty if children do not inherit locks."""
        return (self._file,) if INHERITED else ()

    def close(self) -> None:
        """Close this process's descriptor; the lock lasts while a child has one."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
