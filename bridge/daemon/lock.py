"""Locks in the state folder: one daemon for each name, one process for each of its workers.

An flock(2) lasts as long as any process has its file open: it ends even with a killed process, and a child inherits it.
"""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import os
import socket
from dataclasses import dataclass
from pathlib import Path

from bridge.daemon.protocol import Owner
from bridge.routing.processes import process_space

logger = logging.getLogger("midspan.daemon")


@dataclass(frozen=True, slots=True)
class Holder:
    """The process that holds a lock, read from the lock's file; ``space`` is its process id namespace."""

    pid: int
    machine: str
    owner: Owner
    space: str = ""

    @property
    def is_here(self) -> bool:
        """Whether the holder is a process of this machine (a state folder may be shared over the network).

        The machine may have been renamed since, or restarted.
        """
        return self.machine == socket.gethostname() or self.space == process_space() != ""


class Lock:
    """An exclusive lock on a file; acquire it with `try_lock`, release it with `close` (or by exiting)."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as err:
            if err.errno not in {errno.EROFS, errno.ENOSPC, errno.EACCES, errno.EDQUOT}:
                raise
            # an existing file is enough, as a lock needs no write access
            self._file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)

    def try_lock(self) -> bool:
        """Try to lock, for this process or the one that it starts; return False if another one holds the lock."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def write(self, pid: int, owner: Owner) -> None:
        """Write the holder into the file: this process, or the child with its descriptor. The lock works without it."""
        holder = {"pid": pid, "machine": socket.gethostname(), "owner": owner, "space": process_space()}
        text = json.dumps(holder)
        try:
            os.ftruncate(self._file, 0)
            os.pwrite(self._file, text.encode(), 0)
        except OSError as err:
            logger.warning("cannot write the holder into %s: %s", self.path, err.strerror)

    def holder(self) -> Holder | None:
        """Return the holder; None if the file does not name one."""
        try:
            data = json.loads(os.pread(self._file, 4096, 0))
            owner: Owner = "service" if data["owner"] == "service" else "daemon"
            return Holder(int(data["pid"]), str(data["machine"]), owner, str(data.get("space", "")))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            return None

    def fileno(self) -> int:
        """Return the descriptor, which a child may inherit."""
        return self._file

    def close(self) -> None:
        """Close this process's descriptor; the lock lasts while a child has one."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
