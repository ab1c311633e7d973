"""A subscription on the hub."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from threading import Lock

import zenoh

from bridge.hub import attachment
from bridge.hub.errands import Errands
from bridge.hub.errors import WireError
from bridge.hub.graph import HubGraph
from bridge.hub.history import History
from bridge.hub.publisher import cache_depth
from bridge.hub.qos import Qos, Reliability
from bridge.hub.receiving import keep_thread_state

_log = logging.getLogger(__name__)
_MAX_SOURCES = 4096
_SPARED = 64
"""Publishers that left the graph, or were never on it, and are remembered nevertheless; the newest."""
_MAX_GAP = 1_000_000
_MAX_HELD = 1000
"""Samples of one publisher that are held back at most, beyond its history."""

_MAX_HELD_BYTES = 256 << 20
"""Bytes that one subscription holds back at most, with `_OVERHEAD` for each sample."""

_OVERHEAD = 256


Refused = Callable[[str, str], None]
"""``refused(reason, why)``: a sample was left out; ``reason`` is ``bad`` or ``large``, ``why`` is for people."""


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

    __slots__ = ("held", "sequence", "time_ns", "zid")

    def __init__(self, zid: str) -> None:
        self.zid = zid
        self.sequence: int | None = None
        self.time_ns = 0
        self.held: dict[int, HubSample] = {}

    def take(self, sample: HubSample) -> int | None:
        """Mark a sample as delivered; what `gap` said of it, None where it is not to be delivered."""
        last, number = self.sequence, sample.sequence
        missing = 0 if last is not None and number == last + 1 else self.gap(sample)
        if missing is not None:
            self.sequence, self.time_ns = number, sample.source_time_ns
        return missing

    def gap(self, sample: HubSample) -> int | None:
        """Samples missing before this one; None where it was delivered already."""
        last = self.sequence
        if last is None:
            return 0
        if sample.sequence <= last:
            # numbered anew by a publisher that keeps its GID, unless it is not newer
            return None if 0 < sample.source_time_ns <= self.time_ns else 0
        missing = sample.sequence - last - 1
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
        errands: Errands,
        callback: Callable[[HubSample], None],
        on_close: Callable[[HubSubscription], None],
        on_refused: Refused | None = None,
    ) -> None:
        self.topic = topic
        self.lost = 0
        self.refused = 0
        self._graph = graph
        self._own = str(session.zid())
        self._limit = limit
        self._depth = cache_depth(qos)
        self._recovers = qos.latched and qos.reliability is Reliability.RELIABLE
        self._callback = callback
        self._on_close = on_close
        self._on_refused = on_refused
        self._sources: dict[bytes, _Source] = {}
        self._room = 2 * _SPARED
        self._asked: Counter[str] = Counter()
        self._held = 0
        # never taken by `close`, whose caller may hold a lock that the callback waits for
        self._lock = Lock()
        self._closing = Lock()
        self._closed = False
        self._history = History(session, key, self._depth, self, errands, recovers=self._recovers)
        # direct: without a thread per subscription; zenoh's receiving thread only appends and wakes
        self._subscriber: zenoh.Subscriber[None] = session.declare_subscriber(
            key,
            zenoh.handlers.Callback(self._on_latched if qos.latched else self._on_sample, indirect=False),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        if qos.latched:
            self._history.open()
        self._withdraw = graph.announce(token)

    def close(self) -> None:
        """Hear no more. Safe to call twice."""
        with self._closing:
            closed, self._closed = self._closed, True
        if not closed:
            self._withdraw()
            self._subscriber.undeclare()  # type: ignore[no-untyped-call]
            self._history.close()
            self._on_close(self)

    # -- volatile ------------------------------------------------------------------------------------------------------

    def _on_sample(self, sample: zenoh.Sample) -> None:
        message = self._read(sample)
        if message is None:
            return
        # zenoh may call from several threads at once, one per link
        with self._lock:
            source = self._sources.get(message.gid)
            if source is None or not source.zid:
                source = self._source(message, sample)
            message.zid = zid = source.zid
            gap = None if zid == self._own else source.take(message)
            if gap is None:
                return
            self.lost += gap
        self._callback(message)

    # -- latched -------------------------------------------------------------------------------------------------------

    def _on_latched(self, sample: zenoh.Sample) -> None:
        message = self._read(sample)
        if message is None:
            return
        self._history.saw(sample.source_info)
        with self._lock:
            source = self._source(message, sample)
            zid, gap = source.zid, source.gap(message)
            if zid == self._own or gap is None:
                return
            # of a publisher that keeps one sample the newest is all that counts
            deep = self._depth > 1 and len(source.held) < self._depth + _MAX_HELD
            # a live sample may come before its publisher's token, by which it would have been asked
            past = gap > 0 if source.sequence is not None else message.sequence > 1
            missing = deep and past and bool(zid) and (self._recovers or source.sequence is None)
            if not ((missing or (deep and self._asked[zid])) and self._hold(source, message)):
                self._release(source)
                self._deliver(source, message)
            missing = missing and not self._asked[zid]
        if missing:
            self._history.ask_session(zid)

    def asked(self, zid: str) -> None:
        """A session's publishers were asked for what they keep; see `History`."""
        with self._lock:
            self._asked[zid] += 1

    def came(self, sample: zenoh.Sample) -> None:
        """One of the samples that a publisher keeps; see `History`."""
        message = self._read(sample)
        if message is None:
            return
        self._history.saw(sample.source_info)
        with self._lock:
            source = self._source(message, sample)
            if source.zid == self._own or source.gap(message) is None:
                return
            if not self._hold(source, message):
                self._refuse("large", f"more than {_MAX_HELD_BYTES} bytes are kept for late joiners")

    def done(self, zid: str) -> None:
        """All that was asked of a session has come; see `History`."""
        with self._lock:
            self._asked[zid] -= 1
            if self._asked[zid] > 0:
                return
            del self._asked[zid]
            for source in self._sources.values():
                if source.held and not self._asked[source.zid]:
                    self._release(source)

    def _hold(self, source: _Source, message: HubSample) -> bool:
        """Hold a sample back; False where too much is held already."""
        size = len(message.payload) + _OVERHEAD
        if self._held + size > _MAX_HELD_BYTES or message.sequence in source.held:
            return message.sequence in source.held
        source.held[message.sequence] = message
        self._held += size
        return True

    def _take_held(self, source: _Source) -> dict[int, HubSample]:
        held, source.held = source.held, {}
        self._held -= sum(len(message.payload) + _OVERHEAD for message in held.values())
        return held

    def _release(self, source: _Source) -> None:
        held = self._take_held(source)
        for sequence in sorted(held):
            self._deliver(source, held[sequence])

    def _deliver(self, source: _Source, message: HubSample) -> None:
        gap = None if self._closed else source.take(message)
        if gap is not None:
            self.lost += gap
            self._callback(message)

    # -- both ----------------------------------------------------------------------------------------------------------

    def _read(self, sample: zenoh.Sample) -> HubSample | None:
        keep_thread_state()
        if self._closed:
            return None
        payload, attached = sample.payload, sample.attachment
        size = len(payload)
        if not size and sample.kind != zenoh.SampleKind.PUT:
            return None
        if attached is None:
            self._refuse("bad", "a sample without the attachment that rmw_zenoh puts on each")
            return None
        if size > self._limit:
            self._refuse("large", f"message of {size} bytes, the limit is {self._limit}")
            return None
        try:
            sequence, time_ns, gid = attachment.unpack(attached.to_bytes())
        except WireError as err:
            self._refuse("bad", str(err))
            return None
        return HubSample(payload, sequence, time_ns, gid, "")

    def _source(self, message: HubSample, sample: zenoh.Sample) -> _Source:
        source = self._sources.get(message.gid)
        if source is None:
            if len(self._sources) >= self._room:
                self._make_room()
            source = self._sources[message.gid] = _Source("")
        if not source.zid:
            info = sample.source_info
            source.zid = self._graph.zid_of(message.gid) if info is None else str(info.source_id.zid)
        message.zid = source.zid
        return source

    def _make_room(self) -> None:
        """Forget publishers that are gone; some participants (zenoh-ros2-sdk) have never been on the graph."""
        gone = [gid for gid, source in self._sources.items() if not source.held and not self._graph.zid_of(gid)]
        for gid in gone[:-_SPARED]:
            del self._sources[gid]
        while len(self._sources) >= _MAX_SOURCES:
            self._take_held(self._sources.pop(next(iter(self._sources))))
        self._room = min(2 * (len(self._sources) + _SPARED), _MAX_SOURCES)

    def _refuse(self, reason: str, why: str) -> None:
        level = logging.DEBUG if self.refused or self._on_refused is not None else logging.WARNING
        self.refused += 1
        _log.log(level, "%s: sample left out: %s", self.topic, why)
        if self._on_refused is not None:
            self._on_refused(reason, why)
