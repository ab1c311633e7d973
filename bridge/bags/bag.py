"""The common interface of all formats of bags: topics, times, messages; and the error that reading raises."""

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
"""Maximum uncompressed bytes of a chunk or a message; a larger one is refused before it is read."""

USUAL = Qos()

_BLOCK_BYTES, _BLOCK_MESSAGES = 1 << 20, 10_000

MAX_TOPICS = 65_535
"""Maximum topics of a bag, counted per publisher, because MCAP's channel numbers have 16 bits."""


class BagError(Exception):
    """A bag cannot be read, written or converted.

    Attributes:
        path: the file.
        offset: first byte of the damage, None if unknown.
        cure: how to fix it, "" if unknown.
    """

    def __init__(self, path: Path, what: str, offset: int | None = None, cure: str = "") -> None:
        where = f"{path}, byte {offset}" if offset is not None else str(path)
        super().__init__(f"{where}: {what}" + (f"; {cure}" if cure else ""))
        self.path, self.what, self.offset, self.cure = path, what, offset, cure


@dataclass(frozen=True, eq=False)
class BagTopic:
    """A topic of a bag as one publisher or group of publishers offered it; several objects may have the same name.

    Attributes:
        type_name: the type's name as its world spells it.
        world: the world whose serialization its messages have.
        definition: the type's full definition, "" if the bag has no readable one.
        type_hash: md5 or ``RIHS01_...``, "" if unknown.
        qos: the merged offer of all publishers; a latched ROS 1 connection is transient local.
        count: number of messages.
        offered: the offer of each publisher, if known.
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
        """The QoS profiles to write."""
        return self.offered or (self.qos,)


class BagMessage(NamedTuple):
    """One message; times in nanoseconds since 1970. ``data`` is ROS 1's serialization, or CDR with its header."""

    topic: BagTopic
    time_ns: int
    publish_ns: int
    data: bytes


class Columns(NamedTuple):
    """Messages in columns: one sequence for each member of `BagMessage`."""

    topics: Sequence[BagTopic]
    times: Sequence[int]
    publish_times: Sequence[int]
    data: Sequence[bytes]


def in_columns(messages: Iterable[BagMessage]) -> Iterator[Columns]:
    """Yield messages in blocks, including those before a `BagError`."""
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
        kind: the format; for a folder of rosbag2, the format of its files.
        start_ns, end_ns: times of the first and the last message; both 0 for an empty bag.
        size: bytes on disk.
        unfinished: whether its writer did not close it, or its end is lost.
        trouble: the error at which reading ends early, None if the whole bag is readable.
        compression: ``zstd``, ``lz4``, ``bz2``, several with commas, or ``none``.
        left_out: texts that name topics whose encoding Midspan does not read, and files that cannot be opened.
        about: the recorder's metadata, as in MCAP's metadata records: values by record and name.
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
        """Yield the messages of these topics (None: all) with ``start_ns <= time_ns < end_ns``, in order of time.

        Raises `BagError` at damaged data, after the messages before it.
        """

    def columns(
        self, topics: Collection[BagTopic] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Columns]:
        """Yield the same messages as `messages`, in blocks."""
        return in_columns(self.messages(topics, start_ns, end_ns))

    def skip_damage(self, on_damage: Callable[[BagError], None]) -> None:  # noqa: B027 - a file of SQLite cannot
        """Skip damaged data from now on, and report it, if the rest is readable without it."""

    @abstractmethod
    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def reading(path: Path, offset: int | None = None) -> Iterator[None]:
    """Convert any error of a reader for bad bytes, Midspan's or a library's, to `BagError`."""
    try:
        yield
    except (BagError, MemoryError):
        raise
    except FileNotFoundError:
        raise BagError(path, "file not found") from None
    except OSError as err:
        raise BagError(path, f"cannot be read: {err.strerror or err}", offset) from err
    except Exception as err:  # the libraries' errors: struct.error, KeyError, sqlite3.Error, ZstdError ...
        raise BagError(path, f"is damaged: {_words(err)}", offset) from err


def _words(err: Exception) -> str:
    return f"{type(err).__name__}: {' '.join(str(err).split())[:200]}"
