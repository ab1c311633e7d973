"""A subscription on the hub."""

from __future__ import annotations

import logging
from collections.abc import Callable
from threading import Lock

import zenoh
from zenoh import ext

from bridge.hub import attachment
from bridge.hub.errors import WireError
from bridge.hub.graph import HubGraph
from bridge.hub.publisher import cache_depth
from bridge.hub.qos import Qos, Reliability

_log = logging.getLogger(__name__)
_MAX_SOURCES = 4096
_MAX_GAP = 1_000_000


class HubSample:
    """One message that came in.

    Attributes:
        payload: zenoh's bytes, not copied yet.
        sequence: number that the publisher gave it.
        source_time_ns: system time of its source in nanoseconds.
        gid: the 16 bytes that name its publisher.
        zid: its session, "" where it is not known.
    """

    __slots__ = ("gid", "payload", "sequence", "source_time_ns", "zid")

    def __init__(self, payload: zenoh.ZBytes, sequence: int, source_time_ns: int, gid: bytes, zid: str) -> None:
        self.payload = payload
        self.sequence = sequence
        self.source_time_ns = source_time_ns
        self.gid = gid
        self.zid = zid

    def data(self) -> bytes:
        """A copy of the payload: CDR with its encapsulation header."""
        return self.payload.to_bytes()


class _Source:
    """What a subscription remembers of one publisher."""

    __slots__ = ("sequence", "time_ns", "zid")

    def __init__(self, zid: str) -> None:
        self.zid = zid
        self.sequence: int | None = None
        self.time_ns = 0

    def gap(self, sequence: int, time_ns: int) -> int | None:
        """Samples missing before this one; None where it was delivered already."""
        last, last_time = self.sequence, self.time_ns
        if last is not None and sequence <= last and 0 < time_ns <= last_time:
            return None
        self.sequence, self.time_ns = sequence, time_ns
        if last is None or sequence <= last:
            return 0
        missing = sequence - last - 1
        return missing if missing < _MAX_GAP else 0


class HubSubscription:
    """Hears one topic; made by `bridge.hub.session.Hub.subscription`.

    Attributes:
        topic: the topic's name.
        lost: samples that publishers numbered and that never came.
        refused: samples left out: without a fitting attachment, or too large.
    """

    def __init__(
        self,
        session: zenoh.Session,
        graph: HubGraph,
        token: str,
        key: str,
        topic: str,
        qos: Qos,
        limit: int,
        callback: Callable[[HubSample], None],
        on_close: Callable[[HubSubscription], None],
    ) -> None:
        self.topic = topic
        self.lost = 0
        self.refused = 0
        self._graph = graph
        self._own = str(session.zid())
        self._limit = limit
        self._callback = callback
        self._on_close = on_close
        self._sources: dict[bytes, _Source] = {}
        self._lock = Lock()
        self._closed = False
        # direct: without a thread per subscription; zenoh's receiving thread only appends and wakes
        handler = zenoh.handlers.Callback(self._on_sample, indirect=False)
        self._subscriber: zenoh.Subscriber[None] | ext.AdvancedSubscriber[None]
        if qos.latched:
            recovers = qos.reliability is Reliability.RELIABLE
            self._subscriber = ext.declare_advanced_subscriber(
                session,
                key,
                handler,
                allowed_origin=zenoh.Locality.REMOTE,
                history=ext.HistoryConfig(detect_late_publishers=True, max_samples=cache_depth(qos)),
                recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True) if recovers else None,
                subscriber_detection=True,
            )
        else:
            self._subscriber = session.declare_subscriber(key, handler, allowed_origin=zenoh.Locality.REMOTE)
        self._withdraw = graph.announce(token)

    def close(self) -> None:
        """Hear no more. Safe to call twice."""
        with self._lock:
            closed, self._closed = self._closed, True
        if not closed:
            self._withdraw()
            self._subscriber.undeclare()  # type: ignore[no-untyped-call]
            self._on_close(self)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        if self._closed or sample.kind != zenoh.SampleKind.PUT:
            return
        payload, attached = sample.payload, sample.attachment
        if attached is None:
            self._refuse("without the attachment that rmw_zenoh puts on each sample")
            return
        if len(payload) > self._limit:
            self._refuse(f"{len(payload)} bytes, more than {self._limit}")
            return
        try:
            sequence, time_ns, gid = attachment.unpack(attached.to_bytes())
        except WireError as err:
            self._refuse(str(err))
            return
        # zenoh may call from several threads at once, one per link
        with self._lock:
            source = self._sources.get(gid)
            if source is None:
                source = self._new_source(gid)
            if not source.zid:
                source.zid = self._zid(sample, gid)
            zid = source.zid
            # zenoh's locality does not hold for what comes from caches
            if zid == self._own:
                return
            gap = source.gap(sequence, time_ns)
            if gap is None:
                return
            self.lost += gap
        self._callback(HubSample(payload, sequence, time_ns, gid, zid))

    def _new_source(self, gid: bytes) -> _Source:
        if len(self._sources) >= _MAX_SOURCES:
            del self._sources[next(iter(self._sources))]
        source = self._sources[gid] = _Source("")
        return source

    def _zid(self, sample: zenoh.Sample, gid: bytes) -> str:
        info = sample.source_info
        return self._graph.zid_of(gid) if info is None else str(info.source_id.zid)

    def _refuse(self, why: str) -> None:
        level = logging.DEBUG if self.refused else logging.WARNING
        self.refused += 1
        _log.log(level, "%s: sample left out: %s", self.topic, why)
