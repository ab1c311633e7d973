"""A single file of a recording."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, cast

from bridge.bags.mcap_writer import ChannelInfo, Compression, McapWriter
from bridge.client.topics import TopicKey
from bridge.hub.graph.tokens import Origin
from bridge.record.arrivals import RecordedMessage, TopicCounts

RESERVE = 2 << 20
"""Free bytes that are reserved on the disk for the file's summary."""

RESUME = 16 << 20
"""Free bytes that are required to continue recording after the disk was full."""

MAX_CHANNELS = 60_000
"""Maximum number of channels of a file, which MCAP numbers with 16 bits."""

ChannelKey = tuple[TopicKey, Origin | None]


class DiskFullError(OSError):
    """The disk is full; the file is complete up to this point."""


def room(folder: Path) -> int | None:
    """Return the number of free bytes on a folder's disk; None if the system does not report it."""
    if not hasattr(os, "statvfs"):
        return None
    status = os.statvfs(folder)
    return status.f_bavail * status.f_frsize if status.f_blocks else None


class _UnbufferedFile:
    """A new file without a buffer: each write is passed to the system at once. Raises `OSError`."""

    def __init__(self, path: Path) -> None:
        self.position = 0
        self._file = path.open("xb", buffering=0)

    def write(self, data: bytes) -> int:
        left = memoryview(data)
        while left:
            written = self._file.write(left)
            self.position += written
            left = left[written:]
        return len(data)

    def tell(self) -> int:
        return self.position

    def flush(self) -> None:
        """Do nothing, because nothing is buffered."""

    def cut(self, position: int) -> None:
        self._file.truncate(position)
        self.position = position

    def close(self) -> None:
        self._file.close()


@dataclass(frozen=True)
class WrittenFile:
    """The contents of a closed file; times are in nanoseconds since 1970.

    Attributes:
        begin, end: the span of the messages' times, which includes the time when the file was opened.
        closed: when the file was closed (monotonic seconds).
        topics: each channel with its number of messages.
        whole: whether the file has a summary; a file without one is read sequentially, or repaired.
    """

    path: Path
    bytes: int
    messages: int
    begin: int
    end: int
    closed: float = field(default_factory=time.monotonic, compare=False)
    topics: tuple[tuple[ChannelInfo, int], ...] = field(default=())
    whole: bool = True


class RecordFile:
    """A file that is being written. It must not exist beforehand; the constructor and all methods may raise `OSError`.

    Attributes:
        path: the file.
        opened: when it was opened (monotonic seconds).
        safe: number of written bytes that can be read even if nothing follows.
        messages: number of messages in these bytes.
    """

    def __init__(self, path: Path, compression: Compression, about: dict[str, str]) -> None:
        self.path, self.opened = path, time.monotonic()
        self.begin = self.end = time.time_ns()
        self._out = _UnbufferedFile(path)
        self._channels: dict[ChannelKey, tuple[int, ChannelInfo]] = {}
        self._counts: dict[int, int] = {}
        self._fresh: dict[int, int] = {}
        self._pending: dict[int, TopicCounts] = {}
        self.safe = self.messages = 0
        try:
            self._writer = McapWriter(cast(BinaryIO, self._out), compression)
            self._writer.metadata("midspan", about)
        except BaseException as err:
            self._out.close()
            path.unlink(missing_ok=True)
            if isinstance(err, OSError):
                err.filename = str(path)  # a failed write does not name its file
            raise
        self.safe = self._out.position

    @property
    def bytes(self) -> int:
        """The size of the file, including bytes that are not compressed yet."""
        return self._out.position + self._writer.pending

    @property
    def full(self) -> bool:
        """Whether the file has the maximum number of channels."""
        return len(self._channels) >= MAX_CHANNELS

    @property
    def pending(self) -> bool:
        """Whether the open chunk has messages."""
        return bool(self._pending)

    def has(self, key: ChannelKey) -> bool:
        """Whether the file has a channel."""
        return key in self._channels

    def channel(self, key: ChannelKey, info: ChannelInfo) -> None:
        """Add a channel."""
        self._channels[key] = self._writer.channel(info), info

    def write(self, arrival: RecordedMessage, log_time: int, *, again: bool = False) -> None:
        """Add a message to its existing channel; ``again``: it counts already, because an earlier file has it.

        Raises `DiskFullError` if the disk is full. Then the message is not in the file, and the file can be closed.
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
            self._on_written()

    def flush(self) -> None:
        """Write the open chunk; raises `DiskFullError` or another `OSError`."""
        if self._writer.pending:
            self._check_room(0)
            self._writer.flush()
        self._on_written()

    def _check_room(self, more: int) -> None:
        free = room(self.path.parent)
        if free is not None and free < self._writer.pending + more + RESERVE:
            raise DiskFullError(28, f"only {free >> 20} MB are free", str(self.path.parent))

    def _on_written(self) -> None:
        self.safe, self.messages = self._out.position, self._writer.messages
        for counts in self._pending.values():
            counts.count_written()
        self._pending.clear()
        for number, fresh in self._fresh.items():
            self._counts[number] = self._counts.get(number, 0) + fresh
        self._fresh.clear()

    def close(self, ending: dict[str, str] | None = None) -> WrittenFile:
        """Write the summary, and metadata ``midspan.end`` if given; after an `OSError`, `abandon` the file."""
        if ending:
            self._writer.metadata("midspan.end", ending)
        self._writer.finish()
        self._on_written()
        self._out.close()
        return self._written(whole=True)

    def abandon(self) -> WrittenFile:
        """Truncate a file to its last complete chunk, because it can no longer be written, and close it.

        The messages of the open chunk are lost.
        """
        for counts in self._pending.values():
            counts.count_dropped("disk")
        self._pending.clear()
        try:
            self._out.cut(self.safe)
        finally:
            self._out.close()
        return self._written(whole=False)

    def _written(self, *, whole: bool) -> WrittenFile:
        topics = tuple((info, self._counts.get(number, 0)) for number, info in self._channels.values())
        return WrittenFile(
            self.path, self._out.position, self.messages, self.begin, self.end, topics=topics, whole=whole
        )


def total(counts: Iterable[TopicCounts]) -> tuple[int, int, dict[str, int]]:
    """Return the total messages, bytes, and drops by reason of several topics."""
    messages = size = 0
    dropped: dict[str, int] = {}
    for topic in counts:
        messages, size = messages + topic.messages, size + topic.bytes
        for reason, count in tuple(topic.dropped.items()):
            dropped[reason] = dropped.get(reason, 0) + count
    return messages, size, dropped
