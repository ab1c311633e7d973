"""One file of a recording."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, cast

from bridge.bags.mcap_writer import ChannelInfo, Compression, McapWriter
from bridge.hub.graph.tokens import Origin
from bridge.modules.hub_topics import TopicKey
from bridge.record.arrivals import RecordedMessage, TopicCounts

RESERVE = 2 << 20
"""Bytes of room on the disk that are left, for the file's summary."""

RESUME = 16 << 20
"""Bytes of room from which recording goes on, once the disk was full."""

MAX_CHANNELS = 60_000
"""A file of MCAP numbers its channels by 16 bits."""

ChannelKey = tuple[TopicKey, Origin | None]


class DiskFullError(OSError):
    """There is no room for more; the file is whole."""


def room(folder: Path) -> int | None:
    """Bytes of room on a folder's disk; None where the system does not tell."""
    if not hasattr(os, "statvfs"):
        return None
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize if found.f_blocks else None


class _Out:
    """A new file to which bytes are appended at once, with no buffer of its own. Raises `OSError`."""

    def __init__(self, path: Path) -> None:
        self.position = 0
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)

    def write(self, data: bytes) -> int:
        left = memoryview(data)
        while left:
            written = os.write(self._descriptor, left)
            self.position += written
            left = left[written:]
        return len(data)

    def tell(self) -> int:
        return self.position

    def flush(self) -> None:
        """Nothing waits here."""

    def cut(self, position: int) -> None:
        os.ftruncate(self._descriptor, position)
        self.position = position

    def close(self) -> None:
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)


@dataclass(frozen=True)
class Written:
    """What a file that is closed holds; times in nanoseconds since 1970.

    Attributes:
        topics: each channel with its messages.
        whole: whether it has a summary; one without is read in order, or mended.
    """

    path: Path
    bytes: int
    messages: int
    begin: int
    end: int
    topics: tuple[tuple[ChannelInfo, int], ...] = field(default=())
    whole: bool = True


class RecordFile:
    """A file that is being written; it must not exist. Raises `OSError` from its making on.

    Attributes:
        path: where it is.
        opened: monotonic seconds.
        safe: bytes that are written and can be read even if nothing follows.
        messages: in these.
    """

    def __init__(self, path: Path, compression: Compression, about: dict[str, str]) -> None:
        self.path, self.opened = path, time.monotonic()
        self.begin = self.end = time.time_ns()
        self._out = _Out(path)
        self._channels: dict[ChannelKey, tuple[int, ChannelInfo]] = {}
        self._counts: dict[int, int] = {}
        self._fresh: dict[int, int] = {}
        self._pending: dict[int, TopicCounts] = {}
        self.safe = self.messages = 0
        try:
            self._writer = McapWriter(cast(BinaryIO, self._out), compression)
            self._writer.metadata("midspan", about)
        except BaseException:
            self._out.close()
            path.unlink(missing_ok=True)
            raise
        self.safe = self._out.position

    @property
    def bytes(self) -> int:
        """How large it is, with what waits to be compressed."""
        return self._out.position + self._writer.pending

    @property
    def full(self) -> bool:
        """Whether it can have no more channels."""
        return len(self._channels) >= MAX_CHANNELS

    @property
    def pending(self) -> bool:
        """Whether messages wait for the chunk's end."""
        return bool(self._pending)

    def has(self, key: ChannelKey) -> bool:
        """Whether there is a channel."""
        return key in self._channels

    def channel(self, key: ChannelKey, info: ChannelInfo) -> None:
        """Add a channel."""
        self._channels[key] = self._writer.channel(info), info

    def write(self, arrival: RecordedMessage, log_time: int, *, again: bool = False) -> None:
        """Add a message to its channel, which must be there; ``again``: it was counted before.

        Raises `DiskFullError` where there is no room for it: then it is not in the file, which can be closed.
        """
        data, counts = arrival.data, arrival.counts
        if self._writer.closes(len(data)):
            self._check_room(len(data))
        number, _ = self._channels[counts.key, arrival.origin]
        if not again:
            messages, size = counts.pending
            counts.pending = messages + 1, size + len(data)
            self._pending[id(counts)] = counts
        self._fresh[number] = self._fresh.get(number, 0) + 1
        self.begin, self.end = min(self.begin, log_time), max(self.end, log_time)
        if self._writer.write(number, log_time, arrival.publish_time, data, arrival.sequence):
            self._wrote()

    def flush(self) -> None:
        """Write what is pending; raises `DiskFullError` or another `OSError`."""
        if self._writer.pending:
            self._check_room(0)
            self._writer.flush()
        self._wrote()

    def _check_room(self, more: int) -> None:
        free = room(self.path.parent)
        if free is not None and free < self._writer.pending + more + RESERVE:
            raise DiskFullError(28, f"{free >> 20} MB of room are left", str(self.path.parent))

    def _wrote(self) -> None:
        self.safe, self.messages = self._out.position, self._writer.messages
        for counts in self._pending.values():
            counts.wrote()
        self._pending.clear()
        for number, fresh in self._fresh.items():
            self._counts[number] = self._counts.get(number, 0) + fresh
        self._fresh.clear()

    def close(self, ending: dict[str, str] | None = None) -> Written:
        """Write the summary, and metadata ``midspan.end`` where some are given; raises `OSError`: then `abandon` it."""
        if ending:
            self._writer.metadata("midspan.end", ending)
        self._writer.finish()
        self._wrote()
        self._out.close()
        return self._written(whole=True)

    def abandon(self) -> Written:
        """Close it where it cannot be written any more, up to the last whole chunk; what is pending is lost."""
        for counts in self._pending.values():
            counts.failed("disk")
        self._pending.clear()
        try:
            self._out.cut(self.safe)
        finally:
            self._out.close()
        return self._written(whole=False)

    def _written(self, *, whole: bool) -> Written:
        topics = tuple((info, self._counts.get(number, 0)) for number, info in self._channels.values())
        return Written(self.path, self._out.position, self.messages, self.begin, self.end, topics, whole)


def total(counts: Iterable[TopicCounts]) -> tuple[int, int, dict[str, int]]:
    """Messages, bytes, and drops by reason of several topics."""
    messages = size = 0
    dropped: dict[str, int] = {}
    for each in counts:
        messages, size = messages + each.messages, size + each.bytes
        for reason, count in tuple(each.dropped.items()):
            dropped[reason] = dropped.get(reason, 0) + count
    return messages, size, dropped
