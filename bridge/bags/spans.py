"""Bags that are files of pieces, each with messages of some time: they are read piece by piece, in order of time."""

from __future__ import annotations

import heapq
from abc import abstractmethod
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Iterator
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO, NamedTuple

from bridge.bags.bag import MAX_CHUNK, Bag, BagError, BagMessage, BagTopic, reading

_MORE = 4 << 20
"""Bytes that a chunk may be longer in the file: its header, and what packing adds to bytes that cannot be packed."""

HELD = 128 << 20
"""Bytes of messages that wait for earlier ones of a later piece; beyond that the earliest go out, order or not."""

_time = attrgetter("time_ns")


class FileSpan(NamedTuple):
    """A piece of the file: where it is, the times of its messages, and whether it is a chunk that is to be opened."""

    offset: int
    length: int
    start: int
    end: int
    chunk: bool


class SpanBag(Bag):
    """A bag of spans; subclasses find them, and read the messages of each."""

    _on_damage: Callable[[BagError], None] | None = None

    def __init__(self, path: Path, file: BinaryIO) -> None:
        super().__init__(path)
        self._file = file
        self.size = file.seek(0, 2)
        self._spans: list[FileSpan] = []

    @abstractmethod
    def _load(self, span: FileSpan) -> list[BagMessage]:
        """The messages of a span as they stand; raises anything for bad bytes."""

    def messages(
        self, topics: Collection[BagTopic] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """See `Bag.messages`; what lies in several pieces at once is put into order up to `HELD`."""
        wanted = None if topics is None else set(topics)
        spans = [
            span
            for span in sorted(self._spans, key=lambda span: span.start)
            if (start_ns is None or span.end >= start_ns) and (end_ns is None or span.start < end_ns)
        ]
        waiting: list[BagMessage] = []
        for number, span in enumerate(spans):
            rows = self._read_span(span)
            if wanted is not None:
                rows = [row for row in rows if row.topic in wanted]
            rows = _within(_ordered(rows), start_ns, end_ns)
            if waiting:
                rows = list(heapq.merge(waiting, rows, key=_time))
            due = len(rows)
            if number + 1 < len(spans):
                due = _due(rows, spans[number + 1].start)
            yield from rows[:due]
            waiting = rows[due:]

    def _read_span(self, span: FileSpan) -> list[BagMessage]:
        try:
            with reading(self.path, span.offset):
                return self._load(span)
        except BagError as err:
            if self._on_damage is None:
                raise
            self._on_damage(err)
            return []

    def skip_damage(self, told: Callable[[BagError], None]) -> None:
        """See `Bag.skip_damage`: a piece is left out."""
        self._on_damage = told

    def close(self) -> None:
        """See `Bag.close`."""
        self._file.close()

    def _read(self, offset: int, length: int) -> bytes:
        if length > MAX_CHUNK + _MORE:
            what = f"a record has {length} bytes, and chunks and messages of {MAX_CHUNK} at most are read"
            raise BagError(self.path, what, offset)
        self._file.seek(offset)
        data = self._file.read(length)
        if len(data) != length:
            raise BagError(self.path, "the file ends here", offset + len(data))
        return data

    def _set_times(self) -> None:
        if self._spans:
            self.start_ns = min(span.start for span in self._spans)
            self.end_ns = max(span.end for span in self._spans)


def _ordered(rows: list[BagMessage]) -> list[BagMessage]:
    rows.sort(key=_time)  # next to nothing where they are in order already
    return rows


def _within(rows: list[BagMessage], start_ns: int | None, end_ns: int | None) -> list[BagMessage]:
    first = 0 if start_ns is None else bisect_left(rows, start_ns, key=_time)
    last = len(rows) if end_ns is None else bisect_left(rows, end_ns, key=_time)
    return rows[first:last] if first or last < len(rows) else rows


def _due(rows: list[BagMessage], next_start: int) -> int:
    """How many go out now: those that no later piece can come before, and more where too much would wait."""
    due = bisect_right(rows, next_start, key=_time)
    held = sum(len(row.data) for row in rows[due:])
    while held > HELD:
        held -= len(rows[due].data)
        due += 1
    return due


def unpack(compression: str, data: memoryview, size: int) -> bytes | memoryview:
    """A chunk's bytes, which must be ``size`` as declared; never makes more than that. Raises what the library does."""
    if size > MAX_CHUNK:
        msg = f"a chunk declares {size} bytes, which is more than the {MAX_CHUNK} that are read"
        raise ValueError(msg)
    match compression:
        case "" | "none":
            plain: bytes | memoryview = data
        case "zstd":
            plain = _unpack_zstd(data, size)
        case "lz4":
            import lz4.frame  # type: ignore[import-untyped]

            plain = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        case "bz2":
            import bz2

            plain = bz2.BZ2Decompressor().decompress(data, max_length=size + 1)
        case _:
            msg = f"compression {compression[:20]!r} is not known: use zstd, lz4, bz2 or none"
            raise ValueError(msg)
    if len(plain) != size:
        msg = f"a chunk of {size} bytes unpacks to {'more' if len(plain) > size else len(plain)}"
        raise ValueError(msg)
    return plain


def _unpack_zstd(data: memoryview, size: int) -> bytes:
    import zstandard

    if not size:
        return b""
    told = zstandard.frame_content_size(data)
    if told not in (-1, size):
        msg = f"a chunk declares {size} bytes, and its zstd frame {told}"
        raise ValueError(msg)
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
