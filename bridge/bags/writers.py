"""Writes ROS 1 bags and the SQLite files of rosbag2 with `rosbags`; also the base class of all writers.

A bag is written in a temporary folder next to its target, and moved to the target when it is complete.
"""

from __future__ import annotations

import secrets
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from typing_extensions import override

from bridge.bags.bag import BagError, BagTopic, Kind
from bridge.bags.conversion import TopicForm
from bridge.bags.definitions import hashed_definition
from bridge.bags.qos import rosbag2_time
from bridge.hub.wire.qos import Qos
from yarp_compat.file_names import forbidden

COMPRESSIONS: dict[Kind, tuple[str, ...]] = {
    "mcap": ("zstd", "lz4", "none"), "bag": ("none", "lz4", "bz2"), "db3": ("none",),
}  # fmt: skip
"""The compressions of each format, the default first; SQLite files of rosbag2 are not compressed here."""

_MAX_SECONDS = 1 << 32
_UNKNOWN_HASH = "INVALID"
"""The text of an unset type hash in rosidl (rosidl_runtime_c, type_hash.c)."""

_NS = 1_000_000_000


class BagWriter(ABC):
    """Writes one bag; methods raise `OSError` for errors of the disk."""

    @abstractmethod
    def add(self, topic: BagTopic, form: TopicForm) -> Any:
        """Add a topic in its form; return the handle to pass to `write`."""

    @abstractmethod
    def write(
        self, handles: Sequence[Any], times: Sequence[int], publish_times: Sequence[int], data: Sequence[bytes]
    ) -> None:
        """Add messages, in the forms of their topics."""

    @abstractmethod
    def finish(self) -> None:
        """Complete the file, for example with its index."""

    def abandon(self) -> None:  # noqa: B027 - most hold nothing
        """Release the file, which will be removed."""


class Ros1(BagWriter):
    """A ROS 1 bag."""

    def __init__(self, path: Path, compression: str) -> None:
        from rosbags.rosbag1 import Writer as Writer1

        class Frugal(Writer1):
            """Stores the number of messages of each written chunk instead of the offset of each message."""

            @override
            def write_chunk(self, chunk: Any) -> None:
                super().write_chunk(chunk)
                chunk.connections = {number: range(len(items)) for number, items in chunk.connections.items()}

        self._path = path
        self._writer = Frugal(path)
        if compression != "none":
            self._writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        self._writer.open()
        self._known: dict[tuple[Any, ...], Any] = {}

    @override
    def add(self, topic: BagTopic, form: TopicForm) -> Any:
        caller = topic.metadata.get("callerid") or topic.metadata.get("origin") or "/midspan"
        package, _, name = form.type_name.partition("/")
        latching = int(topic.qos.latched)
        topic_name = form.name or topic.name
        key = (topic_name, form.type_name, form.type_hash, caller, latching)
        if key not in self._known:
            self._known[key] = self._writer.add_connection(
                topic_name, f"{package}/msg/{name}", msgdef=form.definition, md5sum=form.type_hash or "*",
                callerid=caller, latching=latching,
            )  # fmt: skip
        return self._known[key]

    @override
    def write(
        self, handles: Sequence[Any], times: Sequence[int], _publish_times: Sequence[int], data: Sequence[bytes]
    ) -> None:
        for handle, time_ns, message in zip(handles, times, data, strict=True):
            if not 0 <= time_ns < _MAX_SECONDS * _NS:
                problem = f"a message of {handle.topic} has time {time_ns} ns, which no ROS 1 bag can hold"
                raise BagError(self._path, problem)
            self._writer.write(handle, time_ns, message)

    @override
    def finish(self) -> None:
        self._writer.close()

    @override
    def abandon(self) -> None:
        self._writer.abort()


class Db3(BagWriter):
    """A folder of rosbag2 with an SQLite file and ``metadata.yaml``."""

    def __init__(self, path: Path) -> None:
        from rosbags.rosbag2 import Writer as Writer2

        self._writer = Writer2(path, version=Writer2.VERSION_LATEST)
        self._writer.open()
        self._topics: dict[tuple[str, str], tuple[TopicForm, dict[Qos, None]]] = {}
        self._connections: dict[tuple[str, str], Any] = {}

    @override
    def add(self, topic: BagTopic, form: TopicForm) -> Any:
        """Add a topic, which is one connection with the QoS of each of its publishers."""
        key = form.name or topic.name, form.type_name
        known, offered = self._topics.get(key, (form, {}))
        offered.update(dict.fromkeys(topic.profiles))
        self._topics[key] = known if known.definition else form, offered
        return key

    @override
    def write(
        self, handles: Sequence[Any], times: Sequence[int], _publish_times: Sequence[int], data: Sequence[bytes]
    ) -> None:
        if not self._connections:
            self._connect()
        for handle, time_ns, message in zip(handles, times, data, strict=True):
            self._writer.write(self._connections[handle], time_ns, message)

    def _connect(self) -> None:
        stored: dict[str, tuple[str, str]] = {}
        for form, _ in self._topics.values():
            if form.definition and (text := hashed_definition(form.type_name, form.definition, form.type_hash)):
                stored.setdefault(form.type_name, (text, form.type_hash))
        for (name, type_name), (form, offered) in self._topics.items():
            text, type_hash = stored.get(type_name, ("", form.type_hash))
            if not text:  # an empty text would be read as a message without fields
                self._writer.added_types.add(type_name)
            self._connections[name, type_name] = self._writer.add_connection(
                name, type_name, msgdef=text, rihs01=type_hash or _UNKNOWN_HASH,
                offered_qos_profiles=list(map(_profile, offered)),
            )  # fmt: skip

    @override
    def finish(self) -> None:
        if not self._connections:
            self._connect()
        self._writer.close()

    @override
    def abandon(self) -> None:
        storage = self._writer.storage
        if storage is not None:
            storage.abort()


def _profile(qos: Qos) -> Any:
    from rosbags.interfaces import Qos as BagQos
    from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    def time(nanoseconds: int | None) -> Any:
        return QosTime(*rosbag2_time(nanoseconds))

    return BagQos(
        QosHistory[qos.history.name], qos.depth, QosReliability[qos.reliability.name],
        QosDurability[qos.durability.name], time(qos.deadline_ns), time(qos.lifespan_ns), QosLiveliness.AUTOMATIC,
        time(None), False,
    )  # fmt: skip


def kind_of(path: Path) -> Kind:
    """Return the format for a file name's extension; without one it is a folder of rosbag2. Raises `BagError`."""
    kinds: dict[str, Kind] = {".mcap": "mcap", ".db3": "db3", ".bag": "bag", "": "db3"}
    kind = kinds.get(path.suffix.lower())
    if kind is None:
        raise BagError(path, "has an unknown extension", None, "use .mcap, .bag or .db3, or no extension for a folder")
    return kind


def check_compression(path: Path, kind: Kind, compression: str) -> None:
    """Raise `BagError` for a compression that the format does not support."""
    if compression not in COMPRESSIONS[kind]:
        msg = f"cannot be compressed with {compression}"
        raise BagError(path, msg, None, f"{kind} has {', '.join(COMPRESSIONS[kind])}")


def open_writer(path: Path, kind: Kind, compression: str) -> BagWriter:
    """Return a writer of a ``.bag`` or a folder of rosbag2."""
    assert kind != "mcap"
    return Ros1(path, compression) if kind == "bag" else Db3(path)


@contextmanager
def complete_file(target: Path, kind: Kind) -> Iterator[Path]:
    """Yield a temporary path to write a bag to, and move it to ``target`` once it is complete; raises `BagError`."""
    if reason := forbidden(target.name):
        raise BagError(target, reason)
    if target.exists():
        raise BagError(target, "exists already", None, "remove it, or choose another name")
    temporary = target.parent / f".{target.name}.{secrets.token_hex(4)}"
    try:
        temporary.mkdir(0o700)  # inside `try`, because a signal may arrive as soon as the folder exists
        path = temporary / target.name
        yield path
        if kind == "db3" and target.suffix:  # only the file, without its folder
            path = path / f"{path.name}.db3"
        path.rename(target)
    except (BagError, MemoryError):
        raise
    except OSError as err:
        raise BagError(target, f"cannot be written: {err.strerror or err}") from err
    except Exception as err:  # libraries raise other errors, such as sqlite3.Error for a full disk
        raise BagError(target, f"cannot be written: {type(err).__name__}: {err}") from err
    finally:
        try:
            shutil.rmtree(temporary, ignore_errors=True)
        finally:  # a signal during the removal may have raised SystemExit
            shutil.rmtree(temporary, ignore_errors=True)
