"""Opens a bag of any format: MCAP, rosbag2's folder or SQLite file, ROS 1's ``.bag``."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from bridge.bags.bag import Bag, BagError, BagMessage, BagTopic, reading
from bridge.bags.packed import ZSTD, unpacker

__all__ = ["Bag", "BagError", "BagMessage", "BagTopic", "open_bag"]


def open_bag(path: Path) -> Bag:
    """Open a bag in the format of its content, whatever its name; raises `BagError`."""
    with reading(path):
        if path.is_dir():
            from bridge.bags.folder import FolderBag

            return FolderBag(path, _open_file)
        with path.open("rb") as file:
            packed = file.read(len(ZSTD)) == ZSTD
        if packed:
            from bridge.bags.folder import FilesBag

            return FilesBag(path, [path], _open_file)
        return _open_file(path)


def _open_file(path: Path) -> Bag:
    with reading(path):
        file = path.open("rb")
    try:
        with reading(path, 0):
            return _open_content(path, file)
    except BaseException:
        file.close()
        raise


def _open_content(path: Path, file: BinaryIO) -> Bag:
    start = file.read(16)
    if start.startswith(b"\x89MCAP"):
        from bridge.bags.mcap_reader import MAGIC, McapBag

        if not start.startswith(MAGIC):
            raise BagError(path, f"MCAP of an unknown version ({start[5:8]!r})", 5)
        return McapBag(path, file)
    if start.startswith(b"#ROSBAG V"):
        from bridge.bags.ros1_reader import MAGIC as ROS1
        from bridge.bags.ros1_reader import Ros1Bag

        if not start.startswith(ROS1):
            raise BagError(path, "a bag of a version other than 2.0", 8, "upgrade it with 'rosbag fix'")
        return Ros1Bag(path, file)
    if start == b"SQLite format 3\0":
        from bridge.bags.db3_reader import Db3Bag

        file.close()
        return Db3Bag(path)
    if not start:
        raise BagError(path, "is empty", None, "its recorder was killed before it wrote anything")
    program = unpacker(start)
    cure = f"it is compressed: unpack it with '{program}' first" if program else ""
    raise BagError(path, "is neither an MCAP file nor a bag of ROS 1 or ROS 2", 0, cure)
