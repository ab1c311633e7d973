"""Reads MCAP, finished or not: profiles ``ros1`` and ``ros2``, any chunks and compression.

The records are those of https://mcap.dev/spec; the library `mcap` parses all but messages, their indexes and chunk
headers. The reader first walks from record to record, which costs a few short reads per chunk, so that it neither needs
nor trusts the file's index. Channels and counts come from the summary if it has statistics and the file is undamaged,
else from the chunks.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema, Statistics
from typing_extensions import override

from bridge.bags.bag import MAX_TOPICS, BagError, BagTopic, Kind, reading
from bridge.bags.qos import merged_qos, parse_qos
from bridge.bags.rows import Rows
from bridge.bags.spans import FileSpan, SpanBag, count_rows, unpack
from bridge.bags.split import new_table, split_mcap
from bridge.bags.stored import ros1_definition, ros2_definition, stored_hash
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.definitions.schema import World

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQII")
_LARGEST_TABLE = 16 << 20
"""Maximum bytes of a header, schema, channel, statistics or message index record."""
_RUN = 1 << 20
"""Maximum bytes of messages outside of chunks that are read at once."""

_TEXTS = {"ros1msg", "ros2msg"}
_WORLDS = {"cdr": World.ROS2, "ros1": World.ROS1}
_TABLES = {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS}
_MOST_METADATA, _LARGEST_METADATA = 1000, 1 << 16


class WholeChunk(NamedTuple):
    """A chunk's record and the records of its indexes, as stored.

    Attributes:
        offsets: position of each channel's index in ``indexes``.
        counts: number of messages of each channel.
        packed, size: size of the chunk's data in bytes, in the file and unpacked.
        start, end: times of the first and the last message.
    """

    record: bytes
    indexes: bytes
    offsets: Mapping[int, int]
    counts: Mapping[int, int]
    compression: str
    packed: int
    size: int
    start: int
    end: int


class McapBag(SpanBag):
    """One MCAP file. ``profile`` and ``library`` are those of its header, ``records`` its metadata records."""

    kind: Kind = "mcap"

    def __init__(self, path: Path, file: BinaryIO) -> None:
        super().__init__(path, file)
        self.profile = self.library = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.records: list[Metadata] = []
        self._left_out: dict[int, str] = {}
        self._statistics: Statistics | None = None
        self._compressions: set[str] = set()
        self._fixed = False
        with reading(path, 0):
            self._walk()
        counts: Counter[int] = Counter()
        if self.trouble is not None or self._statistics is None or not self.channels:
            counts = self._scan()
        else:
            counts.update(self._statistics.channel_message_counts)
        self._fixed = True
        with reading(path):
            for number, channel in self.channels.items():
                self._make_topic(number, channel, counts[number])
        self.topics = tuple(self.topic_of.values())
        self.left_out = tuple(self._left_out.values())
        self.compression = ",".join(sorted(self._compressions)) or "none"
        self._set_times()

    def number_of(self, topic: BagTopic) -> int:
        """Return the number of a topic's channel."""
        return next(number for number, candidate in self.topic_of.items() if candidate is topic)

    def spans(self) -> list[FileSpan]:
        """Return the pieces of the file, in order of their first times."""
        return sorted(self._spans, key=lambda span: span.start)

    def span_rows(self, span: FileSpan) -> Rows:
        """Return the messages of a piece as stored, of all channels; raises `BagError`."""
        with reading(self.path, span.offset):
            rows = self._split(span)
        if set(np.unique(rows.numbers).tolist()) - self.channels.keys():
            raise BagError(self.path, "a message refers to a channel that is missing in the file", span.offset)
        return rows

    def whole_chunk(self, span: FileSpan) -> WholeChunk | None:
        """Return a chunk with its indexes; raises `BagError` if the chunk is damaged.

        None for messages outside of chunks, and for a chunk without indexes or with an index of an unknown channel.
        """
        if not span.chunk:
            return None
        with reading(self.path, span.offset):
            whole = self._read(span.offset, _HEAD.size + span.length)
            plain, compression = self._unpacked(span, memoryview(whole)[_HEAD.size :])
            at = span.offset + _HEAD.size + span.length
            indexes, offsets, counts = bytearray(), dict[int, int](), dict[int, int]()
            while at + _HEAD.size < self.size:
                opcode, length = _HEAD.unpack(self._read(at, _HEAD.size))
                if opcode != Opcode.MESSAGE_INDEX or length > _LARGEST_TABLE:
                    break
                record = self._read(at, _HEAD.size + length)
                number = int.from_bytes(record[9:11], "little")
                offsets[number] = len(indexes)
                counts[number] = (length - 6) // 16
                indexes += record
                at += len(record)
            if not offsets or offsets.keys() - self.channels.keys():
                return None
            packed = span.length - _CHUNK.size - len(compression) - 8
            return WholeChunk(
                whole, bytes(indexes), offsets, counts, compression, packed, len(plain), span.start, span.end
            )

    def _walk(self) -> None:
        """Walk from record to record, up to the footer, the end of the file, or an impossible record."""
        at = len(MAGIC)
        while True:
            if at + _HEAD.size > self.size:
                return self._end(at, "the file ends without its footer")
            opcode, length = _HEAD.unpack(self._read(at, _HEAD.size))
            body, after = at + _HEAD.size, at + _HEAD.size + length
            if opcode == 0 or after > self.size:
                return self._end(at)
            if opcode == Opcode.FOOTER:
                return None if self._magic_at(after) else self._end(after, "the file ends without its last bytes")
            try:
                with reading(self.path, at):
                    self._walk_record(opcode, at, body, length)
            except BagError as err:  # the record's length is right, so the next record can be read
                self.trouble = self.trouble or err
            at = after

    def _walk_record(self, opcode: int, at: int, body: int, length: int) -> None:
        if opcode == Opcode.CHUNK:
            self._walk_chunk(at, body, length)
        elif opcode == Opcode.MESSAGE:
            self._walk_message(at, body, length)
        elif opcode in _TABLES:
            if length > _LARGEST_TABLE:
                raise BagError(self.path, f"a record of type {opcode} declares {length} bytes", at)
            self._store_record(opcode, self._read(body, length))
        elif opcode == Opcode.METADATA and length <= _LARGEST_METADATA and len(self.records) < _MOST_METADATA:
            self.records.append(Metadata.read(ReadDataStream(io.BytesIO(self._read(body, length)))))
            self.about = {record.name: record.metadata for record in self.records}

    def _magic_at(self, offset: int) -> bool:
        return self.size >= offset + len(MAGIC) and self._read(offset, len(MAGIC)) == MAGIC

    def _walk_chunk(self, at: int, body: int, length: int) -> None:
        if length < _CHUNK.size:
            raise BagError(self.path, f"a chunk has only {length} bytes", at)
        start, end, _, _, name = _CHUNK.unpack(self._read(body, _CHUNK.size))
        if name > 20 or _CHUNK.size + name + 8 > length:
            raise BagError(self.path, "a chunk has an unknown compression", at)
        self._compressions.add(self._read(body + _CHUNK.size, name).decode(errors="replace") or "none")
        self._spans.append(FileSpan(at, length, start, max(start, end), chunk=True))

    def _walk_message(self, at: int, body: int, length: int) -> None:
        if length < _MESSAGE.size:
            raise BagError(self.path, f"a message record has only {length} bytes", at)
        time = _MESSAGE.unpack(self._read(body, _MESSAGE.size))[2]
        size = _HEAD.size + length
        last = self._spans[-1] if self._spans else None
        if last is not None and not last.chunk and last.offset + last.length == at and last.length + size <= _RUN:
            self._spans[-1] = FileSpan(
                last.offset, last.length + size, min(last.start, time), max(last.end, time), False
            )
        else:
            self._spans.append(FileSpan(at, size, time, time, chunk=False))

    def _store_record(self, opcode: int, data: bytes) -> None:
        """Store a record that describes the whole file."""
        stream = ReadDataStream(io.BytesIO(data))
        if opcode == Opcode.HEADER:
            header = Header.read(stream)
            self.profile, self.library = header.profile, header.library
        elif opcode == Opcode.STATISTICS:
            self._statistics = Statistics.read(stream)
        elif opcode == Opcode.SCHEMA:
            if int.from_bytes(data[:2], "little") not in self.schemas:
                schema = Schema.read(stream)
                self.schemas[schema.id] = schema
        elif int.from_bytes(data[:2], "little") not in self.channels:
            channel = Channel.read(stream)
            if self._fixed:
                raise BagError(self.path, f"the summary does not have channel {channel.id} ({channel.topic!r})")
            if len(self.channels) < MAX_TOPICS:
                self.channels[channel.id] = channel

    def _scan(self) -> Counter[int]:
        """Search all chunks for channels and counts; a damaged chunk raises an error only when it is read later."""
        counts: Counter[int] = Counter()
        for number, span in enumerate(self._spans):
            try:
                with reading(self.path, span.offset):
                    self._spans[number] = count_rows(self._split(span), counts, span)
            except BagError as err:
                self.trouble = self.trouble or err
        return counts

    def _make_topic(self, number: int, channel: Channel, count: int) -> None:
        schema = self.schemas.get(channel.schema_id)
        world = _WORLDS.get(channel.message_encoding)
        if world is None or (schema is None and channel.schema_id):
            self._left_out[number] = f"{channel.topic} ({channel.message_encoding or 'no encoding'})"
            return
        more = dict(channel.metadata)
        offered = parse_qos(more.pop("offered_qos_profiles", ""))
        fingerprint = more.pop("md5sum", "") if world is World.ROS1 else more.pop("topic_type_hash", "")
        if world is World.ROS1:
            qos = LATCHED if more.pop("latching", "") in ("1", "true") else Qos()
        else:
            qos = merged_qos(offered)
        for name in ("topic", "type", "message_definition"):
            more.pop(name, None)
        definition = ""
        if schema is not None:
            text = schema.data.decode(errors="replace")
            if world is World.ROS1:
                definition = ros1_definition(text if schema.encoding in _TEXTS else "", fingerprint)
            else:
                definition = ros2_definition(schema.name, schema.encoding, text, fingerprint)
        self.topic_of[number] = BagTopic(
            channel.topic,
            "" if schema is None else schema.name,
            world,
            definition,
            fingerprint if world is World.ROS1 else stored_hash(fingerprint),
            qos,
            count,
            more,
            offered,
        )

    def _plain(self, span: FileSpan) -> bytes:
        if not span.chunk:
            return self._read(span.offset, span.length)
        return self._unpacked(span, memoryview(self._read(span.offset + _HEAD.size, span.length)))[0]

    def _unpacked(self, span: FileSpan, body: memoryview) -> tuple[bytes, str]:
        """Return a chunk's records and its compression."""
        _, _, size, crc, name = _CHUNK.unpack_from(body)
        compression = bytes(body[_CHUNK.size : _CHUNK.size + name]).decode(errors="replace")
        begin = _CHUNK.size + name + 8
        declared = int.from_bytes(body[begin - 8 : begin], "little")
        if declared != len(body) - begin:
            raise BagError(self.path, f"a chunk has {len(body) - begin} bytes, but declares {declared}", span.offset)
        plain = unpack(compression, body[begin:], size)
        if crc and zlib.crc32(plain) != crc:
            raise BagError(self.path, "a chunk's checksum is wrong, so its bytes were changed", span.offset)
        return plain, compression

    def _split(self, span: FileSpan) -> Rows:
        """Return all messages of a piece, of all channels; store the channels that the piece defines."""
        data = self._plain(span)
        table, at, filled, size = new_table(len(data)), 0, 0, len(data)
        while True:
            at, filled = split_mcap(data, table, at, filled)
            if at >= size:
                return Rows(data, table[:filled])
            opcode, length = _HEAD.unpack_from(data, at)
            body, at = at + _HEAD.size, at + _HEAD.size + length
            if at > size:
                raise BagError(self.path, "a record is longer than its chunk", span.offset)
            if opcode == Opcode.MESSAGE:
                raise BagError(self.path, f"a message record has only {length} bytes", span.offset)
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._store_record(opcode, data[body:at])

    @override
    def _load(self, span: FileSpan) -> Rows:
        rows = self._split(span)
        for number in np.unique(rows.numbers).tolist():
            if number not in self.topic_of and number not in self._left_out:
                problem = f"a message refers to channel {number}, which is missing in the file"
                raise BagError(self.path, problem, span.offset)
        return rows
