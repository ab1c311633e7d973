"""Where the files of a recording lie: one, several, or a folder as rosbag2 writes it; and how much of them is kept."""

from __future__ import annotations

import contextlib
import logging
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from bridge.config.sections.record import KeepSection
from bridge.record.file import Written
from bridge.record.metadata import write_metadata

_log = logging.getLogger("midspan.record")

PREFIX = "midspan_"
"""What the names of recordings begin with that nobody else named; only such are ever deleted."""


class RecordPlace(Protocol):
    """Where files go."""

    def next(self) -> Path:
        """The next file, its folder made; raises `OSError`."""
        ...

    def closed(self, written: Written, /) -> None:
        """A file is closed."""
        ...


def stamp(seconds: float | None = None) -> str:
    """The local time as it stands in names."""
    return time.strftime("%Y_%m_%d-%H_%M_%S", time.localtime(seconds))


class Files:
    """``base.mcap``, or ``base_0.mcap``, ``base_1.mcap`` ... where they are split."""

    def __init__(self, base: Path, *, split: bool) -> None:
        self._base, self._split = base, split
        self._number = 0

    def next(self) -> Path:
        """The next file."""
        self._base.parent.mkdir(parents=True, exist_ok=True)
        number = self._number
        # the second file of one that is not split: the disk was full in between, or a person asked for it
        name = f"{self._base.name}_{number}" if self._split or number else self._base.name
        return self._base.with_name(f"{name}.mcap")

    def closed(self, _written: Written) -> None:
        """The next one has another number; one that could not be made leaves no gap."""
        self._number += 1


class BagFolder:
    """``folder/folder_0.mcap`` ... and ``metadata.yaml``, as rosbag2 writes them; the folder must not exist."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files = Files(folder / folder.name, split=True)
        self._made = False
        self._written: list[Written] = []

    def next(self) -> Path:
        """The next file; raises `FileExistsError` where somebody has the folder."""
        if not self._made:
            self._folder.mkdir(parents=True)
            self._made = True
        return self._files.next()

    def closed(self, written: Written) -> None:
        """Tell of it in the metadata; raises `OSError`."""
        self._written.append(written)
        self._files.closed(written)
        write_metadata(self._folder, self._written)


class KeptFolder:
    """A folder of recordings that Midspan names, and of which it keeps the newest."""

    def __init__(self, folder: Path, keep: KeepSection) -> None:
        self.folder, self._keep = folder, keep
        self._now: Path | None = None

    def base(self) -> Path:
        """A name that is not taken yet."""
        first = self.folder / f"{PREFIX}{stamp()}"
        taken = {entry.name.removesuffix(".mcap") for entry in self._entries()}
        number, found = 1, first
        while found.name in taken:
            found, number = first.with_name(f"{first.name}-{number}"), number + 1
        return found

    def next(self) -> Path:
        """The next file, each with a name of its own."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self._now = self.base().with_suffix(".mcap")
        self.prune()
        return self._now

    def closed(self, _written: Written) -> None:
        """Make room."""
        self.prune()

    def prune(self) -> None:
        """Delete the oldest recordings until the rest fits; the newest one stays."""
        found = sorted(self._entries(), key=lambda entry: entry.name)
        sizes = {entry: _size(entry) for entry in found}
        while len(found) > 1 and self._too_much(len(found), sum(sizes[entry] for entry in found)):
            oldest = found.pop(0)
            if oldest == self._now:
                continue
            _log.info("%s is deleted to make room (record.keep)", oldest)
            with contextlib.suppress(OSError):
                shutil.rmtree(oldest) if oldest.is_dir() else oldest.unlink()

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
