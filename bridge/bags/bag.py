"""A bag as all formats have it: topics, times, messages; and the one error that reading it raises."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple, Self

from bridge.hub.wire.qos import Qos
from bridge.messages.definitions.schema import World

Kind = Literal["mcap", "db3", "bag"]

MAX_CHUNK = 256 << 20
"""Bytes that a chunk or a message may have, unpacked; what declares more is refused before it is read."""

USUAL = Qos()

_BLOCK_BYTES, _BLOCK_MESSAGES = 1 << 20, 10_000

MAX_TOPICS = 65_535
"""Topics of a bag, with all their publishers: as many as MCAP can number."""


class BagError(Exception):
    """A bag cannot be read, written or converted.

    Attributes:
        path: the file.
        offset: byte of the file where the trouble begins, None where it is not known.
        cure: what a person can do about it, "" where nothing is known to help.
    """

    def __init__(self, path: Path, what: str, offset: int | None = None, cure: str = "") -> None:
        where = f"{path}, byte {offset}" if offset is not None else str(path)
        super().__init__(f"{where}: {what}" + (f"; {cure}" if cure else ""))
        self.path, self.what, self.offset, self.cure = path, what, offset, cure


@dataclass(frozen=True, eq=False)
class BagTopic:
    """One topic of a bag as one publisher or group of publishers offered it; two of one name are two objects.

    Attributes:
        type_name: as its world spells it.
        world: whose wire its messages are in.
        definition: the type's full definition, "" where the bag has none that can be read.
        type_hash: md5 or ``RIHS01_...``, "" where it is not known.
        qos: what was offered, of all publishers together; a latched ROS 1 connection is transient local.
        count: messages.
        offered: what each of the publishers offered, where that is known.
        metadata: ``side``, ``origin``, ``daemon`` as Midspan's recordings have them; ROS 1's ``callerid``.
    """

    name: str
    type_name: str
    world: World
    definition: str = ""
    type_hash: str = ""
    qos: Qos = USUAL
    count: int = 0
    metadata: Mapping[str, str] = field(default_factory=dict)
    offered: tuple[Qos, ...] = ()

    @property
    def profiles(self) -> tuple[Qos, ...]:
        """What a writer says of its QoS."""
        return self.offered or (self.qos,)


class BagMessage(NamedTuple):
    """One message; times in nanoseconds since 1970. ``data`` is ROS 1's serialization, or CDR with its header."""

    topic: BagTopic
    time_ns: int
    publish_ns: int
    data: bytes


class Columns(NamedTuple):
    """Some messages, field by field."""

    topics: Sequence[BagTopic]
    times: Sequence[int]
    publish_times: Sequence[int]
    data: Sequence[bytes]


def in_columns(messages: Iterable[BagMessage]) -> Iterator[Columns]:
    """Messages, many at once; those before a `BagError` are given."""
    block, size = list[BagMessage](), 0
    try:
        for message in messages:
            block.append(message)
            size += len(message.data)
            if size > _BLOCK_BYTES or len(block) >= _BLOCK_MESSAGES:
                yield Columns(*zip(*block, strict=True))
                block, size = [], 0
    except BagError:
        if block:
            yield Columns(*zip(*block, strict=True))
        raise
    if block:
        yield Columns(*zip(*block, strict=True))


class Bag(ABC):
    """A bag that is open for reading; a context manager. Not safe to use from several threads.

    Attributes:
        kind: the format; a folder of rosbag2 has that of its files.
        start_ns, end_ns: time of the first and of the last message; both 0 where there is none.
        size: bytes on disk.
        unfinished: whether its writer never closed it, or its end is lost.
        trouble: where and why reading ends early, None where all can be read.
        compression: ``zstd``, ``lz4``, ``bz2``, several with commas, or ``none``.
        left_out: topics that no side of Midspan can read, with their encoding; further files that cannot be opened.
        about: what the recorder wrote of itself, as MCAP's records of metadata: values by record and name.
    """

    kind: Kind
    topics: tuple[BagTopic, ...] = ()
    start_ns = end_ns = size = 0
    unfinished = False
    trouble: BagError | None = None
    compression = "none"
    left_out: tuple[str, ...] = ()
    about: Mapping[str, Mapping[str, str]] = MappingProxyType({})

    def __init__(self, path: Path) -> None:
        self.path = path

    @abstractmethod
    def messages(
        self, topics: Collection[BagTopic] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """The messages of these topics (None: all) with ``start_ns <= time_ns < end_ns``, in order of time.

        Raises `BagError` where the bag is damaged; what stands before that has been given.
        """

    def columns(
        self, topics: Collection[BagTopic] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Columns]:
        """The same as `messages`, many at once."""
        return in_columns(self.messages(topics, start_ns, end_ns))

    def skip_damage(self, told: Callable[[BagError], None]) -> None:  # noqa: B027 - a file of SQLite cannot
        """Leave out what is damaged from now on, and tell of it, where the rest can be read without it."""

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def reading(path: Path, offset: int | None = None) -> Iterator[None]:
    """Whatever a reader raises for bad bytes, ours or a library's, comes out as `BagError`."""
    try:
        yield
    except (BagError, MemoryError):
        raise
    except FileNotFoundError:
        raise BagError(path, "there is no such file") from None
    except OSError as err:
        raise BagError(path, f"cannot be read: {err.strerror or err}", offset) from err
    except Exception as err:  # libraries raise what they like: struct.error, KeyError, sqlite3.Error, ZstdError ...
        raise BagError(path, f"is damaged: {_words(err)}", offset) from err


def _words(err: Exception) -> str:
    return f"{type(err).__name__}: {' '.join(str(err).split())[:200]}"
