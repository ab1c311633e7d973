"""Reads ROS 1's bags (http://wiki.ros.org/Bags/Format/2.0), indexed or not.

Midspan writes them with `rosbags`, but does not use it for reading: `rosbags` keeps an index of all messages in memory,
unpacks chunks of any size, and refuses a bag without an index, such as that of a killed ``rosbag record``
(``.bag.active``).
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from bridge.bags.bag import MAX_TOPICS, BagError, BagTopic, Kind, reading
from bridge.bags.rows import Rows
from bridge.bags.spans import FileSpan, SpanBag, count_rows, unpack, unpack_part
from bridge.bags.split import new_table, split_ros1
from bridge.bags.stored import ros1_definition
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.definitions.schema import World

MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = range(2, 8)
_U32, _PAIR = struct.Struct("<I"), struct.Struct("<II")
_LARGEST_HEADER = 1 << 20
_LARGEST_TABLE = 16 << 20
_NS = 1_000_000_000
_RUN = 1 << 20
"""Maximum bytes of messages outside of chunks that are read at once."""

_MESSAGE_FIELD = b"\x04\0\0\0op=\x02"
_FIELDS_BEFORE = (0, 13, 17, 30)
"""Possible lengths in bytes of the header fields before ``op``: none, ``conn``, ``time``, or both."""


Fields = dict[bytes, bytes]


class Ros1Bag(SpanBag):
    """A bag of ROS 1, as its chunks and the messages outside of chunks."""

    kind: Kind = "bag"

    def __init__(self, path: Path, file: BinaryIO) -> None:
        super().__init__(path, file)
        self._connections: dict[int, tuple[Fields, Fields]] = {}
        self._infos: dict[int, tuple[int, int, Counter[int]]] = {}
        self._compressions: set[str] = set()
        self._fixed = self._encrypted = False
        self._cut: int | None = None  # position of the record within which the file ends
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
                self._end(at)
                size, self._cut = self.size - body, at
            try:
                with reading(self.path, at):
                    self._walk_record(parse_fields(self._read(at + 4, length)), at, body, size)
            except BagError as err:  # the record's lengths are right, so the next record can be read
                self.trouble = self.trouble or err
            at = body + size
        return None

    def _walk_record(self, fields: Fields, at: int, body: int, size: int) -> None:
        kind = fields[b"op"][0]
        if kind == _CHUNK:
            if not size and not any(fields[b"size"]):  # the chunk was never closed; its records follow
                return
            self._compressions.add(fields[b"compression"].decode(errors="replace")[:20])
            self._spans.append(FileSpan(at, body + size - at, 0, 0, chunk=True))
        elif self._cut is not None:
            return
        elif kind == _MESSAGE:
            self._walk_message(at, body + size - at)
        elif kind == _BAG:
            self._encrypted = bool(fields.get(b"encryptor"))
            if not any(fields[b"index_pos"]):
                self._end(self.size, "the bag has no index: its writer never closed it")
        elif kind in (_CONNECTION, _CHUNK_INFO):
            if size > _LARGEST_TABLE:
                raise BagError(self.path, f"a record of the index declares {size} bytes", at)
            data = self._read(body, size)
            if kind == _CONNECTION:
                self._store_record(fields, data)
            else:
                self._infos[int.from_bytes(fields[b"chunk_pos"], "little")] = (
                    _time(fields[b"start_time"]),
                    _time(fields[b"end_time"]),
                    Counter(dict(_PAIR.iter_unpack(data))),
                )

    def _walk_message(self, at: int, length: int) -> None:
        last = self._spans[-1] if self._spans else None
        if last is not None and not last.chunk and last.offset + last.length == at and last.length + length <= _RUN:
            self._spans[-1] = last._replace(length=last.length + length)
        else:
            self._spans.append(FileSpan(at, length, 0, 0, chunk=False))

    def _store_record(self, fields: Fields, data: bytes) -> None:
        number = _U32.unpack(fields[b"conn"])[0]
        if number in self._connections:
            return
        if self._fixed:
            raise BagError(self.path, f"the index does not have connection {number}")
        if len(self._connections) >= MAX_TOPICS:
            raise BagError(self.path, f"the bag has more than {MAX_TOPICS} connections")
        self._connections[number] = (fields, parse_fields(data))

    def _scan(self) -> Counter[int]:
        """Return the message counts and set the times of all chunks, from the index or else from the chunk itself."""
        counts: Counter[int] = Counter()
        for index, span in enumerate(self._spans):
            if span.offset in self._infos:
                start, end, own_counts = self._infos[span.offset]
                self._spans[index] = span._replace(start=start, end=max(start, end))
                counts.update(own_counts)
                continue
            try:
                with reading(self.path, span.offset):
                    self._spans[index] = count_rows(self._split(span, self._note), counts, span)
            except BagError as err:
                self._note(err)
        return counts

    def _note(self, err: BagError) -> None:
        self.trouble = self.trouble or err

    @override
    def _load(self, span: FileSpan) -> Rows:
        on_damage = self._note if span.offset == self._cut else self._on_damage or _raise
        rows = self._split(span, on_damage)
        if unknown := set(np.unique(rows.numbers).tolist()) - self.topic_of.keys():
            msg = f"a message refers to connection {min(unknown)}, which is missing in the bag"
            on_damage(BagError(self.path, msg, span.offset))
        return rows

    def _split(self, span: FileSpan, on_damage: Callable[[BagError], None]) -> Rows:
        """Return the messages of a piece, without a damaged part unless ``on_damage`` raises the error."""
        data = self._plain(span, on_damage)
        table, at, filled, sound = new_table(len(data)), 0, 0, True
        while True:
            at, filled = split_ros1(data, table, at, filled)
            if at >= len(data):
                return Rows(data, table[:filled])
            try:
                with reading(self.path, span.offset):
                    at, filled = self._split_other(span, data, table, at, filled)
            except BagError as err:
                if sound:
                    on_damage(err)
                sound = False
                at, filled = self._resume(data, table, at, filled)

    def _split_other(
        self, span: FileSpan, data: bytes, table: NDArray[np.uint64], at: int, filled: int
    ) -> tuple[int, int]:
        """Parse one record as the kernel (`split_ros1`) does, but of any kind and with any fields."""
        (length,) = _U32.unpack_from(data, at)
        fields = parse_fields(data[at + 4 : at + 4 + length])
        body = at + 8 + length
        (count,) = _U32.unpack_from(data, body - 4)
        if body + count > len(data):
            raise BagError(self.path, "a record is longer than its chunk", span.offset)
        kind = fields[b"op"][0]
        if kind == _MESSAGE:
            time = _time(fields[b"time"])
            table[filled] = _U32.unpack(fields[b"conn"])[0], time, time, body, count
            filled += 1
        elif kind == _CONNECTION:
            self._store_record(fields, data[body : body + count])
        return body + count, filled

    def _resume(self, data: bytes, table: NDArray[np.uint64], at: int, filled: int) -> tuple[int, int]:
        """Find the next message of a known connection after the damage at ``at``.

        The search includes the data of the previous message: if that contains a message, the previous message's length
        is wrong.
        """
        start = int(table[filled - 1, 3]) if filled else at + 1
        row = new_table(0)
        position = data.find(_MESSAGE_FIELD, start)
        while position >= 0:
            for before in _FIELDS_BEFORE:
                head = position - 4 - before
                if head >= start and split_ros1(data, row, head, 0)[1] and int(row[0, 0]) in self._connections:
                    return head, filled - (head < at)
            position = data.find(_MESSAGE_FIELD, position + 1)
        return len(data), filled

    def _plain(self, span: FileSpan, on_damage: Callable[[BagError], None]) -> bytes:
        """Return a piece's records, or those that can be unpacked."""
        if not span.chunk:
            return self._read(span.offset, span.length)
        (length,) = _U32.unpack(self._read(span.offset, 4))
        fields = parse_fields(self._read(span.offset + 4, length))
        packed = self._read(span.offset + 8 + length, span.length - 8 - length)
        compression, (size,) = fields[b"compression"].decode(errors="replace"), _U32.unpack(fields[b"size"])
        try:
            with reading(self.path, span.offset):
                return unpack(compression, packed, size)
        except BagError as err:
            on_damage(err)
            return unpack_part(compression, packed, size)


def _raise(err: BagError) -> None:
    raise err


def parse_fields(data: bytes) -> Fields:
    """Parse the fields of a header, ``<length><name>=<value>`` each; raises `ValueError` or `struct.error`."""
    fields: Fields = {}
    at, size = 0, len(data)
    while at < size:
        (length,) = _U32.unpack_from(data, at)
        end = at + 4 + length
        name, sign, value = data[at + 4 : end].partition(b"=")
        if end > size or not sign:
            msg = "a header's field has no name, or is longer than the header"
            raise ValueError(msg)
        fields[name] = value
        at = end
    return fields


def _time(value: bytes) -> int:
    seconds, nanoseconds = _PAIR.unpack(value)
    return int(seconds) * _NS + int(nanoseconds)


def _topic(record: Fields, header: Fields, count: int) -> BagTopic:
    caller = header.get(b"callerid", b"").decode(errors="replace")
    type_name, md5 = header[b"type"].decode(), header.get(b"md5sum", b"").decode()
    text = header.get(b"message_definition", b"").decode(errors="replace")
    return BagTopic(
        record[b"topic"].decode(),
        type_name,
        World.ROS1,
        ros1_definition(text, md5),
        md5,
        LATCHED if header.get(b"latching") == b"1" else Qos(),
        count,
        {"callerid": caller} if caller else {},
    )
