"""Where a recording is written: one file, several files, or a rosbag2 folder; and the limits of stored recordings."""

from __future__ import annotations

import contextlib
import logging
import shutil
import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Protocol

from bridge.record.file import WrittenFile
from bridge.record.metadata import write_metadata
from bridge.record.section import KeepSection

_log = logging.getLogger("midspan.record")

PREFIX = "midspan_"
"""The prefix of recordings that Midspan names; only these are ever deleted."""


class RecordPlace(Protocol):
    """Names the files of a recording."""

    def next(self) -> Path:
        """Return the path of the next file and create its folder; raises `OSError`."""
        ...

    def on_closed(self, written: WrittenFile, /) -> None:
        """Handle a closed file."""
        ...


def stamp(seconds: float | None = None) -> str:
    """Return the local time in the format of file names."""
    return time.strftime("%Y_%m_%d-%H_%M_%S", time.localtime(seconds))


class Files:
    """Names the files ``base.mcap``, or for split recordings ``base_0.mcap``, ``base_1.mcap`` ..."""

    def __init__(self, base: Path, *, split: bool) -> None:
        self._base, self._split = base, split
        self._number = 0

    def next(self) -> Path:
        """Return the path of the next file."""
        self._base.parent.mkdir(parents=True, exist_ok=True)
        number = self._number
        # an unsplit recording gets a second file after the disk was full, or on request
        name = f"{self._base.name}_{number}" if self._split or number else self._base.name
        return self._base.with_name(f"{name}.mcap")

    def on_closed(self, _written: WrittenFile) -> None:
        """Increment the file number, only now so that a file that could not be created leaves no gap."""
        self._number += 1


class BagFolder:
    """Writes ``folder/folder_0.mcap`` ... and ``metadata.yaml``, like rosbag2; the folder must not exist."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files = Files(folder / folder.name, split=True)
        self._made = False
        self._written: list[WrittenFile] = []

    def next(self) -> Path:
        """Return the path of the next file; raises `FileExistsError` if the folder already existed."""
        if not self._made:
            self._folder.mkdir(parents=True)
            self._made = True
        return self._files.next()

    def on_closed(self, written: WrittenFile) -> None:
        """Add the file to the metadata; raises `OSError`."""
        self._written.append(written)
        self._files.on_closed(written)
        write_metadata(self._folder, self._written)


class KeptFolder:
    """A folder of recordings that Midspan names, in which only the newest are kept."""

    def __init__(self, folder: Path, keep: KeepSection) -> None:
        self.folder, self._keep = folder, keep
        self._now: Path | None = None
        self._numbers = count()
        self._created: dict[str, int] = {}  # order of creation, because the clock of the names may be set

    def base(self) -> Path:
        """Return an unused path for a recording, without an extension."""
        first = self.folder / f"{PREFIX}{stamp()}"
        used = {entry.name.removesuffix(".mcap") for entry in self._entries()}
        number, path = 1, first
        while path.name in used:
            path, number = first.with_name(f"{first.name}-{number}"), number + 1
        self._created[path.name] = next(self._numbers)
        return path

    def next(self) -> Path:
        """Return the path of the next file, which has a new name."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self._now = self.base().with_suffix(".mcap")
        self.prune()
        return self._now

    def on_closed(self, _written: WrittenFile) -> None:
        """Delete old recordings."""
        self.prune()

    def prune(self) -> None:
        """Delete the oldest recordings until the rest is within the limits; the newest is never deleted."""
        entries = sorted(self._entries(), key=self._order)
        sizes = {entry: _size(entry) for entry in entries}
        while len(entries) > 1 and self._too_much(len(entries), sum(sizes[entry] for entry in entries)):
            oldest = entries.pop(0)
            if oldest == self._now:
                continue
            _log.info("deleting %s, which exceeds record.keep", oldest)
            with contextlib.suppress(OSError):
                shutil.rmtree(oldest) if oldest.is_dir() else oldest.unlink()

    def _order(self, entry: Path) -> tuple[int, str]:
        name = entry.name.removesuffix(".mcap")
        return self._created.get(name, -1), name

    def _too_much(self, files: int, size: int) -> bool:
        keep = self._keep
        return bool((keep.files and files > keep.files) or (keep.size and size > keep.size << 20))

    def _entries(self) -> Iterator[Path]:
        with contextlib.suppress(OSError):
            for entry in self.folder.iterdir():
                if entry.name.startswith(PREFIX) and (entry.suffix == ".mcap" or entry.is_dir()):
                    yield entry


def _size(entry: Path) -> int:
    size = 0
    with contextlib.suppress(OSError):
        size = sum(file.stat().st_size for file in entry.iterdir()) if entry.is_dir() else entry.stat().st_size
    return size
