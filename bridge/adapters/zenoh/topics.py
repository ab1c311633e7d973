"""Publishers and subscriptions on the keys of a foreign dialect, and their announcements."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import zenoh

from bridge.adapters.latched_cache import LatchedCache
from bridge.adapters.zenoh.neighbors import is_marked, sender, time_ns
from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.endpoints.calls import nothing
from bridge.hub.wire.qos import Qos
from bridge.hub.zenoh_compat import answer, source_infos, subscribe, undeclare
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.edge import Deliver, is_command
from bridge.routing.limits import BULK, QUEUE_BYTES, Priority

Withdraw = Callable[[], None]


@dataclass(frozen=True, slots=True)
class KeyContext:
    """The shared state of one edge's endpoints.

    ``limit`` is the maximum size of a request or reply in bytes; ``executor`` runs calls that may wait for zenoh,
    ``ends`` handles the ends of queries, ``delays`` runs delayed calls; ``small`` and ``bulk`` convert received
    messages, urgent ones first; ``closed`` is called with each endpoint that has closed.
    """

    session: zenoh.Session
    limit: int
    executor: SerialExecutor
    ends: SerialExecutor
    delays: DelayedCalls
    small: Dispatcher
    bulk: Dispatcher
    closed: Callable[[Any], None]


class Announcement:
    """Announces an endpoint, and withdraws the announcement when the endpoint closes.

    The announcement is published once the endpoint exists, because peers call, publish or query as soon as they receive
    it. An endpoint that has closed by then is not announced. ``announce`` returns the function that withdraws the
    announcement; by default, nothing is announced.
    """

    def __init__(self, announce: Callable[[], Withdraw] = lambda: nothing) -> None:
        self._announce = announce
        self._lock = threading.Lock()
        self._withdraw: Withdraw | None = None
        self._over = False

    def publish(self) -> None:
        """Announce the endpoint, unless it has been closed."""
        with self._lock:
            if not self._over:
                self._withdraw = self._announce()

    def withdraw(self) -> None:
        """Withdraw the announcement. Safe to call twice."""
        with self._lock:
            self._over = True
            withdraw, self._withdraw = self._withdraw, None
        if withdraw is not None:
            withdraw()


def priority(qos: Qos) -> zenoh.Priority:
    """Return the zenoh priority for a QoS: commands before state before streams."""
    if is_command(qos):
        return zenoh.Priority.INTERACTIVE_HIGH
    return zenoh.Priority.DATA_HIGH if qos.latched else zenoh.Priority.DATA


class PlainSink:
    """Publishes on a key; commands (volatile, depth 1) have priority. The session's id marks samples as Midspan's."""

    def __init__(self, session: zenoh.Session, key: str, qos: Qos, encoding: zenoh.Encoding | None = None) -> None:
        self._session, self._encoding = session, encoding
        self.publisher = session.declare_publisher(
            key, express=is_command(qos), priority=priority(qos),
            congestion_control=zenoh.CongestionControl.DROP, allowed_destination=zenoh.Locality.REMOTE,
        )  # fmt: skip
        self._infos = source_infos(self.publisher)

    def put(self, payload: bytes) -> None:
        """Publish; not thread-safe."""
        with contextlib.suppress(zenoh.ZError):  # the session is being closed
            self.publisher.put(
                payload, source_info=next(self._infos), encoding=self._encoding, timestamp=self._session.new_timestamp()
            )

    def close(self) -> None:
        undeclare(self.publisher)


class KeyPublisher:
    """Publishes messages of the hub on a plain key, and replies to a ``get`` with the latched messages.

    ``qos`` determines whether messages are cached, and how many per source; with ``newest`` a ``get`` returns only the
    newest message.
    """

    dropped = 0  #: zenoh does not report drops on a congested link
    has_subscribers = True  #: subscriptions are not counted

    def __init__(
        self, context: KeyContext, key: str, qos: Qos, announcement: Announcement, *,
        encoding: zenoh.Encoding | None = None, newest: bool = False,
    ) -> None:  # fmt: skip
        self.announcement = announcement
        self._session, self._closed = context.session, context.closed
        self._key, self._qos, self._encoding, self._newest = key, qos, encoding, newest
        self._lock = threading.Lock()
        self._cache = LatchedCache(qos.depth)
        self._listener: zenoh.MatchingListener[None] | None = None
        self._sink: PlainSink | None = PlainSink(context.session, key, qos, encoding)
        self._queryable = answer(context.session, key, self._on_query) if qos.latched else None

    def send(self, payload: bytes, source: str) -> None:
        """Publish a message; a latched message is also cached."""
        with self._lock:
            if self._sink is None:
                return
            if self._qos.latched:
                self._cache.add(payload, source)
            self._sink.put(payload)

    def drop_source(self, source: str) -> None:
        """Drop a source's latched messages."""
        with self._lock:
            self._cache.drop_source(source)

    def republish(self) -> None:
        """Publish the latched messages once more."""
        with self._lock:
            for payload in self._cache.all():
                if self._sink is not None:
                    self._sink.put(payload)

    def close(self) -> None:
        """Undeclare the publisher. Safe to call twice."""
        with self._lock:
            sink, self._sink = self._sink, None
        if sink is not None:
            self.announcement.withdraw()
            sink.close()
            if self._queryable is not None:
                undeclare(self._queryable)
            self._closed(self)

    def _on_query(self, query: zenoh.Query) -> None:
        with self._lock:
            latched = self._cache.all()
        with query, contextlib.suppress(zenoh.ZError):
            for payload in latched[-1:] if self._newest else latched:
                query.reply(self._key, payload, encoding=self._encoding, timestamp=self._session.new_timestamp())

    def watch(self, matched: Callable[[], None]) -> None:
        """Call ``matched`` when the first subscriber of the key appears."""

        def changed(status: zenoh.MatchingStatus) -> None:
            if status.matching:
                matched()

        if self._sink is not None:
            handler = zenoh.handlers.Callback(changed, indirect=False)
            self._listener = self._sink.publisher.declare_matching_listener(handler)


class SampleQueue:
    """A bounded queue that drops its oldest messages; for commands (depth 1, volatile) it stores only the newest.

    Messages are delivered in order and one at a time, even while the queue changes from ``small`` to ``bulk``.
    """

    def __init__(self, deliver: Deliver, qos: Qos, context: KeyContext) -> None:
        self.lost = 0
        self._deliver, self._bulk = deliver, context.bulk
        self._depth = max(qos.depth, 1)
        self._priority = Priority.COMMAND if is_command(qos) else Priority.STATE if qos.latched else Priority.STREAM
        self._lock, self._delivering = threading.Lock(), threading.Lock()
        self._queue: deque[tuple[zenoh.ZBytes, str, int | None]] = deque()
        self._bytes = 0
        self._dispatcher = context.small
        self._closed = False

    def add(self, payload: zenoh.ZBytes, source: str, time_ns: int | None) -> None:
        """Append a message and schedule its delivery."""
        size = len(payload)
        with self._lock:
            if self._closed:
                return
            self._queue.append((payload, source, time_ns))
            self._bytes += size
            while len(self._queue) > self._depth or (self._bytes > QUEUE_BYTES and len(self._queue) > 1):
                self._bytes -= len(self._queue.popleft()[0])
                self.lost += 1
            if size > BULK and len(self._queue) == 1:
                self._dispatcher = self._bulk
            dispatcher = self._dispatcher
        dispatcher.submit(self._priority, self._next)

    def _next(self) -> None:
        with self._delivering:
            with self._lock:
                if not self._queue or self._closed:
                    return
                payload, source, time_ns = self._queue.popleft()
                self._bytes -= len(payload)
            self._deliver(payload.to_bytes(), source, time_ns)

    def close(self) -> None:
        """Stop delivering, and drop queued messages."""
        with self._lock:
            self._closed = True
            self._queue.clear()


SourceOf = Callable[[zenoh.Sample], str]


class KeySubscription:
    """Delivers samples of native programs on a key; ``source_of`` returns an endpoint's id, "" to ignore a sample."""

    def __init__(
        self, context: KeyContext, key: str, qos: Qos, deliver: Deliver, source_of: SourceOf, announcement: Announcement
    ) -> None:
        self.key, self.announcement = key, announcement
        self._queue, self._source_of, self._closed = SampleQueue(deliver, qos, context), source_of, context.closed
        self._open = True
        self._subscriber = subscribe(context.session, key, self._on_sample)

    @property
    def lost(self) -> int:
        """Number of messages dropped because the queue was full."""
        return self._queue.lost

    def close(self) -> None:
        """Stop delivering. Safe to call twice."""
        opened, self._open = self._open, False
        if opened:
            undeclare(self._subscriber)
            self._queue.close()
            self.announcement.withdraw()
            self._closed(self)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        source = self.native(sample)
        if source:
            self.accept(sample, source)

    def native(self, sample: zenoh.Sample) -> str:
        """Return the endpoint that published a sample; "" to ignore the sample."""
        if not self._open or sample.kind != zenoh.SampleKind.PUT or is_marked(sender(sample)):
            return ""
        return self._source_of(sample)

    def accept(self, sample: zenoh.Sample, source: str) -> None:
        """Queue a native message."""
        self._queue.add(sample.payload, source, time_ns(sample))
