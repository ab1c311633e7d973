"""Publishers and latched subscriptions of the ros2dds dialect.

The plugin's transient-local publishers are zenoh's advanced publishers, whose samples are ordered by time stamp
(``src/route_publisher.rs``); other programs may number their samples instead.
"""

from __future__ import annotations

import contextlib
import threading
from collections import Counter
from collections.abc import Callable

import zenoh
from typing_extensions import override

from bridge.adapters.zenoh.neighbors import sender, ticks
from bridge.adapters.zenoh.topics import Announcement, KeyContext, KeySubscription, PlainSink, SourceOf, priority
from bridge.concurrency import DelayedCalls
from bridge.hub.endpoints.latched import LatchedHistory, LatchedPublisher, is_newer
from bridge.hub.wire.qos import Qos
from bridge.routing.edge import Deliver


class Ros2ddsPublisher:
    """Publishes messages of the hub, latched messages through one advanced publisher per source."""

    dropped = 0  #: zenoh does not report drops on a congested link
    has_subscribers = True  #: subscriptions are not counted

    def __init__(
        self, context: KeyContext, key: str, qos: Qos, heartbeats: DelayedCalls, announcement: Announcement
    ) -> None:
        self.announcement = announcement
        self._context, self._key, self._qos, self._heartbeats = context, key, qos, heartbeats
        self._lock = threading.Lock()
        self._open = True
        self._sinks: dict[str, PlainSink | LatchedPublisher] = {}

    def send(self, payload: bytes, source: str) -> None:
        """Publish a message; a latched message is published through its source's own publisher."""
        name = source if self._qos.latched else ""
        with self._lock:
            if not self._open:
                return
            sink = self._sinks.get(name)
            if sink is None:
                sink = self._sinks[name] = self._make()
            with contextlib.suppress(zenoh.ZError):  # the session is being closed
                sink.put(payload)

    def _make(self) -> PlainSink | LatchedPublisher:
        session, key, qos = self._context.session, self._key, self._qos
        if not qos.latched:
            return PlainSink(session, key, qos)
        depth, drop = max(qos.depth, 1), zenoh.CongestionControl.DROP
        return LatchedPublisher(session, key, depth, self._heartbeats, congestion=drop, priority=priority(qos))

    def drop_source(self, source: str) -> None:
        """Close a source's publisher, with its latched messages."""
        with self._lock:
            sink = self._sinks.pop(source, None) if self._qos.latched else None
        if sink is not None:
            sink.close()

    def close(self) -> None:
        """Undeclare the publishers. Safe to call twice."""
        with self._lock:
            opened, self._open = self._open, False
            sinks, self._sinks = list(self._sinks.values()), {}
        if opened:
            self.announcement.withdraw()
            for sink in sinks:
                sink.close()
            self._context.closed(self)


_MAX_HELD = 1000
_MAX_PUBLISHERS = 4096


class LatchedSubscription(KeySubscription):
    """Receives live samples, and requests ``wanted`` cached samples from each publisher once.

    ``depth`` returns how many cached samples of a source are delivered.
    """

    def __init__(
        self, context: KeyContext, key: str, qos: Qos, deliver: Deliver, source_of: SourceOf,
        announcement: Announcement, depth: Callable[[str], int], wanted: int,
    ) -> None:  # fmt: skip
        self._depth = depth
        self._query_lock = threading.Lock()
        self._pending_queries: Counter[str] = Counter()
        self._stored: dict[str, list[tuple[zenoh.Sample, str]]] = {}
        self._held: dict[str, list[tuple[zenoh.Sample, str]]] = {}
        self._last: dict[tuple[str, str, str], tuple[int | None, int]] = {}
        super().__init__(context, key, qos, deliver, source_of, announcement)
        self._history = LatchedHistory(
            context.session, key, wanted, self, context.executor, context.ends, context.delays, recovers=False
        )
        self._history.open()

    def ask_for(self, wanted: int) -> None:
        """Request at least ``wanted`` samples from publishers that appear from now on."""
        self._history.depth = max(self._history.depth, wanted)

    @override
    def close(self) -> None:
        if self._open:
            self._history.close()
        super().close()

    @override
    def accept(self, sample: zenoh.Sample, source: str) -> None:
        """Accept a live sample; hold it back while its session is queried."""
        zid = sender(sample)
        with self._query_lock:
            if self._pending_queries[zid] and len(self._held.get(zid, ())) < _MAX_HELD:
                self._held.setdefault(zid, []).append((sample, source))
            else:
                self._deliver(sample, source)

    def on_query(self, zid: str) -> None:
        """Hold back a session's live samples while its publishers are queried."""
        with self._query_lock:
            self._pending_queries[zid] += 1

    def on_stored(self, sample: zenoh.Sample) -> None:
        """Store a cached sample until its session's reply is complete."""
        source = self.native(sample)
        if source:
            with self._query_lock:
                self._stored.setdefault(sender(sample), []).append((sample, source))

    def done(self, zid: str) -> None:
        """Deliver a session's cached samples in order, then the live samples that were held back."""
        with self._query_lock:
            self._pending_queries[zid] -= 1
            if self._pending_queries[zid] > 0:
                return
            del self._pending_queries[zid]
            by_source: dict[str, list[tuple[zenoh.Sample, str]]] = {}
            for entry in sorted(self._stored.pop(zid, []), key=lambda entry: ticks(entry[0])):
                by_source.setdefault(entry[1], []).append(entry)
            for source, entries in by_source.items():
                for entry in entries[-self._depth(source) :]:
                    self._deliver(*entry)
            for entry in self._held.pop(zid, []):
                self._deliver(*entry)

    def _deliver(self, sample: zenoh.Sample, source: str) -> None:
        stamp, info = ticks(sample), sample.source_info
        # a publisher that is announced again has another id, under which its cached messages are delivered again
        publisher = source, sender(sample), "" if info is None else str(info.source_id.eid)
        number = None if info is None else info.source_sn
        last = self._last.get(publisher)
        if last is not None and not is_later(number, stamp, *last):
            return  # it was received both live and from the cache
        if len(self._last) >= _MAX_PUBLISHERS:
            del self._last[next(iter(self._last))]
        self._last[publisher] = number, stamp
        super().accept(sample, source)


def is_later(number: int | None, stamp: int, last_number: int | None, last_stamp: int) -> bool:
    """Return whether a sample follows its publisher's last sample, by source number or, if missing, by time stamp.

    A publisher that restarts with the same id starts numbering from 0 again, with later time stamps.
    """
    if number is None or last_number is None:
        return not stamp or stamp > last_stamp
    return is_newer(number, last_number) or 0 < last_stamp < stamp
