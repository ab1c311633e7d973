"""A subscription on the hub."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from threading import Lock

import zenoh

from bridge.hub.endpoints.latched import LatchedHistory
from bridge.hub.endpoints.publisher import NO_LANE, EndpointContext, cache_depth
from bridge.hub.errors import HubWireError
from bridge.hub.wire.keys import unpack_attachment
from bridge.hub.wire.qos import Qos, Reliability
from bridge.hub.zenoh_compat import keep_thread_state, subscribe, undeclare
from bridge.resources import LARGE_MESSAGES

_log = logging.getLogger(__name__)
_MAX_SOURCES = 4096
_SPARED = 64
"""Maximum number of publishers that are remembered although they are not on the graph."""
_MAX_GAP = 1_000_000
_MAX_HELD = 1000
"""Maximum number of held samples of one publisher, beyond its history."""

MAX_HELD_BYTES = 256 << 20
"""Maximum bytes of one subscription's held samples, with `OVERHEAD` for each of them."""

OVERHEAD = 256
"""Bytes that a held sample uses in addition to its payload."""

_CURE = (
    "limit the topic's rate by a rule, or where the messages are large raise, in hub.zenoh of the sender's machine,"
    " transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments (docs/sides/hub.md, Congestion)"
)

Refused = Callable[[str, str], None]
"""``refused(reason, why)``: a sample was refused; ``reason`` is ``bad`` or ``large``, ``why`` is for people."""


class HubSample:
    """One received message.

    Attributes:
        payload: zenoh's bytes, not copied yet.
        gid: the publisher's 16-byte id.
        zid: its session, "" if it is unknown.
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


class PublisherState:
    """A subscription's state of one publisher; a ``paired`` one is ours, and may send over both transports at once."""

    __slots__ = ("held", "paired", "sequence", "time_ns", "zid")

    def __init__(self, zid: str) -> None:
        self.zid = zid
        self.paired = False
        self.sequence: int | None = None
        self.time_ns = 0
        self.held: dict[int, HubSample] = {}

    def accept(self, sample: HubSample) -> int | None:
        """Mark a sample as delivered; return the result of `gap`, None if it must not be delivered."""
        last, number = self.sequence, sample.sequence
        missing = 0 if last is not None and number == last + 1 else self.gap(sample)
        if missing is not None:
            self.sequence, self.time_ns = number, sample.source_time_ns
        return missing

    def gap(self, sample: HubSample) -> int | None:
        """Return the number of samples missing before this one, None if it was delivered already."""
        last = self.sequence
        if last is None:
            return 0
        if sample.sequence <= last:
            # a publisher that keeps its GID restarted its numbers, unless the sample is older
            return None if 0 < sample.source_time_ns <= self.time_ns else 0
        missing = sample.sequence - last - 1
        return missing if missing < _MAX_GAP else 0


class HubSubscription:
    """Receives one topic; made by `bridge.hub.session.Hub.subscription`.

    Attributes:
        lost: samples that publishers numbered and that never came.
        refused: samples left out: without a fitting attachment, or too large.
        way: ``lane`` or ``zenoh``.
        why: the reason if it is not the lane, otherwise "".
        by_lane: samples that came by the lane.
        sources: the publishers that it heard, by GID; of those that left the newest.
    """

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        topic: str,
        qos: Qos,
        callback: Callable[[HubSample], None],
        on_refused: Refused | None = None,
    ) -> None:
        self.topic = topic
        self.lost = self.refused = self.by_lane = 0
        self.way = "zenoh"
        self.why = "a latched topic" if qos.latched else NO_LANE
        self._graph, self._limit, self._on_close = context.graph, context.limit, context.closed
        self._own = context.own
        self._depth = cache_depth(qos)
        self._recovers = qos.latched and qos.reliability is Reliability.RELIABLE
        self._callback, self._on_refused = callback, on_refused
        self._lost_from: Counter[tuple[bytes, str]] = Counter()
        self.sources: dict[bytes, PublisherState] = {}
        self._room = 2 * _SPARED
        self._asked: Counter[str] = Counter()
        self._held = 0
        # never acquired by `close`, whose caller may hold a lock that the callback waits for
        self._lock = Lock()
        self._closing = Lock()
        self._closed = False
        self._history = LatchedHistory(
            context.session, key, self._depth, self, context.asking, context.heartbeats,
            reach=context.reach, recovers=self._recovers,
        )  # fmt: skip
        # direct: without a thread per subscription; zenoh's receiving thread only appends and wakes
        self._came = self._on_latched if qos.latched else self._on_sample
        self._subscriber = subscribe(context.session, key, self._came, context.reach)
        if qos.latched:
            self._history.open()
        self._withdraw = context.graph.announce(token)

    def close(self) -> None:
        """Stop receiving. Safe to call twice."""
        with self._closing:
            closed, self._closed = self._closed, True
        if not closed:
            self._withdraw()
            self._undeclare()
            self._history.close()
            self._on_close(self)

    def _undeclare(self) -> None:
        undeclare(self._subscriber)

    # -- volatile ------------------------------------------------------------------------------------------------------

    def _on_sample(self, sample: zenoh.Sample) -> None:
        message = self._read(sample)
        if message is None:
            return
        # zenoh may call from several threads at once, one per link
        with self._lock:
            source = self.sources.get(message.gid)
            if source is None or not source.zid:
                source = self._source(message, sample)
            message.zid = source.zid
            gap = source.accept(message)
            if gap is None:
                return
            if gap:
                self._missed(gap, message)
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
            if gap is None:
                return
            # of a publisher with a history of one, only the newest sample counts
            deep = self._depth > 1 and len(source.held) < self._depth + _MAX_HELD
            # a live sample may arrive before its publisher's token, which triggers the query
            past = gap > 0 if source.sequence is not None else message.sequence > 1
            missing = deep and past and bool(zid) and (self._recovers or source.sequence is None)
            if not ((missing or (deep and self._asked[zid])) and self._hold(source, message)):
                self._release(source)
                self._deliver(source, message)
            missing = missing and not self._asked[zid]
        if missing:
            self._history.ask_session(zid)

    def asked(self, zid: str) -> None:
        """Handle the start of a query for the samples that a session's publishers store; see `LatchedHistory`."""
        with self._lock:
            self._asked[zid] += 1

    def on_stored(self, sample: zenoh.Sample) -> None:
        """Handle one of the samples that a publisher stores; see `LatchedHistory`."""
        message = self._read(sample)
        if message is None:
            return
        self._history.saw(sample.source_info)
        with self._lock:
            source = self._source(message, sample)
            if source.gap(message) is None:
                return
            if not self._hold(source, message):
                self._refuse("large", f"more than {MAX_HELD_BYTES} bytes are stored for late joiners")

    def done(self, zid: str) -> None:
        """Handle the end of a query; see `LatchedHistory`."""
        with self._lock:
            self._asked[zid] -= 1
            if self._asked[zid] > 0:
                return
            del self._asked[zid]
            for source in self.sources.values():
                if source.held and not self._asked[source.zid]:
                    self._release(source)

    def _hold(self, source: PublisherState, message: HubSample) -> bool:
        """Hold a sample; return False if the limits are reached."""
        size = self._weight(message)
        if self._held + size > MAX_HELD_BYTES or message.sequence in source.held:
            return message.sequence in source.held
        source.held[message.sequence] = message
        self._held += size
        return True

    def _take_held(self, source: PublisherState) -> dict[int, HubSample]:
        held, source.held = source.held, {}
        self._held -= sum(map(self._weight, held.values()))
        return held

    @staticmethod
    def _weight(message: HubSample) -> int:
        return len(message.payload) + OVERHEAD

    def _release(self, source: PublisherState) -> None:
        held = self._take_held(source)
        for sequence in sorted(held):
            self._deliver(source, held[sequence])

    def _deliver(self, source: PublisherState, message: HubSample) -> None:
        gap = None if self._closed else source.accept(message)
        if gap is not None:
            if gap:
                self._missed(gap, message)
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
            self._refuse("bad", "a sample without rmw_zenoh's attachment")
            return None
        if size > self._limit:
            self._refuse("large", f"message of {size} bytes, the limit is {self._limit}")
            return None
        LARGE_MESSAGES.passed(size)
        try:
            sequence, time_ns, gid = unpack_attachment(attached.to_bytes())
        except HubWireError as err:
            self._refuse("bad", str(err))
            return None
        if gid in self._own:
            return None
        return HubSample(payload, sequence, time_ns, gid, "")

    def _missed(self, count: int, message: HubSample) -> None:
        self.lost += count
        self._lost_from[message.gid, message.zid] += count
        while len(self._lost_from) > _SPARED:
            del self._lost_from[next(iter(self._lost_from))]

    def losses(self) -> str:
        """Return why messages were lost and what to do, "" if none were."""
        with self._lock:
            lost = dict(self._lost_from)
        if not lost:
            return ""
        names = {endpoint.gid: endpoint.node for endpoint in self._graph.publishers(self.topic)}
        sessions: dict[str, list[str]] = {}
        for node in self._graph.nodes():
            sessions.setdefault(node.zid, []).append(node.node)
        places = Counter[str]()
        for (gid, zid), count in lost.items():
            places[names.get(gid) or " or ".join(sessions.get(zid, [])) or zid or "an unknown node"] += count
        text = ", ".join(f"{count} from {place}" for place, count in places.items())
        return f"lost on the hub's links, which were busy for too long: {text}; {_CURE}"

    def _source(self, message: HubSample, sample: zenoh.Sample) -> PublisherState:
        source = self.sources.get(message.gid)
        if source is None:
            source = self._new_source(message.gid)
        if not source.zid:
            info = sample.source_info
            source.zid = self._graph.zid_of(message.gid) if info is None else str(info.source_id.zid)
        message.zid = source.zid
        return source

    def _new_source(self, gid: bytes) -> PublisherState:
        if len(self.sources) >= self._room:
            self._make_room()
        source = self.sources[gid] = PublisherState("")
        return source

    def _make_room(self) -> None:
        """Drop publishers that have left; some participants (zenoh-ros2-sdk) were never on the graph."""
        departed = [gid for gid, source in self.sources.items() if not source.held and not self._graph.zid_of(gid)]
        for gid in departed[:-_SPARED]:
            del self.sources[gid]
        while len(self.sources) >= _MAX_SOURCES:
            self._take_held(self.sources.pop(next(iter(self.sources))))
        self._room = min(2 * (len(self.sources) + _SPARED), _MAX_SOURCES)

    def _refuse(self, reason: str, why: str) -> None:
        level = logging.DEBUG if self.refused or self._on_refused is not None else logging.WARNING
        self.refused += 1
        _log.log(level, "%s: sample refused: %s", self.topic, why)
        if self._on_refused is not None:
            self._on_refused(reason, why)
