"""A ring of files: the last minutes of a recording, kept on a trigger.

What is kept lies on the disk as a row of short files, of which the oldest is deleted; each begins with what was latched
then. A trigger closes the newest one, and moves all of them into a folder of their own, without copying them.
"""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections import deque
from dataclasses import replace
from pathlib import Path

from bridge.config.sections.record import RingSection
from bridge.record.file import Written
from bridge.record.metadata import write_metadata
from bridge.record.places import KeptFolder

_log = logging.getLogger("midspan.record")

SEGMENTS = 10
"""Files of which the ring is made, about."""


class Ring:
    """Names the files of the ring, forgets the oldest, and keeps them all when asked.

    Args:
        place: the folder in which what is kept lies; the ring itself is a hidden folder there.

    Attributes:
        segment_seconds: for how long one file goes on.
        segment_bytes: and how large it gets.
    """

    def __init__(self, place: KeptFolder, section: RingSection) -> None:
        self._place, self._section = place, section
        self._folder = place.folder / ".ring"
        self._segments: deque[Written] = deque()
        self._ready = False
        self.segment_seconds = max(section.seconds / SEGMENTS, 0.5)
        self.segment_bytes = (section.size << 20) // SEGMENTS

    @property
    def bytes(self) -> int:
        """Of its closed files."""
        return sum(segment.bytes for segment in self._segments)

    def next(self) -> Path:
        """The next file; what a run left that was killed is moved away before, and kept."""
        self._folder.mkdir(parents=True, exist_ok=True)
        if not self._ready:
            left = sorted(self._folder.glob("*.mcap"))
            if left:
                folder = self._place.base()
                folder.mkdir(parents=True)
                for path in left:
                    path.rename(folder / path.name)
                _log.warning("what the ring held as its run was killed is in %s", folder)
            self._ready = True
        return self._folder / f"{time.time_ns()}.mcap"

    def closed(self, written: Written) -> None:
        """Take a file up, and forget those that are too old or too many."""
        self._segments.append(written)
        self.prune()

    def prune(self) -> None:
        """Forget what is older than the ring's time, or more than its size."""
        oldest = time.time_ns() - int(self._section.seconds * 1e9)
        most = (self._section.size << 20) - self.segment_bytes  # the newest file grows beside them
        while self._segments and (self._segments[0].end < oldest or self.bytes > most):
            with contextlib.suppress(OSError):
                self._segments.popleft().path.unlink()

    def discard(self) -> None:
        """Forget everything: nobody asked for it."""
        while self._segments:
            with contextlib.suppress(OSError):
                self._segments.popleft().path.unlink()
        with contextlib.suppress(OSError):
            self._folder.rmdir()

    def keep(self) -> Path | None:
        """Move all files into a new folder with metadata; where it is, None where there is none. Raises `OSError`."""
        self.prune()
        if not self._segments:
            return None
        folder = self._place.base()
        folder.mkdir(parents=True)
        moved: list[Written] = []
        while self._segments:
            segment = self._segments[0]
            path = folder / f"{folder.name}_{len(moved)}.mcap"
            os.rename(segment.path, path)  # noqa: PTH104 - it replaces nothing
            self._segments.popleft()
            moved.append(replace(segment, path=path))
        write_metadata(folder, moved)
        self._place.prune()
        return folder
