"""A ring of files with the last minutes of a recording, which are saved on a trigger.

The ring is a series of short files on the disk, the oldest of which are deleted. Each starts with the latched messages
at that time. A trigger closes the newest file, and moves all files into a new folder without copying them.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.record.file import WrittenFile
from bridge.record.metadata import write_metadata
from bridge.record.places import KeptFolder
from bridge.record.section import RingSection

if TYPE_CHECKING:
    from bridge.daemon.lock import Lock

_log = logging.getLogger("midspan.record")

SEGMENTS = 10
"""Approximate number of files in the ring."""


class Ring:
    """Names the files of the ring, deletes the oldest, and saves all of them on a trigger.

    Args:
        place: the folder of stored recordings, in which the ring is a hidden folder.

    Attributes:
        segment_seconds: duration of one file, in seconds.
        segment_bytes: maximum size of one file, in bytes.
    """

    def __init__(self, place: KeptFolder, section: RingSection) -> None:
        self._place, self._section = place, section
        self._folder = place.folder / ".ring"
        self._segments: deque[WrittenFile] = deque()
        self._ready = False
        self._lock: Lock | None = None
        self.segment_seconds = max(section.seconds / SEGMENTS, 0.5)
        self.segment_bytes = (section.size << 20) // SEGMENTS

    @property
    def bytes(self) -> int:
        """The total size of the closed files."""
        return sum(segment.bytes for segment in self._segments)

    def next(self) -> Path:
        """Return the path of the next file; the files of a run that was killed are first moved away and saved.

        Raises `OSError`, for example if another recorder has its ring in this folder.
        """
        self._place.folder.mkdir(parents=True, exist_ok=True)
        self._acquire()
        self._folder.mkdir(exist_ok=True)
        if not self._ready:
            left = sorted(self._folder.glob("*.mcap"))
            if left:
                folder = self._place.base()
                folder.mkdir(parents=True)
                for path in left:
                    path.rename(folder / path.name)
                _log.warning("moved the ring of a run that was killed to %s", folder)
            self._ready = True
        return self._folder / f"{time.time_ns()}.mcap"

    def _acquire(self) -> None:
        """Lock the folder; raises `OSError` if another recorder has locked it, which would lose its files."""
        if self._lock is not None:
            return
        from bridge.daemon.lock import Lock  # only for a ring; it needs fcntl, except on Windows

        lock = Lock(self._folder.with_name(f"{self._folder.name}.lock"))
        if not lock.try_lock():
            lock.close()
            problem = "another recorder has its ring in this folder; choose another folder"
            raise OSError(errno.EBUSY, problem, str(self._place.folder))
        self._lock = lock

    def on_closed(self, written: WrittenFile) -> None:
        """Add a file, and delete the oldest files if the ring is too long or too large."""
        self._segments.append(written)
        self.prune()

    def prune(self) -> None:
        """Delete the files that exceed the ring's duration or size."""
        oldest = time.monotonic() - self._section.seconds  # the system clock may be set meanwhile
        most = (self._section.size << 20) - self.segment_bytes  # the newest file is still growing
        while self._segments and (self._segments[0].closed < oldest or self.bytes > most):
            with contextlib.suppress(OSError):
                self._segments.popleft().path.unlink()

    def discard(self) -> None:
        """Delete the remaining files, which no trigger has saved."""
        while self._segments:
            with contextlib.suppress(OSError):
                self._segments.popleft().path.unlink()
        lock, self._lock = self._lock, None
        if lock is None:
            return
        with contextlib.suppress(OSError):
            self._folder.rmdir()
        with contextlib.suppress(OSError):  # Windows refuses to delete an open file
            lock.path.unlink()
        lock.close()

    def keep(self) -> Path | None:
        """Move all files to a new folder, with metadata, and return it; None for an empty ring. Raises `OSError`."""
        self.prune()
        if not self._segments:
            return None
        folder = self._place.base()
        folder.mkdir(parents=True)
        moved: list[WrittenFile] = []
        while self._segments:
            segment = self._segments[0]
            path = folder / f"{folder.name}_{len(moved)}.mcap"
            os.rename(segment.path, path)  # noqa: PTH104 - nothing is replaced
            self._segments.popleft()
            moved.append(replace(segment, path=path))
        write_metadata(folder, moved)
        self._place.prune()
        return folder
