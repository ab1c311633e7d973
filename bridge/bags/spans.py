"""Bags whose files consist of pieces, each with the messages of a span of time; pieces are read in order of time."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from typing_extensions import override

from bridge.bags.bag import MAX_CHUNK, Bag, BagError, BagMessage, BagTopic, Columns, reading
from bridge.bags.packed import ZSTD, unpacked_message
from bridge.bags.rows import Lists, Rows
from bridge.bags.split import new_table
from bridge.messages.definitions.schema import World

_MORE = 4 << 20
"""Bytes by which a stored chunk may exceed its data: for its header, and for random data that compression lengthens."""

_PIECE = 1 << 12
"""Compressed bytes of a damaged chunk that are unpacked at a time."""

HELD = 128 << 20
"""Maximum bytes of messages and rows that are held back because later pieces may have earlier messages.

Beyond that, the earliest messages are yielded, although they may be out of order."""


class FileSpan(NamedTuple):
    """A piece of the file: its position, the times of its messages, and whether it is a chunk."""

    offset: int
    length: int
    start: int
    end: int
    chunk: bool


class SpanBag(Bag):
    """A bag of spans; subclasses find the spans and read their messages."""

    _on_damage: Callable[[BagError], None] | None = None

    def __init__(self, path: Path, file: BinaryIO) -> None:
        super().__init__(path)
        self._file = file
        self.size = file.seek(0, 2)
        self._spans: list[FileSpan] = []
        self.topic_of: dict[int, BagTopic] = {}

    def _end(self, offset: int, what: str = "the file ends within a record, or a length is wrong") -> None:
        self.unfinished = True
        cure = "the records before it can be read; 'midspan bag mend' writes them into a whole file"
        self.trouble = BagError(self.path, what, offset, cure)

    @abstractmethod
    def _load(self, span: FileSpan) -> Rows:
        """Return the messages of a span as stored; may raise any exception for bad bytes."""

    @override
    def columns(
        self, topics: Collection[BagTopic] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Columns]:
        """Yield the messages in blocks; messages of overlapping pieces are sorted as far as `HELD` allows."""
        wanted = None if topics is None else set(topics)
        numbers = {number for number, topic in self.topic_of.items() if wanted is None or topic in wanted}
        yield from map(self._columns, self.blocks(numbers, start_ns, end_ns))

    def blocks(self, numbers: Collection[int], start_ns: int | None, end_ns: int | None) -> Iterator[Rows]:
        """Yield the messages of some channels in blocks, sorted as in `columns`."""
        spans = [
            span
            for span in sorted(self._spans, key=lambda span: span.start)
            if (start_ns is None or span.end >= start_ns) and (end_ns is None or span.start < end_ns)
        ]
        waiting: Rows | None = None
        for index, span in enumerate(spans):
            rows = self._read_span(span).of_channels(numbers).within(start_ns, end_ns)
            if waiting is not None:
                rows = rows.behind(waiting)
            rows = rows.ordered()
            due = len(rows.table)
            if index + 1 < len(spans):
                due = _due(rows, spans[index + 1].start)
            yield from rows.select(slice(due)).blocks()
            waiting = rows.select(slice(due, None)).compact() if due < len(rows.table) else None

    @override
    def messages(
        self, topics: Collection[BagTopic] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        for columns in self.columns(topics, start_ns, end_ns):
            yield from map(BagMessage, *columns)

    def _columns(self, block: Rows) -> Columns:
        numbers, times, publish_times, data = self.lists(block)
        return Columns(list(map(self.topic_of.__getitem__, numbers)), times, publish_times, data)

    def lists(self, block: Rows) -> Lists:
        """Return channels, times, publish times and data; ROS 2 messages that rosbag2 compressed are unpacked."""
        numbers, times, publish_times, data = block.lists()
        with reading(self.path):
            for index in block.that_start_with(ZSTD):
                topic = self.topic_of.get(numbers[index])
                if topic is not None and topic.world is World.ROS2:
                    data[index] = unpacked_message(data[index])
        return numbers, times, publish_times, data

    def _read_span(self, span: FileSpan) -> Rows:
        try:
            with reading(self.path, span.offset):
                return self._load(span)
        except BagError as err:
            if self._on_damage is None:
                raise
            self._on_damage(err)
            return Rows(b"", new_table(0)[:0])

    @override
    def skip_damage(self, on_damage: Callable[[BagError], None]) -> None:
        """Leave out damaged pieces from now on, and report them."""
        self._on_damage = on_damage

    @override
    def close(self) -> None:
        self._file.close()

    def _read(self, offset: int, length: int) -> bytes:
        if length > MAX_CHUNK + _MORE:
            problem = f"a record has {length} bytes; the limit for chunks and messages is {MAX_CHUNK}"
            raise BagError(self.path, problem, offset)
        self._file.seek(offset)
        data = self._file.read(length)
        if len(data) != length:
            raise BagError(self.path, "the file ends here", offset + len(data))
        return data

    def _set_times(self) -> None:
        timed = [span for span in self._spans if span.end]  # others have no readable message
        if timed:
            self.start_ns = min(span.start for span in timed)
            self.end_ns = max(span.end for span in timed)


def _due(rows: Rows, next_start: int) -> int:
    """Return how many messages can be yielded: those before all later pieces, and more if too much is held back."""
    due = int(np.searchsorted(rows.times, np.uint64(next_start), "right"))
    weights = rows.weights()
    excess = int(weights[-1]) - HELD if due < len(weights) else 0
    return max(due, int(np.searchsorted(weights, np.uint64(excess))) + 1) if excess > 0 else due


def count_rows(rows: Rows, counts: Counter[int], span: FileSpan) -> FileSpan:
    """Add the number of messages of each channel, and return the piece with the times of its messages."""
    numbers, counts_ = np.unique(rows.numbers, return_counts=True)
    counts.update(dict(zip(numbers.tolist(), counts_.tolist(), strict=True)))
    times = rows.times
    return span._replace(start=int(times.min()), end=int(times.max())) if len(times) else span


def unpack(compression: str, data: bytes | memoryview, size: int) -> bytes:
    """Unpack a chunk to exactly ``size`` bytes, and never more; raises `ValueError` or the library's own error."""
    if size > MAX_CHUNK:
        msg = f"a chunk declares {size} bytes; the limit is {MAX_CHUNK}"
        raise ValueError(msg)
    match compression:
        case "" | "none":
            plain = bytes(data)
        case "zstd":
            plain = _unpack_zstd(data, size)
        case "lz4" | "bz2":
            plain = _unpacker(compression).decompress(data, max_length=size + 1)
        case _:
            msg = f"compression {compression[:20]!r} is unknown; zstd, lz4, bz2 and none are supported"
            raise ValueError(msg)
    if len(plain) != size:
        msg = f"a chunk of {size} bytes unpacks to {'more' if len(plain) > size else len(plain)}"
        raise ValueError(msg)
    return plain


def unpack_part(compression: str, data: bytes, size: int) -> bytes:
    """Unpack a damaged chunk of ROS 1 up to the damage.

    Returns nothing if the data unpack without an error but to another size, because then the position of the damage is
    unknown. If only a checksum is wrong, the result ends before the piece (`_PIECE`) in which the library finds that.
    """
    if size > MAX_CHUNK:
        return b""
    if compression == "none":
        return data[:size]
    if compression not in ("lz4", "bz2"):
        return b""
    unpacker, plain = _unpacker(compression), bytearray()
    with suppress(Exception):  # each library raises its own errors
        for at in range(0, len(data), _PIECE):
            plain += unpacker.decompress(data[at : at + _PIECE], max_length=size + 1 - len(plain))
            if unpacker.eof or len(plain) > size:
                return b""
    return bytes(plain)


def _unpacker(compression: str) -> Any:
    """Return a decompressor that works piece by piece."""
    if compression == "bz2":
        import bz2

        return bz2.BZ2Decompressor()
    import lz4.frame  # type: ignore[import-untyped]

    return lz4.frame.LZ4FrameDecompressor()


def _unpack_zstd(data: bytes | memoryview, size: int) -> bytes:
    import zstandard

    if not size:
        return b""
    declared = zstandard.frame_content_size(data)
    if declared not in (-1, size):
        msg = f"a chunk declares {size} bytes, but its zstd frame {declared}"
        raise ValueError(msg)
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
