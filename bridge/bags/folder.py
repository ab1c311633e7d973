"""Bags of several files: folders of rosbag2 with ``metadata.yaml`` and MCAP or SQLite files, compressed or not."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from typing_extensions import override

from bridge.bags.bag import Bag, BagError, BagMessage, BagTopic, reading
from bridge.bags.packed import ENDINGS, unpacked_file
from bridge.bags.qos import load_yaml

METADATA = "metadata.yaml"
_LARGEST_METADATA = 4 << 20


class FilesBag(Bag):
    """Several files as one bag, which merges their equal topics; `trouble` is the error of the first damaged file.

    Args:
        files: the files, of any format, compressed or not.
        open_file: opens one uncompressed file.
        broken: errors that were found before, such as an error in the metadata file.
    """

    _on_damage: Callable[[BagError], None] | None = None

    def __init__(
        self, path: Path, files: Sequence[Path], open_file: Callable[[Path], Bag], broken: Sequence[BagError] = ()
    ) -> None:
        super().__init__(path)
        self._broken = list(broken)
        self._parts: list[Bag] = []
        packed = False
        with ExitStack() as stack:
            for file in files:
                try:
                    with reading(file):
                        plain = unpacked_file(file, stack)
                    part = stack.enter_context(open_file(plain))
                except BagError as err:
                    cure = err.cure or ("'midspan bag mend' saves the other files" if len(files) > 1 else "")
                    self._broken.append(BagError(file, err.what, err.offset, cure))
                    continue
                part.path = file  # errors name the compressed file
                if part.trouble is not None:
                    part.trouble = BagError(file, part.trouble.what, part.trouble.offset, part.trouble.cure)
                packed |= plain != file
                self._parts.append(part)
                self.size += file.stat().st_size
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
        self.unfinished = not damage and any(part.unfinished for part in self._parts)
        self.compression = "zstd" if packed else ",".join(sorted({part.compression for part in self._parts}))
        more = (f"{err.path.name} ({err.what})" for err in self._broken[1:])
        self._unread = tuple(dict.fromkeys(name for part in self._parts for name in part.left_out))
        self.left_out = (*self._unread, *more)

    def _join(self) -> None:
        joined: dict[tuple[Any, ...], list[BagTopic]] = {}
        for topic in (topic for part in self._parts for topic in part.topics):
            key = (topic.name, topic.type_name, topic.world, topic.definition, topic.type_hash, topic.profiles)
            joined.setdefault((*key, *sorted(topic.metadata.items())), []).append(topic)
        for same in joined.values():
            merged = replace(same[0], count=sum(topic.count for topic in same))
            self._topic_of.update(dict.fromkeys(same, merged))
        self.topics = tuple(dict.fromkeys(self._topic_of.values()))
        times = [part for part in self._parts if any(topic.count for topic in part.topics)]
        self.start_ns = min((part.start_ns for part in times), default=0)
        self.end_ns = max((part.end_ns for part in times), default=0)

    @override
    def messages(
        self, topics: Collection[BagTopic] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Yield the messages of all files, merged by time; at the end, raise the error of a file that did not open."""
        wanted = None if topics is None else set(topics)
        later = deque(self._parts)
        heads: list[tuple[int, int, BagMessage, Iterator[BagMessage]]] = []
        while later or heads:
            while later and (not heads or later[0].start_ns <= heads[0][0]):
                messages = self._messages_of(later.popleft(), wanted, start_ns, end_ns)
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

    def _messages_of(
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
            yield message._replace(topic=self._topic_of[message.topic])

    @override
    def skip_damage(self, on_damage: Callable[[BagError], None]) -> None:
        """Skip damaged data, and report it. If a file cannot skip its damage, the rest of that file is left out."""
        self._on_damage = on_damage
        self.left_out = self._unread  # the broken files are reported now
        for err in self._broken:
            on_damage(err)
        for part in self._parts:
            part.skip_damage(on_damage)

    @override
    def close(self) -> None:
        self._stack.close()


class FolderBag(FilesBag):
    """A folder of rosbag2: its files are those in ``metadata.yaml``, else all files with the extension of a bag."""

    def __init__(self, path: Path, open_file: Callable[[Path], Bag]) -> None:
        broken: list[BagError] = []
        metadata: dict[str, Any] = {}
        try:
            metadata = _metadata(path)
        except BagError as err:
            broken.append(err)
        with reading(path):
            files = _files(path, metadata)
        if not files:
            raise next(iter(broken), BagError(path, f"is not a bag: it has no {METADATA}, no .mcap and no .db3"))
        by_message = str(metadata.get("compression_mode", "")).lower() == "message"
        packing = str(metadata.get("compression_format", "")) if by_message else ""
        if packing not in ("", "zstd"):
            problem = f"its messages are compressed with {packing!r}; only zstd is supported"
            raise BagError(path, problem, None, "convert it with 'ros2 bag convert' on a machine with that plugin")
        super().__init__(path, files, open_file, broken)
        if not metadata and not self._broken:
            self.unfinished = True
        if packing:
            self.compression = packing


def _metadata(path: Path) -> dict[str, Any]:
    """Return the contents of the folder's metadata file; {} if it is missing, as after a recorder was killed."""
    file = path / METADATA
    if not file.is_file():
        return {}
    if file.stat().st_size > _LARGEST_METADATA:
        raise BagError(file, f"is larger than {_LARGEST_METADATA} bytes")
    with reading(file):
        document = load_yaml(file.read_text(encoding="utf-8"))
        information = document["rosbag2_bagfile_information"]
        if not isinstance(information, dict):
            raise TypeError("rosbag2_bagfile_information is not a mapping")
        return information


def _files(path: Path, metadata: dict[str, Any]) -> list[Path]:
    listed = metadata.get("relative_file_paths")
    if isinstance(listed, list) and listed:
        files = [path / Path(str(name)).name for name in listed]  # no path leaves the folder
    else:
        ends = (".mcap", ".db3", *(f"{kind}{end}" for kind in (".mcap", ".db3") for end in ENDINGS))
        files = sorted(file for file in path.iterdir() if file.name.endswith(ends))
    return files
