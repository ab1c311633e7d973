"""A subscription on the hub."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection
from functools import partial
from threading import Lock

import zenoh

from bridge.hub.endpoints.context import EndpointContext
from bridge.hub.endpoints.publisher import NO_LANE
from bridge.hub.endpoints.subscribed_keys import SubscribedKeys
from bridge.hub.endpoints.variants import CONVERTED, RELAYED, Convert, ConvertedSample
from bridge.hub.errors import HubWireError
from bridge.hub.graph import HubGraph
from bridge.hub.lane.lent import LentPayload
from bridge.hub.lane.numbering import Track
from bridge.hub.wire.keys import ANY_HASH, GID_SIZE, key_type, unpack_attachment
from bridge.hub.zenoh_compat import keep_thread_state, subscribe, undeclare
from bridge.messages.errors import ConversionError
from bridge.messages.unchanged import same
from bridge.resources import LARGE_MESSAGES

_log = logging.getLogger(__name__)
_MAX_SOURCES = 4096
_SPARED = 64
"""Maximum number of publishers outside the graph whose state is kept, and maximum number of sources in `Losses`."""
_MAX_GAP = 1_000_000

MAX_HELD_BYTES = 256 << 20
"""Maximum size in bytes of one subscription's held samples, including `OVERHEAD` for each sample."""

OVERHEAD = 256
"""Bytes that a held sample uses in addition to its payload."""

_CURE = (
    "limit the topic's rate with a rule, or if the messages are large raise, in hub.zenoh of the sender's machine,"
    " transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments (docs/sides/hub.md, Congestion)"
)

Refused = Callable[[str, str], None]
"""``refused(reason, why)``: a sample was refused; ``reason`` is ``bad`` or ``large``, ``why`` is for people."""


class HubSample:
    """A received message.

    Attributes:
        payload: zenoh's buffer or a message that a lane has lent, which is not copied yet, or the bytes from a lane.
        gid: the publisher's 16-byte id.
        zid: the publisher's session, "" if it is unknown.
    """

    __slots__ = ("gid", "payload", "sequence", "source_time_ns", "zid")

    def __init__(
        self, payload: zenoh.ZBytes | LentPayload | bytes, sequence: int, source_time_ns: int, gid: bytes, zid: str
    ) -> None:
        self.payload = payload
        self.sequence = sequence
        self.source_time_ns = source_time_ns
        self.gid = gid
        self.zid = zid

    def data(self) -> bytes:
        """Return the payload: CDR with its encapsulation header."""
        payload = self.payload
        if not isinstance(payload, bytes):
            payload = self.payload = payload.to_bytes()
        return payload


class PublisherState(Track):
    """The state that a subscription stores for one publisher.

    Attributes:
        sequence, time_ns: number and source time of the last sample that was delivered; None before.
        held: the samples that wait for earlier ones, by number.
        paired: the publisher belongs to a worker of this daemon, and may use both transports at the same time.
        sparse: the publisher's numbers also count samples that it sends to other keys, so that gaps are not losses.
        queried: number of the newest sample before which missing samples were queried.
    """

    __slots__ = ("paired", "queried", "sparse", "zid")

    def __init__(self, zid: str) -> None:
        super().__init__()
        self.zid = zid
        self.paired = self.sparse = False
        self.queried = 0

    def accept(self, sample: HubSample) -> int | None:
        """Mark a sample as delivered unless it already was; return the result of `gap`."""
        last, number = self.sequence, sample.sequence
        missing = 0 if last is not None and number == last + 1 else self.gap(sample)
        if missing is not None:
            self.sequence, self.time_ns = number, sample.source_time_ns
        return missing

    def gap(self, sample: HubSample) -> int | None:
        """Return the number of samples missing before this one, None if it is a duplicate or arrives out of order.

        The number is 0 if gaps do not count as losses, or the publisher restarted its numbers.
        """
        last = self.sequence
        if last is None:
            return 0
        if sample.sequence <= last:
            # unless the sample is older or repeats the last one, its publisher restarted its numbers with the same GID
            again = sample.sequence == last and sample.source_time_ns == self.time_ns
            return None if again or 0 < sample.source_time_ns <= self.time_ns else 0
        missing = sample.sequence - last - 1
        return missing if missing < _MAX_GAP and not self.sparse else 0


class PublisherStates(dict[bytes, PublisherState]):
    """A subscription's state for each publisher, by GID; of publishers that have left, only the newest are stored.

    Not thread-safe: the lock of the subscription guards it, with the states and the held samples.

    Attributes:
        held_bytes: size of all held samples in bytes, including `OVERHEAD` for each sample.
    """

    def __init__(self, graph: HubGraph) -> None:
        super().__init__()
        self._graph = graph
        self._room = 2 * _SPARED
        self.held_bytes = 0

    def of(self, message: HubSample, sample: zenoh.Sample | ConvertedSample) -> PublisherState:
        """Return the state of a sample's publisher; set the session of the state and of the message."""
        source = self.get(message.gid) or self.add(message.gid)
        if not source.zid:
            info = sample.source_info
            source.zid = self._graph.zid_of(message.gid) if info is None else str(info.source_id.zid)
        message.zid = source.zid
        return source

    def add(self, gid: bytes, zid: str = "") -> PublisherState:
        """Create and return the state of a new publisher."""
        if len(self) >= self._room:
            self._make_room()
        source = self[gid] = PublisherState(zid)
        return source

    def _make_room(self) -> None:
        """Drop publishers that are not in the graph, except the newest: those of zenoh-ros2-sdk are never in it."""
        departed = [gid for gid, source in self.items() if not source.held and not self._graph.zid_of(gid)]
        for gid in departed[:-_SPARED]:
            del self[gid]
        while len(self) >= _MAX_SOURCES:
            self.pop_all_held(self.pop(next(iter(self))))
        self._room = min(2 * (len(self) + _SPARED), _MAX_SOURCES)

    def hold(self, source: PublisherState, message: HubSample) -> bool:
        """Hold a sample; return False if the limit is reached."""
        if message.sequence in source.held:
            return True
        if self.held_bytes + len(message.payload) + OVERHEAD > MAX_HELD_BYTES:
            return False
        self.hold_anyway(source, message)
        return True

    def hold_anyway(self, source: PublisherState, message: HubSample) -> None:
        """Hold a sample for a moment, regardless of the limit."""
        source.held[message.sequence] = message
        self.held_bytes += len(message.payload) + OVERHEAD

    def pop_held(self, source: PublisherState, number: int) -> HubSample:
        """Remove and return one held sample."""
        message: HubSample = source.held.pop(number)
        self.held_bytes -= len(message.payload) + OVERHEAD
        return message

    def pop_all_held(self, source: PublisherState) -> list[HubSample]:
        """Remove and return the held samples of a publisher, in order."""
        return [self.pop_held(source, number) for number in sorted(source.held)]


class Losses:
    """Counts, by publisher and session, the samples that were numbered but never arrived.

    Not thread-safe: the lock of the subscription guards it.
    """

    def __init__(self) -> None:
        self.count = 0
        self._sources: Counter[tuple[bytes, str]] = Counter()

    def add(self, count: int, message: HubSample) -> None:
        """Count the samples that are missing before one that has arrived."""
        self.count += count
        self._sources[message.gid, message.zid] += count
        while len(self._sources) > _SPARED:
            del self._sources[next(iter(self._sources))]

    def sources(self) -> dict[tuple[bytes, str], int]:
        """Return a copy of the counts by publisher and session."""
        return dict(self._sources)


class SampleReader:
    """Reads the samples that zenoh delivers to one subscription, and refuses those that it must not deliver.

    Any number of threads may read at once. Only `close` uses the lock, so it never waits for a callback.

    Attributes:
        limit: maximum size of a message in bytes.
        originals: whether it ignores samples that their publisher converted to another version of the type.
        refused: number of samples that are too large, lack a valid attachment or cannot be converted.
        closed: whether it has stopped reading samples.
    """

    def __init__(self, topic: str, own: Collection[bytes], limit: int, on_refused: Refused | None) -> None:
        self._topic, self._own, self.limit, self._on_refused = topic, own, limit, on_refused
        self.originals = False
        self.refused = 0
        self.closed = False
        self._closing = Lock()

    def close(self) -> bool:
        """Stop reading samples; return whether this is the first call."""
        with self._closing:
            before, self.closed = self.closed, True
        return not before

    def read(self, sample: zenoh.Sample | ConvertedSample) -> HubSample | None:
        """Return a sample, whose session is not set yet; None if it must not be delivered."""
        keep_thread_state()
        encoding = sample.encoding
        if self.closed or encoding == RELAYED or (self.originals and encoding == CONVERTED):
            return None
        payload, attachment = sample.payload, sample.attachment
        size = len(payload)
        if not size and sample.kind != zenoh.SampleKind.PUT:
            return None
        if attachment is None:
            self.refuse("bad", "a sample without rmw_zenoh's attachment")
            return None
        if size > self.limit:
            self.refuse("large", f"message of {size} bytes, the limit is {self.limit}")
            return None
        LARGE_MESSAGES.passed(size)
        try:
            sequence, time_ns, gid = unpack_attachment(attachment.to_bytes())
        except HubWireError as err:
            self.refuse("bad", str(err))
            return None
        if gid in self._own:
            return None
        return HubSample(payload, sequence, time_ns, gid, "")

    def refuse(self, reason: str, why: str) -> None:
        """Count a refused sample, and report it; see `Refused`."""
        level = logging.DEBUG if self.refused or self._on_refused is not None else logging.WARNING
        self.refused += 1
        _log.log(level, "%s: sample refused: %s", self._topic, why)
        if self._on_refused is not None:
            self._on_refused(reason, why)


class HubSubscription:
    """Receives one topic; created by `bridge.hub.node.Hub.subscription`. This class is for volatile topics.

    Locks: ``_lock`` guards ``sources`` and the losses. `close` never acquires it, because the caller of `close` may
    hold a lock for which the callback waits.

    Attributes:
        sources: the state of each publisher.
        way: the transport, ``lane`` or ``zenoh``.
        why: the reason for using zenoh, "" for the lane.
    """

    way = "zenoh"
    why = NO_LANE

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        topic: str,
        callback: Callable[[HubSample], None],
        on_refused: Refused | None = None,
        *,
        exact: bool = False,
        grouped: bool = False,
    ) -> None:
        self.topic = topic
        self._graph, self._on_close = context.graph, context.closed
        self._callback = callback
        self._reader = SampleReader(topic, context.own, context.limit, on_refused)
        self._reader.originals = key_type(key)[1] == ANY_HASH
        self._lock = Lock()
        self.sources = PublisherStates(context.graph)
        self._losses = Losses()
        self._undeclare: Callable[[], None] = (lambda: None) if grouped else self._declare(context, key)
        self._keys = SubscribedKeys(
            context, token, key, topic, partial(self._declare_more, context), partial(self._declare_group, context)
        )
        context.variants.add(self._keys, token, exact=exact)
        self._keys.announce()

    def _declare(self, context: EndpointContext, key: str) -> Callable[[], None]:
        """Subscribe on zenoh; return a function that ends the subscription.

        zenoh's receiving thread runs the callback directly, without a thread per subscription, because the callback
        only appends and wakes.
        """
        return partial(undeclare, subscribe(context.session, key, self._on_sample, context.reach))

    def _declare_group(self, context: EndpointContext, key: str, convert: Convert) -> Callable[[], None]:
        """Subscribe to a CPU group of the topic on zenoh; return a function that ends the subscription."""
        receive = partial(self._on_grouped, self._receiver(convert))
        return partial(undeclare, subscribe(context.session, key, receive, context.reach))

    def _receiver(self, convert: Convert) -> Callable[[zenoh.Sample], None]:
        """Return a function that receives samples after a conversion."""
        return self._on_sample if convert is same else partial(self._on_other, convert, self._on_sample)

    def _on_grouped(self, receive: Callable[[zenoh.Sample], None], sample: zenoh.Sample) -> None:
        """Handle a sample of a CPU group: its publisher also counts what it publishes on other keys."""
        if sample.attachment is not None:
            gid = sample.attachment.to_bytes()[-GID_SIZE:]
            with self._lock:
                source = self.sources.get(gid) or self.sources.add(gid)
                source.sparse = True
        receive(sample)

    def _declare_more(self, context: EndpointContext, key: str, convert: Convert) -> Callable[[], None]:
        """Subscribe to an additional key on zenoh; return a function that ends the subscription."""
        return partial(undeclare, subscribe(context.session, key, self._receiver(convert), context.reach))

    def _on_other(self, convert: Convert, receive: Callable[[ConvertedSample], None], sample: zenoh.Sample) -> None:
        """Convert a sample of another version of the type, and pass it on."""
        size = len(sample.payload)
        if size > self._reader.limit:
            self._reader.refuse("large", f"message of {size} bytes, the limit is {self._reader.limit}")
            return
        try:
            converted = ConvertedSample(sample, convert)
        except ConversionError as err:
            self._reader.refuse("bad", str(err))
            return
        receive(converted)

    @property
    def by_lane(self) -> int:
        """Number of samples that arrived over the lane."""
        return 0

    def hand_to(self, acceptor: object) -> None:
        """Let an object with the attribute ``acceptor`` handle the plain messages of a lane (``receiving.h``)."""

    def close(self) -> None:
        """Stop receiving. Safe to call twice."""
        if self._reader.close():
            self._keys.close()
            self._undeclare()
            self._on_close(self)

    def request_again(self, gid: bytes, zid: str, forget: Callable[[], None]) -> None:
        """Deliver again the samples that a latched publisher of a session caches; other publishers cache none.

        ``forget`` is called to drop the publisher's samples that the callback has received; none arrives meanwhile.
        """

    def _on_sample(self, sample: zenoh.Sample | ConvertedSample) -> None:
        message = self._reader.read(sample)
        if message is None:
            return
        # zenoh may call from several threads at once, one per link
        with self._lock:
            source = self.sources.get(message.gid)
            if source is None or not source.zid:
                source = self.sources.of(message, sample)
            message.zid = source.zid
            gap = source.accept(message)
            if gap is None:
                return
            if gap:
                self._losses.add(gap, message)
        self._callback(message)

    @property
    def refused(self) -> int:
        """Number of samples that are too large, lack a valid attachment or cannot be converted."""
        return self._reader.refused

    @property
    def lost(self) -> int:
        """Number of samples that publishers numbered but that never arrived."""
        return self._losses.count

    def losses(self) -> str:
        """Return why messages were lost and how to avoid losses, "" if none were lost."""
        with self._lock:
            lost = self._losses.sources()
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
