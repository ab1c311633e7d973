"""Publishers on the ROS 2 side."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from bridge.adapters.ros2 import rcl, rmw
from bridge.adapters.ros2.context import Closed, Ros2Context
from bridge.adapters.ros2.filters import VersionFilter
from bridge.adapters.ros2.graph.heartbeats import MATCH_SECONDS, Heartbeats
from bridge.adapters.ros2.participant import Participant
from bridge.hub.wire.qos import Qos
from bridge.messages.transcode.conversion import Convert


class _Writer:
    """One DDS writer; `send` and `close` are safe to call concurrently."""

    def __init__(
        self, participant: Participant, message_class: Any, topic: str, qos: Qos, only: VersionFilter | None
    ) -> None:
        self._participant = participant
        self._handle: Any = participant.make_writer(message_class, topic, qos)
        self._pointer = int(self._handle.pointer)
        self._filter = None if only is None else only.attach(self._pointer)
        self._lock = threading.Lock()
        self._written = self._readers = 0
        self._held: deque[bytes] | None = None
        self.native = rcl.new_writer(self._pointer, self._lock.locked)
        self._set_open()

    def _set_open(self) -> None:
        """Let C code publish, unless messages are held or the writer is closed; the lock is held."""
        if self.native is not None:
            self.native.open = self._held is None and self._handle is not None

    def send(self, payload: bytes | memoryview) -> None:
        with self._lock:
            if self._held is not None:
                self._held.append(bytes(payload))
            else:
                self._publish(payload)

    def _publish(self, payload: bytes | memoryview) -> None:
        """Publish unless closed; the lock is held."""
        if self._handle is not None:
            rcl.publish(self._pointer, payload)
            self._written += 1

    def readers_changed(self) -> bool:
        """Return whether the number of matched readers has changed since the last call; False after `close`."""
        with self._lock:
            if self._handle is None:
                return False
            before, self._readers = self._readers, rcl.reader_count(self._pointer)
            return self._readers != before

    def hold(self, depth: int) -> None:
        """Keep the last ``depth`` messages until `release`."""
        with self._lock:
            self._held = deque(maxlen=depth)
            self._set_open()

    def release(self) -> None:
        """Publish the kept messages."""
        with self._lock:
            held, self._held = self._held or (), None
            for payload in held:
                self._publish(payload)
            self._set_open()

    def prepare(self, heartbeats: Heartbeats, readers: frozenset[bytes]) -> None:
        """Prepare new readers on Cyclone DDS for the next message."""
        with self._lock:
            if self._handle is not None:
                written = self._written if self.native is None else self._written + self.native.written
                heartbeats.prepare(rmw.publisher_gid(self._pointer), written, readers)

    def close(self) -> None:
        """Destroy the writer, after it has published the kept messages."""
        self.release()
        with self._lock:
            handle, self._handle = self._handle, None
            self._set_open()
        if handle is not None:
            self._participant.destroy(handle)


HasSubscribers = Callable[[str], bool]
"""Returns whether another participant subscribes to a topic."""

ForReaders = Callable[[], Convert | None]
"""Returns the converter of messages to the version of the type that the subscriptions of a topic have."""


class Ros2Publisher:
    """Publishes messages of the hub on a ROS 2 topic.

    Volatile: one writer for all sources. Latched: one writer per source, as DDS retains the last messages of each
    writer. So a late joiner receives every source's last message, and the messages of a source disappear with it. The
    initial writer becomes the first source's.

    Args:
        topic: the ROS topic.
        message_class: the class of its type, from `TypeSupports`.
        qos: the QoS of the writers.
        context: the edge's shared state.
        closed: called by `close`.
        has_subscribers: whether another participant subscribes to a topic.
        for_readers: returns the converter of all messages, if the writers send to subscriptions of all versions.
        only: the subscriptions that the writers send to; None for all.
    """

    def __init__(
        self, topic: str, message_class: Any, qos: Qos, context: Ros2Context, closed: Closed,
        has_subscribers: HasSubscribers, for_readers: ForReaders | None = None, only: VersionFilter | None = None,
    ) -> None:  # fmt: skip
        self.topic, self.qos, self.type_name = topic, qos, str(message_class.type_name)
        self._closed, self._has_subscribers, self._for_readers = closed, has_subscribers, for_readers
        self._convert = None if for_readers is None else for_readers()
        self._heartbeats, self._later = context.heartbeats, context.later
        self._prepared = self._heartbeats.readers(topic)
        self._new_writer = partial(_Writer, context.participant, message_class, topic, qos, only)
        self._lock = threading.Lock()
        self._open = True
        self._spare: _Writer | None = self._make()
        self._writers: dict[str, _Writer] = {}
        self._only = None if qos.latched else self._spare

    @property
    def dropped(self) -> int:
        """Always 0: DDS does not report what a slow reader missed."""
        return 0

    @property
    def native(self) -> object:
        """Publishes small messages in C (``writing.c``); None for latched messages, or if they have to be converted."""
        return None if self._only is None or self._for_readers is not None else self._only.native

    @property
    def has_subscribers(self) -> bool:
        """Whether another participant subscribes to the topic."""
        return self._has_subscribers(self.topic)

    def send(self, payload: bytes | memoryview, source: str) -> None:
        """Publish a source's message; raises `ConversionError` if the subscriptions' version cannot represent it."""
        writer = self._only or self._writers.get(source) or self._writer_for(source)
        if writer is None:
            return
        if self._for_readers is not None and writer.readers_changed():
            self._follow_version(self._for_readers)
        writer.send(payload if self._convert is None else self._convert(bytes(payload)))

    def _writer_for(self, source: str) -> _Writer | None:
        with self._lock:
            if not self._open:
                return None
            writer = self._writers.get(source)
            if writer is None:
                writer, self._spare = self._spare or self._make(), None
                self._writers[source] = writer
            return writer

    def _make(self) -> _Writer:
        """Return a new writer. A latched writer holds messages until subscriptions on Cyclone DDS have matched.

        Otherwise these would lose a large first message forever (see `bridge.adapters.ros2.graph.heartbeats`).
        """
        writer = self._new_writer()
        if self._prepared:
            writer.prepare(self._heartbeats, self._prepared)
            if self.qos.latched:
                writer.hold(max(1, self.qos.depth))
                self._later.after(MATCH_SECONDS, writer.release)
        return writer

    def refit(self) -> None:
        """Follow the subscriptions' version of the type, and prepare new subscriptions on Cyclone DDS."""
        if self._for_readers is not None:
            self._follow_version(self._for_readers)
        readers = self._heartbeats.readers(self.topic)
        with self._lock:
            new, self._prepared = readers - self._prepared, readers
            writers = self._all_writers() if new else []
        for writer in writers:
            writer.prepare(self._heartbeats, new)

    def _follow_version(self, for_readers: ForReaders) -> None:
        with self._lock:  # includes reading the graph: an older version must not be applied last
            self._convert = for_readers()

    def _all_writers(self) -> list[_Writer]:
        return [*self._writers.values(), *([self._spare] if self._spare else [])]

    def drop_source(self, source: str) -> None:
        """Drop what is retained for a source; the topic stays advertised."""
        with self._lock:
            writer = self._writers.pop(source, None)
            if writer is not None and not self._writers and self._spare is None and self._open:
                self._spare = self._make()
        if writer is not None:
            writer.close()

    def close(self) -> None:
        """Destroy the writers. Safe to call twice."""
        with self._lock:
            self._open = False
            writers = self._all_writers()
            self._writers, self._spare = {}, None
        for writer in writers:
            writer.close()
        self._closed(self)
