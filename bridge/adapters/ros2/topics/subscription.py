"""A subscription on the ROS 2 side that receives from every native publisher of its topic.

DDS matches a reader with the writers that offer at least the QoS that it requests. So one reader does not suffice if
publishers differ: a reader that requests a latched publisher's history excludes volatile publishers, and a best-effort
reader receives no history. Publishers are therefore sorted into classes, each class has its own reader, and a message
counts only if it comes from the reader of its publisher's class.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.context import Closed, Ros2Context
from bridge.adapters.ros2.loop import Delivers, EndpointReader
from bridge.adapters.ros2.participant import Participant
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.routing.edge import Deliver, Endpoint, MadeBy

LATCHED_DEPTH = 128
"""Minimum depth of a reader of latched publishers, as KEEP_LAST counts over all its writers, which send at once."""

VOLATILE_DEPTH = 32
"""Minimum depth of the other readers: room for messages while the loop is delayed by a few milliseconds."""

_SEQUENCES = 32
"""Number of publishers per reader whose sequence numbers are tracked before departed publishers are removed."""

_LOG_SECONDS = 10.0

_log = logging.getLogger(__name__)


class ReaderClass(NamedTuple):
    """The QoS that a reader requests."""

    reliability: Reliability
    durability: Durability


class _Source(NamedTuple):
    id: str
    reader_class: ReaderClass


Accepts = Callable[[Endpoint], bool]
"""Returns whether a publisher has the subscription's version of the type."""


class Ros2Subscription:
    """Receives from all native publishers of a topic that have its version of the type.

    It has one reader per QoS class. Each version has its own subscription, and DDS delivers all messages to each.
    """

    def __init__(
        self, topic: str, message_class: Any, qos: Qos, deliver: Deliver, context: Ros2Context, closed: Closed,
        accepts: Accepts = lambda _publisher: True,
    ) -> None:  # fmt: skip
        self.topic, self.qos, self.deliver, self._accepts = topic, qos, deliver, accepts
        self._message_class, self.type_name = message_class, str(message_class.type_name)
        self._participant, self._loop, self._graph = context.participant, context.loop, context.graph
        self._on_closed = closed
        self.lost = 0
        self._lock = threading.Lock()
        self._readers: dict[ReaderClass, ClassReader] = {}
        self._sources: dict[bytes, _Source] = {}
        self.closed = False
        self._logged_at = float("-inf")
        self.refit()

    def refit(self) -> None:
        """Create a reader for each class of the current native publishers, and remove the others.

        Without publishers, the readers stay; the first one has the requested QoS.
        """
        with self._lock:  # includes reading the graph: an older snapshot must not be applied last
            if self.closed:
                return
            publishers = {
                g: p
                for g, p in self._graph.publishers(self.topic).items()
                if p.made_by is MadeBy.NATIVE and self._accepts(p)
            }
            wanted = {self._class_of(p, publishers.values()) for p in publishers.values()}
            if not wanted and not self._readers:
                wanted = {ReaderClass(self.qos.reliability, self.qos.durability)}
            # a publisher's class may depend on the other publishers; see `_class_of`
            sources = {
                gid: _Source(publisher.id, self._class_of(publisher, publishers.values()))
                for gid, publisher in publishers.items()
            }
            ids: dict[ReaderClass, dict[bytes, str]] = {}
            for gid, source in sources.items():
                ids.setdefault(source.reader_class, {})[gid] = source.id
            for reader_class, reader in self._readers.items():
                if reader.sources != ids.get(reader_class, {}):
                    reader.set_sources({})  # first: a reader of another class may deliver its publishers' messages now
            self._sources = sources
            for new in wanted - self._readers.keys():
                self._readers[new] = self._open(new)
            for old in self._readers.keys() - wanted if wanted else ():
                self._loop.remove(self._readers.pop(old))
            for reader_class, reader in self._readers.items():
                if reader.sources != ids.get(reader_class, {}):
                    reader.set_sources(ids.get(reader_class, {}))

    def _open(self, reader_class: ReaderClass) -> ClassReader:
        min_depth = LATCHED_DEPTH if reader_class.durability is Durability.TRANSIENT_LOCAL else VOLATILE_DEPTH
        depth = max(min_depth, self.qos.depth)
        qos = replace(self.qos, reliability=reader_class.reliability, durability=reader_class.durability, depth=depth)
        handle = self._participant.make_reader(self._message_class, self.topic, qos)
        reader = ClassReader(self, reader_class, handle, self._participant)
        self._loop.add(reader)
        return reader

    def _class_of(self, publisher: Endpoint, among: Any) -> ReaderClass:
        requested, offer = self.qos, publisher.qos
        # The engine requests best effort if any publisher offers only that; otherwise a rule has forced it.
        forced = requested.reliability is Reliability.BEST_EFFORT and not any(
            p.qos.reliability is Reliability.BEST_EFFORT for p in among
        )
        reliable = offer.reliability is Reliability.RELIABLE and not forced
        latched = requested.latched and offer.latched and reliable
        return ReaderClass(
            Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT,
            Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
        )

    def source(self, gid: bytes, reader_class: ReaderClass) -> str | None:
        """Return the id of the publisher of a message, None if this reader must not deliver it."""
        source = self._sources.get(gid) or self._resolve(gid, reader_class)
        if source is None:
            return None
        source_class = source.reader_class
        # the reader of the source's class delivers it, a latched reader even if it is created only later
        if source_class != reader_class and (
            source_class.durability is Durability.TRANSIENT_LOCAL or source_class in self._readers
        ):
            return None
        return source.id

    def sources(self) -> set[str]:
        """Return the ids of the current publishers."""
        return {source.id for source in self._sources.values()}

    def _resolve(self, gid: bytes, reader_class: ReaderClass) -> _Source | None:
        if self._participant.marks.made_by(gid) is MadeBy.MIDSPAN:
            return None
        publisher = self._graph.find(self.topic, gid)
        if publisher is None:  # the engine holds the message until it is known
            return _Source(gid.hex(), reader_class)
        if publisher.made_by is MadeBy.MIDSPAN or not self._accepts(publisher):
            return None
        known = {**self._graph.publishers(self.topic), gid: publisher}
        source = _Source(gid.hex(), self._class_of(publisher, known.values()))
        # While the publisher's origin is unknown, the engine holds the message, or the latched reader gets it later.
        if publisher.made_by is MadeBy.NATIVE:
            with self._lock:
                self._sources[gid] = source
        return source

    def failed(self, source: str, error: Exception) -> None:
        """Log the exception of one message, at a limited rate; later messages are still delivered."""
        if time.monotonic() - self._logged_at > _LOG_SECONDS:
            self._logged_at = time.monotonic()
            _log.error("%s: a message of %s is dropped", self.topic, source, exc_info=error)

    def close(self) -> None:
        """Stop delivering, and destroy the readers. Safe to call twice."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
            readers, self._readers = list(self._readers.values()), {}
        for reader in readers:
            reader.set_sources({})
            self._loop.remove(reader)
        self._on_closed(self)


class ClassReader(EndpointReader):
    """One DDS reader of a subscription; ``sources`` are the ids of publishers whose messages the queue delivers."""

    def __init__(
        self, owner: Ros2Subscription, reader_class: ReaderClass, handle: Any, participant: Participant
    ) -> None:
        super().__init__(participant, handle)
        self._owner, self._class, self.topic = owner, reader_class, owner.topic
        self._large = False
        self.sources: dict[bytes, str] = {}
        self._sequences: dict[str, int] = {}
        self._room = _SEQUENCES

    @property
    @override
    def taken_from(self) -> int:
        resolves = self._participant.resolve is not None  # which only the loop's `Taker` does
        return 0 if resolves else self.pointer

    @property
    @override
    def delivers(self) -> Delivers:
        return self._owner.deliver, self.sources, self._sequences

    def set_sources(self, sources: Mapping[bytes, str]) -> None:
        """Set the ids of the publishers of this class, by GID; `accept` handles the messages of others."""
        self.sources.clear()
        self.sources.update(sources)

    @override
    def drain(self, taker: rcl.Taker, limit: int) -> None:
        for _ in range(limit):
            taken = taker.take(self.pointer, large=self._large)
            if taken is None:
                return
            self._large = len(taken.payload) >= rcl.LARGE
            self.accept(*taken)

    @override
    def accept(self, payload: bytes, gid: bytes, source_ns: int, sequence: int) -> None:
        """Deliver a message if its publisher belongs to this class."""
        owner = self._owner
        if owner.closed:
            return
        source = owner.source(gid, self._class)
        if source is None:
            return
        try:
            owner.deliver(payload, source, source_ns)
        except Exception as err:
            owner.failed(source, err)
        self.count(source, sequence)

    def failed(self, source: str, error: Exception) -> None:
        """Log the exception of a message that the queue has delivered."""
        self._owner.failed(source, error)

    def count(self, source: str, sequence: int) -> None:
        """Count a publisher's messages missing since its last one: overwritten in a full history, or never received."""
        if source not in self._sequences and len(self._sequences) >= self._room:
            for departed in self._sequences.keys() - self._owner.sources():
                del self._sequences[departed]
            self._room = 2 * len(self._sequences) + _SEQUENCES
        last = self._sequences.get(source, sequence)
        self._owner.lost += max(sequence - last - 1, 0)
        self._sequences[source] = max(sequence, last)
