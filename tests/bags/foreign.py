"""Bags like those of other programs, which lack hashes, definitions or metadata."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from mcap.writer import Writer

CDR = b"\0\1\0\0"
TIME = 1_700_000_000_000_000_000
_TOPICS = (
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
    " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
)
_MESSAGES = (
    "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
    " data BLOB NOT NULL)"
)


class Recorded(NamedTuple):
    """A topic of a bag with its messages; ``text`` is None for a type without a definition."""

    topic: str
    type_name: str
    text: str | None
    messages: Sequence[bytes]
    metadata: Mapping[str, str] = MappingProxyType({})


def foreign_mcap(path: Path, *topics: Recorded, encoding: str = "cdr") -> Path:
    """Write an MCAP file with definitions, but without metadata unless a topic has some."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("", "a test")
        for recorded in topics:
            kind = "" if recorded.text is None else "ros1msg" if encoding == "ros1" else "ros2msg"
            schema = writer.register_schema(recorded.type_name, kind, (recorded.text or "").encode())
            channel = writer.register_channel(recorded.topic, encoding, schema, dict(recorded.metadata))
            for number, data in enumerate(recorded.messages):
                writer.add_message(channel, TIME + number, data, TIME + number)
        writer.finish()
    return path


def humble_db3(path: Path, *topics: Recorded) -> Path:
    """Write an SQLite file like those of rosbag2 in Foxy and Humble, without definitions and hashes."""
    file = sqlite3.connect(path)
    with file:
        file.execute(_TOPICS)
        file.execute(_MESSAGES)
        for number, recorded in enumerate(topics, 1):
            assert recorded.text is None
            file.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (number, recorded.topic, recorded.type_name))
            rows = [(number, TIME + index, data) for index, data in enumerate(recorded.messages)]
            file.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    file.close()
    return path
