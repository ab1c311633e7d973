"""Bags of all formats."""

from __future__ import annotations

import io

from bridge.bags.bag import BagError
from tests.fuzz.target import Subject, Target, scratch, texts

_LARGEST_CHUNK = 8 << 20
"""Limit of a chunk's unpacked size, reached before the memory limit."""


def _bags() -> Subject:
    """A bag of any format: it is read, its types are converted, and its repair (except db3) keeps all read messages."""
    from bridge.bags import bag as limits
    from bridge.bags import db3_reader, spans
    from bridge.bags.conversion import to_hub
    from bridge.bags.copy import cut
    from bridge.bags.reader import open_bag
    from bridge.messages.registry import Registry

    for module in (limits, spans, db3_reader):
        vars(module)["MAX_CHUNK"] = _LARGEST_CHUNK
    folder = scratch()
    file, registry = folder / "any", Registry()

    def parse(data: bytes) -> None:
        file.write_bytes(data)
        with open_bag(file) as bag:
            read, whole = 0, False
            try:
                read = sum(1 for _ in bag.messages())
                whole = True
                for topic in bag.topics[:3]:
                    to_hub(registry, topic)
            except BagError:
                pass
            if bag.kind != "db3":  # writing SQLite files is too slow
                mended = folder / f"mended.{bag.kind}"
                mended.unlink(missing_ok=True)
                saved = cut(bag, mended, mend=True).messages
                # messages of other encodings are copied, but not read
                assert saved == read if whole and not bag.left_out else saved >= read

    tokens = texts(
        "cdr", "ros1", "ros2msg", "zstd", "lz4", "bz2", "none", "op=", "conn=", "time=", "topic=", "index_pos=",
        "chunk_pos=", "encryptor=x", "CREATE TABLE messages(id INTEGER PRIMARY KEY)", "- history: 3\n",
    )  # fmt: skip
    tokens += [b"\x05" + b"\x20" + b"\0" * 7, b"\xff" * 8, b"\x06", b"\x89MCAP0\r\n", b"\x28\xb5\x2f\xfd"]
    return Subject(parse, _seeds(), (BagError,), tokens, largest=1 << 15)


def _seeds() -> list[bytes]:
    from tests.bags.written import db3_folder, mcap_bytes, ros1_bag

    folder = scratch()
    bags = [ros1_bag(folder / f"{how}.bag", 3, how).read_bytes() for how in ("none", "lz4", "bz2")]
    bags += [mcap_bytes(3, "zstd"), mcap_bytes(3, "lz4"), mcap_bytes(3, "none"), mcap_bytes(3, "none", finished=False)]
    return [*bags, _unchunked(), (db3_folder(folder / "run", 3) / "run.db3").read_bytes()]


def _unchunked() -> bytes:
    """Return an MCAP file of ROS 1's profile with messages outside chunks."""
    from mcap.writer import Writer

    stream = io.BytesIO()
    writer = Writer(stream, use_chunking=False)
    writer.start("ros1", "test")
    schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
    channel = writer.register_channel("/a", "ros1", schema, {"latching": "1"})
    for time in range(3):
        writer.add_message(channel, time, b"\x01\0\0\0a", time)
    writer.finish()
    return stream.getvalue()


TARGETS = (Target("bags", 4_000, _bags),)
