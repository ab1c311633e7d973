"""The kernel that finds messages, compiled and as Python, and the processing of whole chunks of messages."""

from __future__ import annotations

import io
import random
import struct
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from mcap.records import Chunk, MessageIndex
from mcap.stream_reader import StreamReader
from rosbags.rosbag1 import Writer

from bridge.bags import split
from bridge.bags.copy import convert
from bridge.bags.reader import open_bag
from bridge.messages.registry import Registry
from tests.bags.written import ROS1, START, STRING
from tests.support.uncompiled import uncompiled

MCAP = struct.pack("<BQHIQQ", 5, 24, 3, 0, 1 << 63, 7) + b"hi"
ROS1_HEADS = [b"\4\0\0\0op=\2", b"\x09\0\0\0conn=\7\0\0\0", b"\x0d\0\0\0time=\5\0\0\0\6\0\0\0"]
ROS1_TEXT = b"\x26\0\0\0" + b"".join(ROS1_HEADS) + b"\5\0\0\0\1\0\0\0a"
FORMS = [split, uncompiled("bridge.bags.split")]


def rows_(form: Any, case_: str, data: bytes) -> tuple[int, list[list[int]]]:
    """Return the position where one form of the kernel stops, and the kernel's table."""
    table = form.new_table(len(data))
    at, filled = getattr(form, case_)(data, table, 0, 0)
    return at, table[:filled].tolist()


def test_messages_are_found_at_their_positions() -> None:
    for form in FORMS:
        assert rows_(form, "split_mcap", 2 * MCAP + b"\4") == (
            66, [[3, 1 << 63, 7, 31, 2], [3, 1 << 63, 7, 64, 2]],
        )  # fmt: skip
        assert rows_(form, "split_ros1", 2 * ROS1_TEXT) == (
            102, [[7, 5_000_000_006, 5_000_000_006, 46, 5], [7, 5_000_000_006, 5_000_000_006, 97, 5]],
        )  # fmt: skip


@pytest.mark.parametrize(("case_", "record"), [("split_mcap", MCAP), ("split_ros1", ROS1_TEXT)], ids=["mcap", "ros1"])
def test_compiled_and_python_forms_agree_on_damaged_chunks(case_: str, record: bytes) -> None:
    dice = random.Random(5)
    ends = set()
    for _ in range(300):
        data = bytearray(3 * record)
        data[dice.randrange(len(data))] = dice.choice((0, 1, 4, 13, 0x7F, 0xFF, dice.randrange(256)))
        whole = bytes(data[: dice.randrange(len(record), len(data) + 1)])
        outcomes = [rows_(form, case_, whole) for form in FORMS]
        assert outcomes[0] == outcomes[1]
        ends.add(outcomes[0][0])
    assert len(ends) > 3


def mixed_bag(path: Path) -> dict[tuple[int, int], bytes]:
    """Write a bag of three topics whose times are in order neither within chunks nor across them; return its texts."""
    dice, written = random.Random(3), dict[tuple[int, int], bytes]()
    writer = Writer(path)
    writer.chunk_threshold = 300_000
    with writer:
        connections = [writer.add_connection(f"/{n}", STRING, typestore=ROS1) for n in range(3)]
        for number in range(1500):
            which, time = dice.randrange(3), START + (number + dice.randrange(200)) * 10_000 + number
            text = dice.randbytes(dice.choice((0, 9, 3000))).hex().encode()
            writer.write(connections[which], time, struct.pack("<I", len(text)) + text)
            written[which, time] = text
    return written


def test_chunks_and_indexes_are_those_of_one_message_after_the_other(tmp_path: Path) -> None:
    written = mixed_bag(tmp_path / "a.bag")
    with open_bag(tmp_path / "a.bag") as bag:
        convert(bag, tmp_path / "b.mcap", "mcap", Registry(), compression="none")
    data = (tmp_path / "b.mcap").read_bytes()
    records = StreamReader(io.BytesIO(data), emit_chunks=True).records
    texts = sorted((time, which, text) for (which, time), text in written.items())
    chunks, indexes = [], list[list[MessageIndex]]()
    for record in records:
        if isinstance(record, Chunk):
            chunks.append(record)
            indexes.append([])
        elif isinstance(record, MessageIndex):
            indexes[-1].append(record)
    expected, at = bytearray(), 0
    for chunk, index in zip(chunks, indexes, strict=True):
        entries: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        expected.clear()
        first = at
        while at < len(texts) and len(expected) <= 1 << 20:
            time, which, text = texts[at]
            cdr = b"\0\1\0\0" + struct.pack("<I", len(text) + 1) + text + b"\0"
            entries[which].append((time, len(expected)))
            expected += struct.pack("<BQHIQQ", 5, 22 + len(cdr), which, 0, time, time) + cdr
            at += 1
        assert chunk.data == expected
        assert (chunk.message_start_time, chunk.message_end_time) == (texts[first][0], texts[at - 1][0])
        assert [(chunk_.channel_id, chunk_.records) for chunk_ in index] == list(entries.items())
    assert (at, len(chunks)) == (len(texts), 3)
