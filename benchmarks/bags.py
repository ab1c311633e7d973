"""The cost of converting and cutting large bags, compared with copying the same bytes or compressing them with zstd.

Each row is one bag of ``--megabytes`` whose messages are images of 1 MB (half of each noise), or texts of 1 kB. "Ours"
are the functions of ``midspan bag`` in a separate process; the peer's work runs in another process:

- disk: the source's bytes are copied to a new file in pieces of 1 MB;
- zstd: the source's data are compressed in pieces of 1 MB and written, after unpacking if the source is compressed.

The time is from the start of the process's work (the interpreter has started) until its file is on the disk.

The last rows are the peak memory of Midspan's processes in MiB, compared with a limit of 400.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from bridge.bags.bag import BagTopic
from bridge.bags.conversion import TopicForm
from bridge.bags.mcap_copy import Ros2Mcap
from bridge.bags.writers import open_writer
from bridge.messages.definitions.schema import World
from bridge.messages.definitions.text import full_text
from bridge.messages.registry import Registry

MB = 1_000_000
PIECE = 1 << 20
MEMORY_MB = 400.0
CASES: dict[str, tuple[str, str, str]] = {
    "cut images, mcap": ("images-none.mcap", "out.mcap", "disk"),
    "cut images, mcap zstd": ("images-zstd.mcap", "out.mcap", "zstd"),
    "convert images, bag to mcap zstd": ("images.bag", "out.mcap", "zstd"),
    "convert images, mcap to bag": ("images-none.mcap", "out.bag", "disk"),
    "convert images, mcap to db3": ("images-none.mcap", "out.db3", "disk"),
    "convert texts of 1 kB, bag to mcap zstd": ("texts.bag", "out.mcap", "zstd"),
    "cut texts of 1 kB, mcap zstd": ("texts-zstd.mcap", "out.mcap", "zstd"),
}
"""Source, target and peer of each row."""


def messages(kind: str, registry: Registry) -> tuple[str, list[bytes]]:
    """Return a type, and some of its messages as CDR."""
    from bridge.messages.json import from_json

    dice = random.Random(kind)
    if kind == "texts":
        texts = [base64.b64encode(dice.randbytes(500)).decode() + "." * 330 for _ in range(3000)]
        return "std_msgs/msg/String", [from_json(registry, "std_msgs/msg/String", {"data": text}) for text in texts]
    contents = []
    for _ in range(10):
        pixels = b"".join(dice.randbytes(500) + bytes(500) for _ in range(1000))
        value = {"height": 1000, "width": 1000, "encoding": "mono8", "step": 1000}
        value["data"] = base64.b64encode(pixels).decode()
        contents.append(from_json(registry, "sensor_msgs/msg/Image", value))
    return "sensor_msgs/msg/Image", contents


def write_source(path: Path, megabytes: int) -> None:
    """Write a bag of messages at 100 Hz."""
    registry = Registry()
    type_name, contents = messages("texts" if path.name.startswith("texts") else "images", registry)
    kind = "bag" if path.suffix == ".bag" else "mcap"
    world = World.ROS2
    form = TopicForm(type_name, registry.ros2(type_name).type_id, full_text(registry.schema(type_name)), None)
    if kind == "bag":
        conversion = registry.hub_to_ros1(type_name)
        assert conversion.convert is not None
        contents = [conversion.convert(data) for data in contents]
        side = conversion.target
        form, world = TopicForm(side.name, side.type_id, side.definition, None), World.ROS1
    compression = "zstd" if "zstd" in path.name else "none"
    writer = open_writer(path, "bag", compression) if kind == "bag" else Ros2Mcap(path, compression)
    place = writer.add(BagTopic("/data", form.type_name, world), form)
    for number in range(megabytes * MB // len(contents[0])):
        at = [1_700_000_000_000_000_000 + number * 10_000_000]
        writer.write([place], at, at, [contents[number % len(contents)]])
    writer.finish()


def ours(source: Path, target: Path) -> None:
    """Convert or cut the whole bag."""
    from bridge.bags.copy import convert, cut
    from bridge.bags.reader import open_bag
    from bridge.bags.writers import kind_of

    with open_bag(source) as bag:
        if source.suffix == target.suffix:
            cut(bag, target)
        else:
            convert(bag, target, kind_of(target), Registry())


def disk(source: Path, target: Path) -> None:
    """Copy the bytes."""
    with source.open("rb") as read, target.open("wb") as write:
        while piece := read.read(PIECE):
            write.write(piece)


def zstd(source: Path, target: Path) -> None:
    """Compress only the data, after unpacking them if they are compressed."""
    import zstandard

    with target.open("wb") as write:
        for piece in _pieces(source):
            write.write(zstandard.compress(piece))


def _pieces(source: Path) -> Iterator[bytes]:
    import zstandard
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    with source.open("rb") as read:
        if "zstd" not in source.name:
            while piece := read.read(PIECE):
                yield piece
            return
        for record in StreamReader(read, emit_chunks=True).records:
            if isinstance(record, Chunk):
                yield zstandard.decompress(record.data, record.uncompressed_size)


WORK: dict[str, Callable[[Path, Path], None]] = {"ours": ours, "disk": disk, "zstd": zstd}


def work(what: str, source: Path, target: Path) -> None:
    """Run one process's work, and print the seconds and the peak memory in MiB."""
    begun = time.perf_counter()
    WORK[what](source, target)
    with target.open("rb") as file:
        os.fsync(file.fileno())
    duration = time.perf_counter() - begun
    print(json.dumps([duration, _peak()]))


def _peak() -> float:
    """Return this process's peak memory in MiB; `resource` would include its parent's peak."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    line = next(line for line in lines if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


def measure(what: str, source: Path, folder: Path, name: str) -> tuple[float, float]:
    """Return the seconds, and the peak memory in MiB, of a process that does the work once."""
    target = folder / name
    command = [sys.executable, __file__, "--work", what, str(source), str(target)]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    target.unlink()
    seconds, memory = json.loads(output)
    return seconds, memory


def _both(source: Path, target: str, peer: str, folder: Path) -> tuple[tuple[float, float], tuple[float, float]]:
    return measure("ours", source, folder, target), measure(peer, source, folder, target)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--megabytes", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "--cases", nargs="+", default=[""], metavar="WORD", help="only cases that contain one of these words"
    )
    parser.add_argument("--work", nargs=3, help=argparse.SUPPRESS)
    add_json_option(parser)
    args = parser.parse_args(arguments)
    if args.work:
        return work(args.work[0], Path(args.work[1]), Path(args.work[2]))
    rows: list[Row] = []
    memory: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="midspan-bags-") as folder:
        for case, (source_name, target, peer) in CASES.items():
            if not any(part in case for part in args.cases):
                continue
            source = Path(folder, source_name)
            if not source.exists():
                write_source(source, args.megabytes)
            our, other = zip(*(_both(source, target, peer, Path(folder)) for _ in range(args.rounds)), strict=True)
            mine, peers = (statistics.median(args.megabytes / seconds for seconds, _ in runs) for runs in (our, other))
            rows.append(Row(f"{case} ({peer})", mine, peers, "MB/s", "more"))
            memory.append(Row(f"memory: {case}", max(peak for _, peak in our), MEMORY_MB, "MB"))
    report([*rows, *memory], args.json)
    return None


if __name__ == "__main__":
    main()
