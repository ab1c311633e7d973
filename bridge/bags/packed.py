"""Files and messages that rosbag2 compressed with zstd (rosbag2_compression_zstd)."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import ExitStack
from pathlib import Path

from bridge.bags.bag import MAX_CHUNK, BagError, reading

ZSTD = b"\x28\xb5\x2f\xfd"
"""The first bytes of a zstd frame (RFC 8878); a message of CDR starts with a zero."""

ENDINGS = (".zstd", ".zst")

_OTHERS = {
    b"\x1f\x8b": "gunzip",
    b"BZh": "bunzip2",
    b"\xfd7zXZ\0": "unxz",
    b"\x04\x22\x4d\x18": "lz4 -d",
    b"PK\3\4": "unzip",
}

_MAX_UNPACK_RATIO = 200
"""The largest accepted ratio of the unpacked size of a file to its compressed size."""


def unpacked_file(file: Path, stack: ExitStack) -> Path:
    """Return the file itself, or the path of its unpacked copy in a temporary folder, which ``stack`` removes."""
    with file.open("rb") as source:
        if source.read(len(ZSTD)) != ZSTD:
            return file
    import zstandard

    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="midspan-bag-")))
    target = folder / (file.stem if file.name.endswith(ENDINGS) else file.name)
    room = min(file.stat().st_size * _MAX_UNPACK_RATIO + (1 << 20), shutil.disk_usage(folder).free * 9 // 10)
    with reading(file), file.open("rb") as packed, target.open("wb") as plain:
        reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
        while piece := reader.read(1 << 20):
            room -= len(piece)
            if room < 0:
                cure = f"unpack it with 'zstd -d', or set TMPDIR to a larger disk than that of {folder.parent}"
                problem = (
                    f"unpacks to more than {_MAX_UNPACK_RATIO} times its size, or to more than the disk has room for"
                )
                raise BagError(file, problem, None, cure)
            plain.write(piece)
    return target


def unpacked_message(data: bytes) -> bytes:
    """Return a ROS 2 message without its compression, if it has any; raises `ValueError` or ``zstandard.ZstdError``."""
    if not data.startswith(ZSTD):
        return data
    import zstandard

    declared = zstandard.frame_content_size(data)
    if declared > MAX_CHUNK:
        msg = f"a message declares {declared} bytes; the limit is {MAX_CHUNK}"
        raise ValueError(msg)
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=MAX_CHUNK if declared < 0 else declared)


def unpacker(start: bytes) -> str:
    """Return the program that unpacks a file with these first bytes; "" if they are not of a known archive."""
    return next((program for magic, program in _OTHERS.items() if start.startswith(magic)), "")
