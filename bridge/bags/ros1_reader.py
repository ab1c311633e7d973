"""Reads ROS 1's bags (http://wiki.ros.org/Bags/Format/2.0), indexed or not.

`rosbags` writes them here, and does not read them: it keeps an index of all messages in memory, unpacks chunks without
a bound, and refuses a bag without an index, as a killed ``rosbag record`` leaves it (``.bag.active``).
"""

from __future__ import annotations

import struct
from collections import Counter
from pathlib import Path
from typing import BinaryIO

import numpy as np

from bridge.bags.bag import MAX_TOPICS, BagError, BagTopic, Kind, reading
from bridge.bags.rows import Rows
from bridge.bags.spans import FileSpan, SpanBag, count_rows, unpack
from bridge.bags.split import new_table, split_ros1
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.definitions.schema import World

MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = range(2, 8)
_U32, _PAIR = struct.Struct("<I"), struct.Struct("<II")
_LARGEST_HEADER = 1 << 20
_LARGEST_TABLE = 16 << 20
_NS = 1_000_000_000

Fields = dict[bytes, bytes]


class Ros1Bag(SpanBag):
    """One ROS 1 bag."""

    kind: Kind = "bag"

    def __init__(self, path: Path, file: BinaryIO) -> None:
        super().__init__(path, file)
        self._connections: dict[int, tuple[Fields, Fields]] = {}
        self._infos: dict[int, tuple[int, int, Counter[int]]] = {}
        self._compressions: set[str] = set()
        self._fixed = self._encrypted = False
        with reading(path, 0):
            self._walk()
        if self._encrypted:
            raise BagError(path, "the bag is encrypted", None, "decrypt it with 'rosbag decrypt'")
        counts = self._scan()
        self._fixed = True
        with reading(path):
            for number, (record, header) in self._connections.items():
                self.topic_of[number] = _topic(record, header, counts[number])
        self.topics = tuple(self.topic_of.values())
        self.compression = ",".join(sorted(self._compressions)) or "none"
        self._set_times()

    def _walk(self) -> None:
        at = len(MAGIC)
        while at < self.size:
            if at + 4 > self.size:
                return self._end(at)
            length = _U32.unpack(self._read(at, 4))[0]
            if at + 8 + length > self.size:
                return self._end(at)
            if length > _LARGEST_HEADER:
                raise BagError(self.path, f"a record's header declares {length} bytes", at)
            body = at + 8 + length
            size = _U32.unpack(self._read(body - 4, 4))[0]
            if body + size > self.size:
                return self._end(at)
            try:
                with reading(self.path, at):
                    self._walk_record(parse_fields(self._read(at + 4, length)), at, body, size)
            except BagError as err:  # its lengths are right, and so the next one can be read
                self.trouble = self.trouble or err
            at = body + size
        return None

    def _walk_record(self, fields: Fields, at: int, body: int, size: int) -> None:
        kind = fields[b"op"][0]
        if kind == _BAG:
            self._encrypted = bool(fields.get(b"encryptor"))
            if not any(fields[b"index_pos"]):
                self._end(self.size, "the bag has no index: its writer never closed it")
        elif kind == _CHUNK:
            self._compressions.add(fields[b"compression"].decode(errors="replace")[:20])
            self._spans.append(FileSpan(at, body + size - at, 0, 0, chunk=True))
        elif kind in (_CONNECTION, _CHUNK_INFO):
            if size > _LARGEST_TABLE:
                raise BagError(self.path, f"a record of the index declares {size} bytes", at)
            data = self._read(body, size)
            if kind == _CONNECTION:
                self._take(fields, data)
            else:
                self._infos[int.from_bytes(fields[b"chunk_pos"], "little")] = (
                    _time(fields[b"start_time"]),
                    _time(fields[b"end_time"]),
                    Counter(dict(_PAIR.iter_unpack(data))),
                )

    def _end(self, offset: int, what: str = "the file ends within a record, or a length is wrong") -> None:
        self.unfinished = True
        cure = "what stands before can be read; 'midspan bag mend' writes it into a whole file"
        self.trouble = BagError(self.path, what, offset, cure)

    def _take(self, fields: Fields, data: bytes) -> None:
        number = _U32.unpack(fields[b"conn"])[0]
        if number in self._connections:
            return
        if self._fixed:
            raise BagError(self.path, f"the index does not have connection {number}")
        if len(self._connections) >= MAX_TOPICS:
            raise BagError(self.path, f"the bag has more than {MAX_TOPICS} connections")
        self._connections[number] = (fields, parse_fields(data))

    def _scan(self) -> Counter[int]:
        """The times and counts of all chunks: from the index, else from the chunk itself."""
        counts: Counter[int] = Counter()
        for place, span in enumerate(self._spans):
            if span.offset in self._infos:
                start, end, own = self._infos[span.offset]
                self._spans[place] = span._replace(start=start, end=max(start, end))
                counts.update(own)
                continue
            try:
                with reading(self.path, span.offset):
                    self._spans[place] = count_rows(self._split(span), counts, span)
            except BagError as err:
                self.trouble = self.trouble or err
        return counts

    def _load(self, span: FileSpan) -> Rows:
        rows = self._split(span)
        for number in np.unique(rows.numbers).tolist():
            if number not in self.topic_of:
                msg = f"a message is of connection {number}, which the bag does not have"
                raise BagError(self.path, msg, span.offset)
        return rows

    def _split(self, span: FileSpan) -> Rows:
        data = self._plain(span)
        table, at, filled, size = new_table(len(data)), 0, 0, len(data)
        while True:
            at, filled = split_ros1(data, table, at, filled)
            if at >= size:
                return Rows(data, table[:filled])
            (length,) = _U32.unpack_from(data, at)
            fields = parse_fields(data[at + 4 : at + 4 + length])
            body = at + 8 + length
            (count,) = _U32.unpack_from(data, body - 4)
            at = body + count
            if at > size:
                raise BagError(self.path, "a record is longer than its chunk", span.offset)
            kind = fields[b"op"][0]
            if kind == _MESSAGE:
                time = _time(fields[b"time"])
                table[filled] = _U32.unpack(fields[b"conn"])[0], time, time, body, count
                filled += 1
            elif kind == _CONNECTION:
                self._take(fields, data[body:at])

    def _plain(self, span: FileSpan) -> bytes:
        """A chunk's records."""
        (length,) = _U32.unpack(self._read(span.offset, 4))
        fields = parse_fields(self._read(span.offset + 4, length))
        packed = self._read(span.offset + 8 + length, span.length - 8 - length)
        compression, (size,) = fields[b"compression"].decode(errors="replace"), _U32.unpack(fields[b"size"])
        return unpack(compression, packed, size)


def parse_fields(data: bytes) -> Fields:
    """The fields of a header, ``<length><name>=<value>`` each; raises `ValueError` or `struct.error`."""
    found: Fields = {}
    at, size = 0, len(data)
    while at < size:
        (length,) = _U32.unpack_from(data, at)
        end = at + 4 + length
        name, sign, value = data[at + 4 : end].partition(b"=")
        if end > size or not sign:
            msg = "a header's field has no name, or is longer than the header"
            raise ValueError(msg)
        found[name] = value
        at = end
    return found


def _time(value: bytes) -> int:
    seconds, nanoseconds = _PAIR.unpack(value)
    return int(seconds) * _NS + int(nanoseconds)


def _topic(record: Fields, header: Fields, count: int) -> BagTopic:
    caller = header.get(b"callerid", b"").decode(errors="replace")
    return BagTopic(
        record[b"topic"].decode(),
        header[b"type"].decode(),
        World.ROS1,
        header.get(b"message_definition", b"").decode(errors="replace"),
        header.get(b"md5sum", b"").decode(),
        LATCHED if header.get(b"latching") == b"1" else Qos(),
        count,
        {"callerid": caller} if caller else {},
    )
