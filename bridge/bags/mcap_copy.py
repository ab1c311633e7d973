"""Writes MCAP from other bags; complete chunks of MCAP are copied without being compressed again.

The writer of the library `mcap` accepts single messages only and copies each several times, so this module assembles
whole chunks. The library writes all records other than chunks, messages and their indexes (https://mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray
from typing_extensions import override

from bridge import __version__
from bridge.bags.bag import BagTopic
from bridge.bags.conversion import TopicForm
from bridge.bags.definitions import stored_definition
from bridge.bags.mcap_reader import MAGIC, McapBag, WholeChunk
from bridge.bags.mcap_writer import CHUNK_BYTES, PROFILE, ChannelInfo
from bridge.bags.writers import BagWriter

_HEAD = np.dtype(
    [
        ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("time", "<u8"),
        ("publish_time", "<u8"),
    ]
)  # fmt: skip
"""A message record without its data."""

_RECORD, _CHUNK = struct.Struct("<BQ"), struct.Struct("<QQQII")
_INDEX = struct.Struct("<BQHI")
_FOOTER = struct.Struct("<BQQQ")
_PACKERS = 3
"""Number of threads that compress; for each chunk, a thread waits a few milliseconds for Python's GIL."""

_AHEAD = 8
"""Maximum number of chunks that are being compressed or waiting while others are read; fewer if they are large."""

_AHEAD_BYTES = 64 << 20

_BODY = 22
"""Bytes of a message record's body without its data."""


class ChunkedMcap(BagWriter):
    """Writes MCAP from messages and whole chunks."""

    def __init__(self, path: Path, compression: str, profile: str, library: str) -> None:
        self._file = path.open("wb")
        self._packer = ThreadPoolExecutor(_PACKERS, "midspan-bag-packer")
        self._packing: deque[tuple[Future[tuple[bytes, int]], NDArray[Any], int]] = deque()
        self._schemas: dict[int, Schema] = {}
        self._metadata: list[Metadata] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._compression = "" if compression == "none" else compression
        self._channels: dict[int, Channel] = {}
        self._counts: Counter[int] = Counter()
        self._indexes: list[ChunkIndex] = []
        self._parts: list[bytes] = []
        self._size = 0
        self._heads: list[NDArray[Any]] = []
        self._file.write(MAGIC)
        self._record(Header(profile=profile, library=library))

    def add_channel(self, channel: Channel, schema: Schema | None) -> None:
        """Add a channel and its schema, unless they exist."""
        if schema is not None and schema.id not in self._schemas:
            self._schemas[schema.id] = schema
            self._record(schema)
        if channel.id not in self._channels:
            self._channels[channel.id] = channel
            self._record(channel)

    @override
    def write(
        self, channels: Sequence[int], times: Sequence[int], publish_times: Sequence[int], data: Sequence[bytes]
    ) -> None:
        heads = np.zeros(len(data), _HEAD)
        sizes = np.fromiter(map(len, data), np.uint64, len(data))
        heads["opcode"], heads["length"], heads["channel"] = Opcode.MESSAGE, sizes + _BODY, channels
        heads["time"], heads["publish_time"] = np.array(times, np.uint64), np.array(publish_times, np.uint64)
        packed, width = heads.tobytes(), _HEAD.itemsize
        ends = np.cumsum(sizes + _HEAD.itemsize).tolist()
        start = 0
        while start < len(data):
            before = ends[start - 1] if start else 0
            end = min(bisect_right(ends, before + CHUNK_BYTES - self._size) + 1, len(data))
            parts = list(data[start:end]) * 2
            parts[::2] = [packed[at : at + width] for at in range(start * width, end * width, width)]
            parts[1::2] = data[start:end]
            self._parts += parts
            self._heads.append(heads[start:end])
            self._size += ends[end - 1] - before
            start = end
            if self._size > CHUNK_BYTES:
                self._close_chunk()

    def copy_chunk(self, chunk: WholeChunk) -> None:
        """Copy a chunk of the source with its indexes."""
        self._write_chunks()
        self._append_chunk(chunk)

    def _append_chunk(self, chunk: WholeChunk) -> None:
        at = self._file.tell()
        self._file.write(chunk.record)
        self._file.write(chunk.indexes)
        after = at + len(chunk.record)
        offsets = {number: after + offset for number, offset in chunk.offsets.items()}
        self._counts.update(chunk.counts)
        self._indexes.append(
            ChunkIndex(
                chunk_length=len(chunk.record), chunk_start_offset=at, compression=chunk.compression,
                compressed_size=chunk.packed, message_end_time=chunk.end, message_index_length=len(chunk.indexes),
                message_index_offsets=offsets, message_start_time=chunk.start, uncompressed_size=chunk.size,
            )
        )  # fmt: skip

    @override
    def finish(self) -> None:
        self._write_chunks()
        self._packer.shutdown()
        for metadata in self._metadata:
            at = self._file.tell()
            self._record(metadata)
            self._metadata_indexes.append(MetadataIndex(at, self._file.tell() - at, metadata.name))
        self._record(DataEnd(0))
        start = self._file.tell()
        summary = RecordBuilder()
        offsets: list[SummaryOffset] = []
        for opcode, records in (
            (Opcode.SCHEMA, list(self._schemas.values())), (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [self._statistics()]), (Opcode.CHUNK_INDEX, self._indexes),
            (Opcode.METADATA_INDEX, self._metadata_indexes),
        ):  # fmt: skip
            begun = summary.count
            for record in records:
                record.write(summary)
            if records:
                offsets.append(SummaryOffset(opcode, start + begun, summary.count - begun))
        offset_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        data = _bytes(summary)
        self._file.write(data)
        crc = zlib.crc32(_FOOTER.pack(Opcode.FOOTER, 20, start, offset_start), zlib.crc32(data))
        self._record(Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc))
        self._file.write(MAGIC)
        self._file.close()

    @override
    def abandon(self) -> None:
        self._packer.shutdown(cancel_futures=True)
        self._file.close()

    def _record(self, record: McapRecord) -> None:
        builder = RecordBuilder()
        record.write(builder)
        self._file.write(_bytes(builder))

    def _close_chunk(self) -> None:
        """Compress the chunk on another thread; several may be compressed at once, and are written in their order."""
        if self._parts:
            task = self._packer.submit(_pack, self._compression, b"".join(self._parts))
            self._packing.append((task, np.concatenate(self._heads), self._size))
            self._parts, self._heads, self._size = [], [], 0
        while len(self._packing) > _AHEAD or sum(size for _, _, size in self._packing) > _AHEAD_BYTES:
            self._write_chunk()

    def _write_chunks(self) -> None:
        self._close_chunk()
        while self._packing:
            self._write_chunk()

    def _write_chunk(self) -> None:
        task, heads, size = self._packing.popleft()
        packed, crc = task.result()
        start, end = int(heads["time"].min()), int(heads["time"].max())
        name = self._compression.encode()
        head = _CHUNK.pack(start, end, size, crc, len(name)) + name + len(packed).to_bytes(8, "little")
        record = b"".join((_RECORD.pack(Opcode.CHUNK, len(head) + len(packed)), head, packed))
        indexes, offsets, counts = _message_indexes(heads)
        self._append_chunk(
            WholeChunk(record, indexes, offsets, counts, self._compression, len(packed), size, start, end)
        )

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0, channel_count=len(self._channels), channel_message_counts=dict(self._counts),
            chunk_count=len(self._indexes), message_count=self._counts.total(),
            message_end_time=max((index.message_end_time for index in self._indexes), default=0),
            message_start_time=min((index.message_start_time for index in self._indexes), default=0),
            metadata_count=len(self._metadata), schema_count=len(self._schemas),
        )  # fmt: skip


class McapCopy(ChunkedMcap):
    """Writes a part of another MCAP file, with that file's channels and their numbers."""

    def __init__(self, path: Path, compression: str, source: McapBag) -> None:
        super().__init__(path, compression, source.profile, source.library)
        self._source = source
        self._metadata = source.records

    @override
    def add(self, topic: BagTopic, _form: TopicForm) -> int:
        number = self._source.number_of(topic)
        self.add_number(number)
        return number

    def add_number(self, number: int) -> None:
        """Add one of the source's channels."""
        channel = self._source.channels[number]
        self.add_channel(channel, self._source.schemas.get(channel.schema_id))


class Ros2Mcap(ChunkedMcap):
    """Writes MCAP of profile ``ros2``, as ``midspan record`` does."""

    def __init__(self, path: Path, compression: str) -> None:
        super().__init__(path, compression, PROFILE, f"midspan {__version__}")
        self._known: dict[tuple[str, str], Schema] = {}

    @override
    def add(self, topic: BagTopic, form: TopicForm) -> int:
        name, (encoding, text) = form.name or topic.name, stored_definition(form.type_name, form.definition)
        new = Schema(id=len(self._known) + 1, name=form.type_name, encoding=encoding, data=text.encode())
        schema = self._known.setdefault((form.type_name, text), new)
        info = ChannelInfo(name, form.type_name, form.type_hash, qos=topic.profiles, more=dict(topic.metadata))
        number = len(self._channels)
        channel = Channel(id=number, topic=name, message_encoding="cdr", metadata=info.metadata(), schema_id=schema.id)
        self.add_channel(channel, schema)
        return number


def _message_indexes(heads: NDArray[Any]) -> tuple[bytes, dict[int, int], dict[int, int]]:
    """Return the records of a chunk's indexes, and for each channel the record's offset and the number of messages."""
    sizes = heads["length"] + (_HEAD.itemsize - _BODY)
    entries = np.stack((heads["time"], np.cumsum(sizes) - sizes), axis=1, dtype="<u8")
    entries = entries[np.argsort(heads["channel"], kind="stable")]
    channels, firsts, counts_ = np.unique(heads["channel"], return_index=True, return_counts=True)
    ends = np.cumsum(counts_)
    indexes, offsets, counts = bytearray(), dict[int, int](), dict[int, int]()
    for index in np.argsort(firsts).tolist():
        number, count, end = int(channels[index]), int(counts_[index]), int(ends[index])
        offsets[number], counts[number] = len(indexes), count
        own_bytes = entries[end - count : end].tobytes()
        indexes += _INDEX.pack(Opcode.MESSAGE_INDEX, len(own_bytes) + 6, number, len(own_bytes)) + own_bytes
    return bytes(indexes), offsets, counts


def _bytes(builder: RecordBuilder) -> bytes:
    """Return the built bytes and clear the builder."""
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _pack(compression: str, plain: bytes) -> tuple[bytes, int]:
    """Return a chunk's compressed data, and the checksum of the uncompressed data."""
    packed = plain
    if compression == "zstd":
        import zstandard

        packed = zstandard.compress(plain)
    elif compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        packed = bytes(lz4.frame.compress(plain))
    return packed, zlib.crc32(plain)
