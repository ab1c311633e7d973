"""Folders of rosbag2: ``metadata.yaml`` and one file or several, of MCAP or SQLite, compressed or not."""

from __future__ import annotations

import heapq
import shutil
import tempfile
from collections import deque
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from bridge.bags.bag import MAX_CHUNK, Bag, BagError, BagMessage, BagTopic, reading
from bridge.bags.qos import load_yaml

METADATA = "metadata.yaml"
_LARGEST_METADATA = 4 << 20
_PACKED = (".zstd", ".zst")
_ZSTD = b"\x28\xb5\x2f\xfd"
"""So begins a message that is compressed by itself, which only the metadata tell; CDR begins with 0."""

_MOST_PACKED = 200
"""How many times larger than its compressed file a file of a folder may be."""


class FolderBag(Bag):
    """A folder of rosbag2; topics that several of its files have are one. What cannot be opened is its `trouble`.

    Args:
        open_file: opens one file.
    """

    _on_damage: Callable[[BagError], None] | None = None

    def __init__(self, path: Path, open_file: Callable[[Path], Bag]) -> None:
        super().__init__(path)
        self._broken: list[BagError] = []
        try:
            metadata = _metadata(path)
        except BagError as err:
            metadata = {}
            self._broken.append(err)
        with reading(path):
            files = _files(path, metadata)
        if not files:
            raise next(iter(self._broken), BagError(path, f"is no bag: it has no {METADATA}, no .mcap and no .db3"))
        self.unfinished = not metadata
        self._packed = str(metadata.get("compression_mode", "")).lower() == "message"
        self._parts: list[Bag] = []
        with ExitStack() as stack:
            for file in files:
                try:
                    self._parts.append(stack.enter_context(open_file(_unpacked(file, stack))))
                    self.size += file.stat().st_size
                except BagError as err:
                    cure = err.cure or "'midspan bag mend' saves the other files"
                    self._broken.append(BagError(file, err.what, err.offset, cure))
            if not self._parts:
                raise self._broken[-1]
            self._stack = stack.pop_all()
        self._parts.sort(key=lambda part: part.start_ns)
        self._topic_of: dict[BagTopic, BagTopic] = {}
        self._join()
        self.kind = self._parts[0].kind
        troubles = [part.trouble for part in self._parts if part.trouble is not None]
        damage = [*self._broken, *(part.trouble for part in self._parts if part.trouble and not part.unfinished)]
        self.trouble = next(iter([*damage, *troubles]), None)
        self.unfinished = not damage and (self.unfinished or any(part.unfinished for part in self._parts))
        told = {part.compression for part in self._parts}
        packed = self._packed or any(file.name.endswith(_PACKED) for file in files)
        self.compression = "zstd" if packed else ",".join(sorted(told))
        more = (f"{err.path.name} ({err.what})" for err in self._broken[1:])
        self.left_out = (*dict.fromkeys(name for part in self._parts for name in part.left_out), *more)

    def _join(self) -> None:
        joined: dict[tuple[Any, ...], list[BagTopic]] = {}
        for topic in (topic for part in self._parts for topic in part.topics):
            key = (topic.name, topic.type_name, topic.world, topic.definition, topic.type_hash, topic.profiles)
            joined.setdefault((*key, *sorted(topic.metadata.items())), []).append(topic)
        for same in joined.values():
            one = replace(same[0], count=sum(topic.count for topic in same))
            self._topic_of.update(dict.fromkeys(same, one))
        self.topics = tuple(dict.fromkeys(self._topic_of.values()))
        times = [part for part in self._parts if any(topic.count for topic in part.topics)]
        self.start_ns = min((part.start_ns for part in times), default=0)
        self.end_ns = max((part.end_ns for part in times), default=0)

    def messages(
        self, topics: Collection[BagTopic] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """See `Bag.messages`; a file is read from the time on at which it begins. Raises for a lost file at the end."""
        wanted = None if topics is None else set(topics)
        later = deque(self._parts)
        heads: list[tuple[int, int, BagMessage, Iterator[BagMessage]]] = []
        while later or heads:
            while later and (not heads or later[0].start_ns <= heads[0][0]):
                messages = self._of(later.popleft(), wanted, start_ns, end_ns)
                if (first := next(messages, None)) is not None:
                    heapq.heappush(heads, (first.time_ns, -len(later), first, messages))
            if not heads:
                continue
            _, number, message, messages = heads[0]
            yield message
            if (following := next(messages, None)) is None:
                heapq.heappop(heads)
            else:
                heapq.heapreplace(heads, (following.time_ns, number, following, messages))
        if self._broken and self._on_damage is None:
            raise self._broken[0]

    def _of(
        self, part: Bag, wanted: set[BagTopic] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[BagMessage]:
        try:
            yield from self._read(part, wanted, start_ns, end_ns)
        except BagError as err:
            if self._on_damage is None:
                raise
            self._on_damage(err)

    def _read(
        self, part: Bag, wanted: set[BagTopic] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[BagMessage]:
        mine = None if wanted is None else [topic for topic in part.topics if self._topic_of[topic] in wanted]
        for message in part.messages(mine, start_ns, end_ns):
            data = message.data
            if self._packed or data.startswith(_ZSTD):
                with reading(part.path):
                    data = _unzstd(data)
            yield message._replace(topic=self._topic_of[message.topic], data=data)

    def skip_damage(self, told: Callable[[BagError], None]) -> None:
        """See `Bag.skip_damage`: of a file that cannot skip anything, the rest is left out."""
        self._on_damage = told
        for err in self._broken:
            told(err)
        for part in self._parts:
            part.skip_damage(told)

    def close(self) -> None:
        """See `Bag.close`."""
        self._stack.close()


def _metadata(path: Path) -> dict[str, Any]:
    """What the folder's file says; nothing where it has none, as that of a recorder that was killed."""
    file = path / METADATA
    if not file.is_file():
        return {}
    if file.stat().st_size > _LARGEST_METADATA:
        raise BagError(file, f"is larger than {_LARGEST_METADATA} bytes")
    with reading(file):
        found = load_yaml(file.read_text(encoding="utf-8"))
        told = found["rosbag2_bagfile_information"]
        if not isinstance(told, dict):
            raise TypeError("rosbag2_bagfile_information is no mapping")
        return told


def _files(path: Path, metadata: dict[str, Any]) -> list[Path]:
    listed = metadata.get("relative_file_paths")
    if isinstance(listed, list) and listed:
        files = [path / Path(str(name)).name for name in listed]  # nothing outside of the folder
    else:
        ends = (".mcap", ".db3", *(f"{kind}{end}" for kind in (".mcap", ".db3") for end in _PACKED))
        files = sorted(file for file in path.iterdir() if file.name.endswith(ends))
    return files


def _unpacked(file: Path, stack: ExitStack) -> Path:
    """The file itself, or for a compressed one what it holds, in a temporary folder that goes with the bag."""
    if not file.name.endswith(_PACKED):
        return file
    import zstandard

    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="midspan-bag-")))
    target = folder / file.name.rpartition(".")[0]
    room = min(file.stat().st_size * _MOST_PACKED + (1 << 20), shutil.disk_usage(folder).free * 9 // 10)
    with reading(file), file.open("rb") as packed, target.open("wb") as plain:
        source = zstandard.ZstdDecompressor().stream_reader(packed)
        while piece := source.read(1 << 20):
            room -= len(piece)
            if room < 0:
                cure = f"unpack it by hand with 'zstd -d', or give TMPDIR a larger disk than that of {folder.parent}"
                what = f"unpacks to more than {_MOST_PACKED} times its size, or than the disk"
                raise BagError(file, what, None, cure)
            plain.write(piece)
    return target


def _unzstd(data: bytes) -> bytes:
    import zstandard

    told = zstandard.frame_content_size(data)
    if told > MAX_CHUNK:
        msg = f"a message declares {told} bytes, which is more than the {MAX_CHUNK} that are read"
        raise ValueError(msg)
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=MAX_CHUNK if told < 0 else told)
