"""Reads rosbag2's SQLite files, all versions of their tables (rosbag2_storage_sqlite3, sqlite_storage.cpp).

It uses the standard library's `sqlite3` with SQLite's defenses against malicious files
(https://www.sqlite.org/security.html): sizes are limited, and views and functions in the file are not trusted.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from typing_extensions import override

from bridge.bags.bag import MAX_CHUNK, MAX_TOPICS, Bag, BagError, BagMessage, BagTopic, Kind, reading
from bridge.bags.packed import ZSTD, unpacked_message
from bridge.bags.qos import merged_qos, parse_qos
from bridge.bags.stored import ros2_definition, stored_hash
from bridge.messages.definitions.schema import World

MAGIC = b"SQLite format 3\0"
_LARGEST_TEXT = 4 << 20
_STEPS, _MAX_CHECKS = 1_000_000, 60
"""SQLite instructions between two checks, and the maximum number of checks per 64 MiB while a file is opened."""


class Db3Bag(Bag):
    """One SQLite file of rosbag2."""

    kind: Kind = "db3"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.size = path.stat().st_size
        with reading(path):
            self._file = _connect(path)
        try:
            with reading(path), self._bounded():
                self._topic_of = self._read_topics()
                self.compression = "zstd" if self._first().startswith(ZSTD) else "none"
        except BaseException:
            self.close()
            raise
        self.topics = tuple(self._topic_of.values())

    def _first(self) -> bytes:
        """Return the data of a message, b"" for a bag without messages."""
        row = self._file.execute("SELECT data FROM messages LIMIT 1").fetchone()
        return b"" if row is None else _blob(row[0])

    def _read_topics(self) -> dict[int, BagTopic]:
        tables = {name for (name,) in self._file.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"topics", "messages"} <= tables:
            raise BagError(self.path, "is not a bag: tables 'topics' and 'messages' are missing")
        known = {row[1] for row in self._file.execute("PRAGMA table_info(topics)")}
        qos = "offered_qos_profiles" if "offered_qos_profiles" in known else "''"
        type_hash = "type_description_hash" if "type_description_hash" in known else "''"
        definitions = self._read_definitions() if "message_definitions" in tables else {}
        counts = dict(self._file.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        start, end = self._file.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
        self.start_ns, self.end_ns = int(start or 0), int(end or 0)
        query = f"SELECT id, name, type, serialization_format, {qos}, {type_hash} FROM topics ORDER BY id"  # noqa: S608
        topics: dict[int, BagTopic] = {}
        left_out: list[str] = []
        for number, name, type_name, encoding, offered, hashed in self._file.execute(query):
            if len(topics) >= MAX_TOPICS:
                raise BagError(self.path, f"the bag has more than {MAX_TOPICS} topics")
            if encoding != "cdr":
                left_out.append(f"{name} ({str(encoding)[:20]})")
                continue
            definition = ""
            if type_name in definitions:
                definition = ros2_definition(type_name, *definitions[type_name], _text(hashed))
            count = int(counts.get(number, 0))
            profiles = parse_qos(_text(offered))
            topics[number] = BagTopic(
                _text(name), _text(type_name), World.ROS2, definition, stored_hash(_text(hashed)), merged_qos(profiles),
                count, offered=profiles,
            )  # fmt: skip
        self.left_out = tuple(left_out)
        return topics

    def _read_definitions(self) -> dict[str, tuple[str, str]]:
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        rows = [tuple(map(_text, row)) for row in self._file.execute(query)]
        return {name: (encoding, text) for name, encoding, text in rows}

    @override
    def messages(
        self, topics: Collection[BagTopic] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        wanted = None if topics is None else set(topics)
        ids = [number for number, topic in self._topic_of.items() if wanted is None or topic in wanted]
        clauses, values = ["1"], list[int]()
        if len(ids) <= 100:  # otherwise all messages are read, and the others skipped
            clauses.append(f"topic_id IN ({','.join('?' * len(ids))})")
            values += ids
        for clause, value in (("timestamp >= ?", start_ns), ("timestamp < ?", end_ns)):
            if value is not None:
                clauses.append(clause)
                values.append(min(max(value, -(1 << 63)), (1 << 63) - 1))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE {' AND '.join(clauses)} ORDER BY timestamp, id"  # noqa: S608
        chosen = {number: self._topic_of[number] for number in ids}
        with reading(self.path):
            rows = self._file.execute(query, values)
        while True:
            with reading(self.path):
                row = rows.fetchone()
                if row is None:
                    return
                if row[0] not in chosen:
                    continue
                time = int(row[1])
                message = BagMessage(chosen[row[0]], time, time, unpacked_message(_blob(row[2])))
            yield message

    @contextlib.contextmanager
    def _bounded(self) -> Iterator[None]:
        """Interrupt a query that computes endlessly."""
        checks = 0

        def check() -> int:
            nonlocal checks
            checks += 1
            return int(checks > _MAX_CHECKS * (1 + self.size // (64 << 20)))

        self._file.set_progress_handler(check, _STEPS)
        try:
            yield
        finally:
            self._file.set_progress_handler(None, 0)

    @override
    def close(self) -> None:
        self._file.close()


def _connect(path: Path) -> sqlite3.Connection:
    wal = path.with_name(f"{path.name}-wal")
    # the log of a killed recorder is read too; without one, SQLite creates no files next to the bag
    mode: Literal["mode=ro", "immutable=1"] = "mode=ro" if wal.is_file() and wal.stat().st_size else "immutable=1"
    file = sqlite3.connect(f"file:{quote(str(path))}?{mode}", uri=True, check_same_thread=False)
    file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK)
    file.execute("PRAGMA trusted_schema = OFF")
    file.execute("PRAGMA cell_size_check = ON")
    file.execute("PRAGMA mmap_size = 0")
    return file


def _text(value: Any) -> str:
    if not isinstance(value, str) or len(value) > _LARGEST_TEXT:
        msg = f"a name or a definition is not text of up to {_LARGEST_TEXT} characters"
        raise ValueError(msg)
    return value


def _blob(value: Any) -> bytes:
    if not isinstance(value, bytes):
        msg = "a message is not a blob"
        raise TypeError(msg)
    return value
