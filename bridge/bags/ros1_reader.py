"""Reads ROS 1's bags (http://wiki.ros.org/Bags/Format/2.0), indexed or not.

`rosbags` writes them here, and does not read them: it keeps an index of all messages in memory, unpacks chunks without
a bound, and refuses a bag without an index, as a killed ``rosbag record`` leaves it (``.bag.active``).
"""

from __future__ import annotations

import struct
from collections import Counter
from pathlib import Path
from typing import BinaryIO

from bridge.bags.bag import MAX_TOPICS, BagError, BagMessage, BagTopic, Kind, reading
from bridge.bags.spans import FileSpan, SpanBag, unpack
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.definitions.schema import World

MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = range(2, 8)
_U32, _PAIR = struct.Struct("<I"), struct.Struct("<II")
_LARGEST_HEADER = 1 << 20
_LARGEST_TABLE = 16 << 20
_NS = 1_000_000_000
_MESSAGE_HEADER = 42
"""Bytes of a message's header of the fields ``op``, ``conn`` and ``time``, with its length."""
_NO_HEAD = struct.Struct("<0sI0sII0sI")

Fields = dict[bytes, bytes]


class Ros1Bag(SpanBag):
    """One ROS 1 bag."""

    kind: Kind = "bag"

    def __init__(self, path: Path, file: BinaryIO) -> None:
        super().__init__(path, file)
        self._connections: dict[int, tuple[Fields, Fields]] = {}
        self._topic_of: dict[int, BagTopic] = {}
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
                self._topic_of[number] = _topic(record, header, counts[number])
        self.topics = tuple(self._topic_of.values())
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
                    records = self._records(span)
                    counts.update(number for number, _, _ in records)
                    times = [time for _, time, _ in records]
                    if times:
                        self._spans[place] = span._replace(start=min(times), end=max(times))
            except BagError as err:
                self.trouble = self.trouble or err
        return counts

    def _records(self, span: FileSpan) -> list[tuple[int, int, bytes]]:
        """Connection, time and data of each message of a chunk."""
        raw = self._read(span.offset, span.length)
        length = _U32.unpack_from(raw)[0]
        fields = parse_fields(raw[4 : 4 + length])
        size = _U32.unpack(fields[b"size"])[0]
        data = unpack(fields[b"compression"].decode(errors="replace"), memoryview(raw)[8 + length :], size)
        found = []
        head, same = _NO_HEAD, None
        at, u32 = 0, _U32.unpack_from
        while at < size:
            if at + head.size <= size:
                begin, number, between, seconds, nanoseconds, end, count = head.unpack_from(data, at)
                if (begin, between, end) == same:  # as the message before, but for connection and time
                    body = at + head.size
                    at = body + count
                    if at > size:
                        raise BagError(self.path, "a record is longer than its chunk", span.offset)
                    found.append((number, seconds * _NS + nanoseconds, bytes(data[body:at])))
                    continue
            (length,) = u32(data, at)
            header = bytes(data[at : at + 4 + length])
            fields = parse_fields(header[4:])
            body = at + 8 + length
            (count,) = u32(data, body - 4)
            at = body + count
            if at > size:
                raise BagError(self.path, "a record is longer than its chunk", span.offset)
            kind = fields[b"op"][0]
            if kind == _MESSAGE:
                found.append((_U32.unpack(fields[b"conn"])[0], _time(fields[b"time"]), bytes(data[body:at])))
                head = _message_head(header)
                begin, _, between, _, _, end, _ = head.unpack_from(data, body - len(header) - 4)
                same = None if head is _NO_HEAD else (begin, between, end)
            elif kind == _CONNECTION:
                self._take(fields, bytes(data[body:at]))
        return found

    def _load(self, span: FileSpan) -> list[BagMessage]:
        topics, records = self._topic_of, self._records(span)
        try:
            return [BagMessage(topics[number], time, time, data) for number, time, data in records]
        except KeyError as err:
            msg = f"a message is of connection {err}, which the bag does not have"
            raise BagError(self.path, msg, span.offset) from None


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


def _message_head(header: bytes) -> struct.Struct:
    """Where connection, time and the data's length stand in a message's head with its length, beside what is the same.

    A head of other fields than a message has gets `_NO_HEAD`, and is parsed field by field.
    """
    conn, time = header.find(b"\x09\0\0\0conn=") + 9, header.find(b"\x0d\0\0\0time=") + 9
    if len(header) != _MESSAGE_HEADER or not 9 <= conn < time:
        return _NO_HEAD
    return struct.Struct(f"<{conn}sI{time - conn - 4}sII{_MESSAGE_HEADER - time - 8}sI")


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
