"""Truncated, changed and malicious files: errors give a position, messages before it are read, memory is bounded."""

from __future__ import annotations

import bz2
import io
import random
import sqlite3
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from mcap.reader import make_reader

from bridge.bags.bag import BagError
from bridge.bags.copy import BagSelection, convert, cut
from bridge.bags.reader import open_bag
from bridge.messages.registry import Registry
from tests.bags.written import SECOND, START, db3_folder, mcap_bytes, mcap_file, ros1_bag

MEGABYTE = 1 << 20


def chunk(compression: bytes, data: bytes, size: int) -> bytes:
    """Return an MCAP file with one chunk that declares ``size`` uncompressed bytes."""
    body = struct.pack("<QQQII", 0, 9, size, 0, len(compression)) + compression + struct.pack("<Q", len(data)) + data
    header = struct.pack("<BQII", 1, 8, 0, 0)
    return b"\x89MCAP0\r\n" + header + struct.pack("<BQ", 6, len(body)) + body


def ros1_record(content: bytes, **fields: bytes) -> bytes:
    """Return one record of a ROS 1 bag."""
    built = [name.encode() + b"=" + value for name, value in fields.items()]
    head = b"".join(struct.pack("<I", len(field)) + field for field in built)
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(content)) + content


def ros1_chunk(compression: bytes, data: bytes, size: int) -> bytes:
    """Return a ROS 1 bag with one chunk that declares ``size`` uncompressed bytes."""
    start = ros1_record(b"", op=b"\x03", index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4))
    chunk = ros1_record(data, op=b"\x05", compression=compression, size=struct.pack("<I", size))
    return b"#ROSBAG V2.0\n" + start + chunk


ZEROS = bytes(64 * MEGABYTE)
UNSIZED = zstandard.ZstdCompressor(write_content_size=False)
BOMBS: dict[str, Callable[[], bytes]] = {
    "zstd that declares little": lambda: chunk(b"zstd", zstandard.compress(ZEROS), 1000),
    "zstd without its size": lambda: chunk(
        b"zstd", zstandard.ZstdCompressor(write_content_size=False).compress(ZEROS), 99
    ),
    "zstd of 4 GB": lambda: chunk(b"zstd", zstandard.compress(b"x"), 1 << 32),
    "zstd of 2^63 bytes": lambda: chunk(b"zstd", zstandard.compress(b"x"), 1 << 63),
    "lz4": lambda: chunk(b"lz4", lz4.frame.compress(ZEROS), 1000),
    "ROS 1, lz4": lambda: ros1_chunk(b"lz4", lz4.frame.compress(ZEROS), 1000),
    "ROS 1, bz2": lambda: ros1_chunk(b"bz2", bz2.compress(ZEROS), 1000),
    "ROS 1, 4 GB": lambda: ros1_chunk(b"none", b"", 0xFFFFFFFF),
    "unknown compression": lambda: chunk(b"odd", b"x", 1),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_chunk_with_a_wrong_unpacked_size_is_refused_before_it_is_unpacked(name: str, tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(BOMBS[name]())
    tracemalloc.start()
    try:
        with open_bag(path) as bag, pytest.raises(BagError, match=r", byte \d+: ") as caught:
            list(bag.messages())
        assert tracemalloc.get_traced_memory()[1] < 8 * MEGABYTE
    finally:
        tracemalloc.stop()
    assert caught.value.offset is not None


@pytest.mark.parametrize("length", [1 << 32, 1 << 62, (1 << 64) - 1])
@pytest.mark.parametrize("opcode", [3, 5, 6, 11, 0x80])
def test_a_record_that_is_longer_than_the_file_ends_what_can_be_read(opcode: int, length: int, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    good = mcap_bytes(20, finished=False)
    path.write_bytes(good + struct.pack("<BQ", opcode, length) + bytes(100))
    with open_bag(path) as bag:
        assert bag.unfinished
        assert bag.trouble is not None
        assert bag.trouble.offset == len(good)
        assert sum(1 for _ in bag.messages()) == 21


def test_a_header_of_ros_1_that_declares_4_gb_ends_what_can_be_read(tmp_path: Path) -> None:
    path = ros1_bag(tmp_path / "a.bag")
    good = path.stat().st_size
    with path.open("ab") as file:
        file.write(b"\xff\xff\xff\xff" + bytes(50))
    with open_bag(path) as bag:
        assert (bag.trouble is not None and bag.trouble.offset) == good
        assert sum(1 for _ in bag.messages()) == 21


START_BYTES = len(ros1_chunk(b"", b"", 0)) - len(ros1_record(b"", op=b"\x05", compression=b"", size=bytes(4)))
"""The number of bytes before the first chunk of a ROS 1 bag."""

OP, TIME = b"\x02", struct.pack("<II", 5, 6)
CONNECTION = ros1_record(
    ros1_record(b"", topic=b"/a", type=b"std_msgs/String", md5sum=b"*", message_definition=b"string data\n")[4:-4],
    op=b"\x07", conn=bytes(4), topic=b"/a",
)  # fmt: skip
TEXT = ros1_record(b"\1\0\0\0a", op=OP, conn=bytes(4), time=TIME)
ENDS = {
    "within a length": TEXT[:3],
    "within a head": TEXT[:20],
    "before the data's length": TEXT[:42],
    "within the data": TEXT[:-1],
    "data of 4 GB": TEXT[:42] + b"\xff\xff\xff\xff" + bytes(9),
    "a head of 4 GB": b"\xff\xff\xff\xff" + TEXT[4:],
    "a connection that is not there": ros1_record(b"", op=OP, conn=b"\x09\0\0\0", time=TIME),
    "no connection": ros1_record(b"", op=OP, time=TIME),
    "a short connection": ros1_record(b"", op=OP, conn=b"\0\0", time=TIME + b"\0\0"),
    "a short time": ros1_record(b"", op=OP, conn=bytes(8), time=TIME[:4]),
    "no kind": ros1_record(b"", conn=bytes(4), time=TIME),
    "an empty kind": ros1_record(b"", op=b"", conn=bytes(4), time=TIME + b"\0"),
    "a field without a name": TEXT.replace(b"time=", b"time-"),
}


@pytest.mark.parametrize("compression", ["none", "lz4", "bz2"])
@pytest.mark.parametrize("end", ENDS)
def test_an_invalid_header_after_valid_ones_is_reported_with_its_chunk(
    end: str, compression: str, tmp_path: Path
) -> None:
    plain = CONNECTION + 2 * TEXT + ENDS[end]
    packed = {"none": bytes, "lz4": lz4.frame.compress, "bz2": bz2.compress}[compression](plain)
    whole = ros1_chunk(b"none", CONNECTION + 2 * TEXT, len(CONNECTION + 2 * TEXT))
    path = tmp_path / "a.bag"
    path.write_bytes(whole + ros1_chunk(compression.encode(), packed, len(plain))[START_BYTES:])
    damage: list[BagError] = []
    with open_bag(path) as bag:
        with pytest.raises(BagError):
            list(bag.messages())
        bag.skip_damage(damage.append)
        assert [(m.topic.name, m.time_ns, m.data) for m in bag.messages()] == 4 * [("/a", 5_000_000_006, TEXT[-5:])]
    assert [err.offset for err in damage] == [len(whole)]


def text(number: int, size: int = 9) -> bytes:
    """Return the record of a message whose time in seconds is ``number``."""
    data = struct.pack("<I", size) + random.Random(number).randbytes(size // 2).hex().encode().ljust(size)
    return ros1_record(data, op=OP, conn=bytes(4), time=struct.pack("<II", number, 0))


def repaired(path: Path, content: bytes) -> tuple[list[int], list[int | None]]:
    """Repair a ROS 1 bag without an index; return the times of its messages in seconds, and the positions of damage."""
    path.write_bytes(content)
    with open_bag(path) as bag:
        done = cut(bag, path.with_name("mended.bag"), mend=True)
    with open_bag(path.with_name("mended.bag")) as bag:
        messages = [(m.time_ns // 1_000_000_000, m.data) for m in bag.messages()]
    assert all(text(number, len(data) - 4).endswith(data) for number, data in messages)
    return [number for number, _ in messages], [err.offset for err in done.damage]


TEXTS = [text(number) for number in range(5)]
BROKEN = {
    "a head": (TEXTS[2].replace(b"conn=", b"c0nn="), [0, 1, 3, 4]),
    "a head's length": (b"\x36" + TEXTS[2][1:], [0, 1, 3, 4]),
    "a length beyond the chunk": (TEXTS[2][:44] + b"\x7f" + TEXTS[2][45:], [0, 1, 3, 4]),
    "a length that reaches into the next": (TEXTS[2][:42] + b"\x1f" + TEXTS[2][43:], [0, 1, 3, 4]),
    "all of it": (bytes(len(TEXTS[2])), [0, 1, 3, 4]),
    "a connection": (TEXTS[2].replace(b"conn=\0", b"conn=\7"), [0, 1, 3, 4]),
}


@pytest.mark.parametrize("what", BROKEN)
def test_the_other_messages_of_a_damaged_ros1_chunk_are_saved(what: str, tmp_path: Path) -> None:
    record, expected = BROKEN[what]
    plain = b"".join([CONNECTION, *TEXTS[:2], record, *TEXTS[3:]])
    start = ros1_chunk(b"none", b"", 0)
    salvaged = repaired(tmp_path / "a.bag", start + ros1_chunk(b"none", plain, len(plain))[START_BYTES:])
    assert salvaged == (expected, [salvaged[1][0], len(start)])  # the missing index is reported first


def broken_bz2(plain: bytes) -> bytes:
    """Return bz2 data that is damaged within one of its 100 kB blocks."""
    packed = bytearray(bz2.compress(plain, 1))
    packed[len(packed) * 3 // 4] ^= 0xFF
    return bytes(packed)


def broken_lz4(plain: bytes) -> bytes:
    """Return lz4 data with a block of an impossible length."""
    packed, at = bytearray(lz4.frame.compress(plain)), 15
    while at < len(packed) * 3 // 5:
        at += 4 + int.from_bytes(packed[at : at + 4], "little")
    packed[at : at + 4] = b"\xff\xff\xff\x7f"
    return bytes(packed)


@pytest.mark.parametrize(("compression", "broken"), [("bz2", broken_bz2), ("lz4", broken_lz4)])
def test_messages_before_the_damage_of_a_compressed_ros1_chunk_are_saved(
    compression: str, broken: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    plain = CONNECTION + b"".join(text(number, 2500) for number in range(80))
    numbers, damage = repaired(tmp_path / "a.bag", ros1_chunk(compression.encode(), broken(plain), len(plain)))
    assert numbers == list(range(len(numbers)))
    assert 20 < len(numbers) < 65
    assert START_BYTES in damage


def test_a_chunk_that_was_never_closed_is_read_to_the_files_end(tmp_path: Path) -> None:
    closed = ros1_chunk(b"none", CONNECTION + TEXTS[0], len(CONNECTION + TEXTS[0]))
    whole = closed + ros1_chunk(b"none", b"", 0)[START_BYTES:] + b"".join(TEXTS[1:])
    assert repaired(tmp_path / "a.bag", whole[:-3]) == ([0, 1, 2, 3], [len(whole) - len(TEXTS[4])])


@pytest.mark.parametrize(("compression", "pack"), [("none", bytes), ("lz4", lz4.frame.compress)])
def test_a_chunk_truncated_with_the_file_is_read_up_to_its_end(
    compression: str, pack: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    plain = CONNECTION + b"".join(text(number, 20_000) for number in range(20))
    whole = ros1_chunk(compression.encode(), pack(plain), len(plain))
    path = tmp_path / "a.bag"
    numbers, damage = repaired(path, whole[: len(whole) * 3 // 4])
    assert numbers == list(range(len(numbers)))
    assert 9 < len(numbers) < 16
    assert damage == [START_BYTES]
    with open_bag(path) as bag:
        assert bag.unfinished
        assert sum(1 for _ in bag.messages()) == bag.topics[0].count == len(numbers)


def test_a_chunk_that_cannot_be_read_or_has_no_message_does_not_begin_the_bag_in_1970(tmp_path: Path) -> None:
    plain = CONNECTION + TEXTS[3]
    chunks = [ros1_chunk(b"none", plain, len(plain)), ros1_chunk(b"lz4", b"no lz4", 99)[START_BYTES:]]
    (tmp_path / "a.bag").write_bytes(b"".join(chunks))
    mcap = mcap_bytes(3, finished=False)
    (tmp_path / "b.mcap").write_bytes(mcap + chunk(b"", b"", 0)[-40 - 9 :].replace(struct.pack("<Q", 9), bytes(8), 1))
    for name, start, end in (("a.bag", 3 * SECOND, 3 * SECOND), ("b.mcap", START, START + 2 * SECOND // 10)):
        with open_bag(tmp_path / name) as bag:
            assert (bag.start_ns, bag.end_ns) == (start, end)


def test_messages_without_any_connection_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(ros1_chunk(b"none", 2 * TEXT, 2 * len(TEXT)))
    with open_bag(path) as bag, pytest.raises(BagError, match="connection 0, which is missing in the bag"):
        list(bag.messages())
    assert bag.topics == ()


@pytest.mark.parametrize("form", ["bag", "mcap"])
def test_a_chunk_that_is_too_large_is_not_read(form: str, tmp_path: Path) -> None:
    path = tmp_path / "a"
    size = 300 * MEGABYTE
    if form == "bag":
        data = ros1_chunk(b"none", b"", 10)
        path.write_bytes(data[:-4] + struct.pack("<I", size))
    else:
        data = chunk(b"", b"", 10)
        at = data.index(struct.pack("<BQ", 6, 40))
        path.write_bytes(data[: at + 1] + struct.pack("<Q", 40 + size) + data[at + 9 : -8] + struct.pack("<Q", size))
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size + size)  # a sparse file, which needs no disk space
    tracemalloc.start()
    try:
        with open_bag(path) as bag, pytest.raises(BagError, match=r", byte \d+: .*limit") as caught:
            list(bag.messages())
        assert tracemalloc.get_traced_memory()[1] < 8 * MEGABYTE
    finally:
        tracemalloc.stop()
    assert caught.value.offset is not None


@pytest.mark.parametrize("form", ["bag", "mcap"])
def test_a_chunk_of_tiny_messages_takes_little_more_than_their_rows(form: str, tmp_path: Path) -> None:
    size = 8 * MEGABYTE
    if form == "bag":
        plain = CONNECTION + TEXT * (size // len(TEXT))
        content = ros1_chunk(b"none", plain, len(plain))
    else:
        message = struct.pack("<BQHIQQ", 5, 22, 1, 0, 5, 5)
        channel = struct.pack("<BQHHI2sI3sI", 4, 21, 1, 0, 2, b"/a", 3, b"cdr", 0)
        plain = channel + message * (size // len(message))
        content = chunk(b"zstd", zstandard.compress(plain), len(plain))
    path = tmp_path / f"a.{form}"
    path.write_bytes(content)
    del plain, content
    tracemalloc.start()
    try:
        with open_bag(path) as bag:
            assert sum(len(some.data) for some in bag.columns()) == bag.topics[0].count > 150_000
        assert tracemalloc.get_traced_memory()[1] < 3 * size + 8 * MEGABYTE
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("part", [0.2, 0.5, 0.9])
def test_a_file_of_sqlite_that_was_cut_is_an_error(part: float, tmp_path: Path) -> None:
    file = db3_folder(tmp_path / "a", 2000) / "a.db3"
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(BagError, match=r"a\.db3: is damaged: DatabaseError"), open_bag(file) as bag:
        list(bag.messages())


def test_a_database_that_is_not_a_bag_or_computes_endlessly_is_an_error(tmp_path: Path) -> None:
    other = sqlite3.connect(tmp_path / "other.db3")
    other.execute("CREATE TABLE things(id)")
    other.commit()
    other.close()
    with pytest.raises(BagError, match="is not a bag: tables 'topics' and 'messages' are missing"):
        open_bag(tmp_path / "other.db3")
    endless = sqlite3.connect(tmp_path / "endless.db3")
    endless.execute("CREATE TABLE messages(id, topic_id, timestamp, data)")
    endless.execute(
        "CREATE VIEW topics AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id FROM n"
    )
    endless.commit()
    endless.close()
    with pytest.raises(BagError, match="is not a bag"):
        open_bag(tmp_path / "endless.db3")


def test_a_folder_reads_nothing_outside_of_itself(tmp_path: Path) -> None:
    mcap_file(tmp_path / "secret.mcap")
    folder = tmp_path / "bag"
    folder.mkdir()
    text = "rosbag2_bagfile_information:\n  relative_file_paths: [../secret.mcap]\n  compression_mode: ''\n"
    (folder / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match=r"bag/secret\.mcap: file not found"):
        open_bag(folder)
    (folder / "metadata.yaml").write_text("a: [b")
    with pytest.raises(BagError, match=r"metadata\.yaml: is damaged: \w+Error"):
        open_bag(folder)


def test_an_unreadable_definition_is_an_error_that_names_the_type(tmp_path: Path) -> None:
    data = mcap_bytes(3, "none").replace(b"std_msgs/msg/String", b"odd_msgs/msg/Strong")
    data = data.replace(b"string data", b"stronk data")
    path = tmp_path / "a.mcap"
    path.write_bytes(crc_of_nobody(data))
    with open_bag(path) as bag, pytest.raises(BagError, match=r"/map_name has type odd_msgs/msg/Strong"):
        convert(bag, tmp_path / "b.bag", "bag", Registry())


def crc_of_nobody(data: bytes) -> bytes:
    """Return the file without the checksums of its chunks."""
    built, at = bytearray(data), 8
    while at < len(built) - 8:
        opcode, length = struct.unpack_from("<BQ", built, at)
        if opcode == 6:
            built[at + 33 : at + 37] = bytes(4)
        at += 9 + length
    return bytes(built)


def test_a_damaged_table_stops_a_conversion_and_not_a_mending(tmp_path: Path) -> None:
    data = bytearray(mcap_bytes(100))
    at = 8
    while data[at] != 11:  # 11 is the Statistics record
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    data[at + 9 + 42 : at + 9 + 46] = b"\xff\xff\xff\xff"
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    with open_bag(path) as bag:
        assert bag.trouble is not None
        assert bag.trouble.offset == at
        with pytest.raises(BagError, match="'midspan bag mend' saves the rest"):
            convert(bag, tmp_path / "b.db3", "db3", Registry())
        assert cut(bag, tmp_path / "b.mcap", mend=True).messages == 101


def test_chunks_that_are_cut_out_whole_keep_their_index(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "a.mcap", 200)
    start, end = START + 3_000_000_000, START + 15_000_000_000
    with open_bag(path) as bag:
        done = cut(bag, tmp_path / "b.mcap", BagSelection(start_ns=start, end_ns=end))
    expected = [(channel.topic, m.log_time, m.data) for _, channel, m in messages(path) if start <= m.log_time < end]
    with (tmp_path / "b.mcap").open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(expected) == done.messages == 120
    assert len(summary.chunk_indexes) > 5
    assert [(channel.topic, m.log_time, m.data) for _, channel, m in messages(tmp_path / "b.mcap")] == expected


def messages(path: Path) -> list[Any]:
    """Return all messages that the library finds by the index, in order of time."""
    return list(make_reader(io.BytesIO(path.read_bytes()), validate_crcs=True).iter_messages())
