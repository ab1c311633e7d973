"""A publisher on the hub."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from enum import Enum
from functools import partial
from threading import Lock
from typing import Any, ClassVar, Protocol

import zenoh

from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.endpoints.latched import LatchedPublisher
from bridge.hub.endpoints.variants import CONVERTED, Convert, KeyVariants, Variants
from bridge.hub.errors import HubClosedError, HubError, zenoh_reason
from bridge.hub.graph import HubGraph
from bridge.hub.graph.tokens import gid_of
from bridge.hub.lane.joining import flush_joined
from bridge.hub.lane.lane import Lane
from bridge.hub.lane.outlet import Outlet
from bridge.hub.lane.writer import LaneWriter
from bridge.hub.opening import prepare_to_send
from bridge.hub.wire.keys import ATTACHMENT, GID_SIZE, key_type, key_variant
from bridge.hub.wire.qos import History, Qos, Reliability
from bridge.hub.zenoh_compat import BEHIND, keep_thread_state, source_infos, undeclare
from bridge.hub.zenoh_config import POOL
from bridge.messages.errors import ConversionError
from bridge.messages.unchanged import same
from bridge.resources import LARGE_MESSAGES

KEEP_ALL_CACHE = 1000
"""Samples that a latched publisher caches if its history is unlimited."""
MAX_CACHE = 10_000

LARGE = POOL
"""Size in bytes above which a message does not fit into the shared memory, and needs hundreds of packets on a link."""


_log = logging.getLogger(__name__)
_pack = ATTACHMENT.pack

NO_LANE = "this worker has no lane"

QUEUE = 1000
"""Default limit of the messages on one key that wait for a lane's reader whose buffer is full; for commands it is 1."""


@dataclass(frozen=True, slots=True)
class EndpointContext:
    """The objects and settings that the endpoints of one node share.

    Attributes:
        reach: which endpoints are reached: those of other sessions, or also those of a shared session's other nodes.
        own: GIDs of the node's endpoints, whose messages its subscriptions and servers ignore; the set changes.
        limit: maximum size of a message in bytes.
        executor: runs calls that may wait for zenoh.
        ends: handles the ends of queries; see `bridge.hub.zenoh_compat`.
        asking: runs queries for the samples that latched publishers cache.
        delays: makes delayed calls, for example for the heartbeats of latched publishers.
        variants: assigns additional keys to the endpoints.
        closed: called with each endpoint that has closed.
        lane: the transport to this daemon's other workers; None if the session has no lane.
    """

    session: zenoh.Session
    reach: zenoh.Locality
    own: Collection[bytes]
    graph: HubGraph
    limit: int
    executor: SerialExecutor
    ends: SerialExecutor
    asking: SerialExecutor
    delays: DelayedCalls
    variants: KeyVariants
    closed: Callable[[Any], None]
    lane: Lane | None = None


class SamplePriority(Enum):
    """The zenoh priority of commands, states and streams."""

    COMMAND = zenoh.Priority.INTERACTIVE_HIGH
    STATE = zenoh.Priority.DATA_HIGH
    STREAM = zenoh.Priority.DATA


class _Sink(Protocol):
    keeps: ClassVar[bool]
    """Whether it caches samples for late joiners."""

    def send(self, payload: bytes, attachment: bytes) -> None: ...
    def matched(self) -> bool: ...
    def close(self) -> None: ...


def _matching(publisher: zenoh.Publisher) -> bool:
    # an object that is always truthy, although the wheel's stubs declare a bool
    status: Any = publisher.matching_status
    return bool(status.matching)


class _Matching:
    """Whether another session subscribes to a publisher's key.

    A put without a subscriber costs a worker 14 us, and a query of the matching status 7 us, mostly because the memory
    that they use is no longer in the processor's caches. So a listener follows the changes. The listener may be late:
    in 1 case of 100, zenoh called it only after queries that the new subscriber sent after its declaration had been
    answered. The status is as recent as zenoh's routes. So if the listener reports no subscriber, the status is queried
    too: in `now` always, and in `reaches` once after each change of the graph, because the token that announces a
    subscriber follows its declaration.
    """

    def __init__(self, publisher: zenoh.Publisher, graph: HubGraph) -> None:
        self._publisher, self._graph = publisher, graph
        self._listener: Any = None
        self._reported: dict[str, bool] = {}
        self._absent: object = None
        """The graph's epoch in which a query found no subscriber."""

    def reaches(self) -> bool:
        """Return whether a put might reach a subscriber; not safe for two threads at once."""
        epoch = self._graph.epoch
        if self._absent is epoch and not self._reported[""]:
            return False
        if self.now():
            return True
        self._absent = epoch
        return False

    def now(self) -> bool:
        """Return whether a put would reach a subscriber now or a moment ago; not safe for two threads at once."""
        if self._listener is None:
            self._listener = self._publisher.declare_matching_listener(
                zenoh.handlers.Callback(self._on_changed, indirect=False)
            )
            # atomic in CPython, so that this older state does not replace a change reported meanwhile
            self._reported.setdefault("", _matching(self._publisher))
        if self._reported[""]:
            return True
        if _matching(self._publisher):
            self._absent = None
            return True
        return False

    def _on_changed(self, status: Any) -> None:
        """Store a reported change; runs on a zenoh thread."""
        keep_thread_state()
        self._reported[""] = bool(status.matching)

    def close(self) -> None:
        if self._listener is not None:
            undeclare(self._listener)


class _Version:
    """Converts messages to the version of the type that one key stands for."""

    def __init__(self, key: str, convert: Convert) -> None:
        self._key, self._convert = key, convert
        self._level = logging.WARNING

    def __call__(self, payload: bytes) -> bytes | None:
        """Return the converted message; None if the version cannot represent a value, which is logged once."""
        try:
            return self._convert(payload)
        except ConversionError as err:
            text = "%s: a message is not published in another version of its type: %s; further messages are not logged"
            _log.log(self._level, text, self._key, err)
            self._level = logging.DEBUG
            return None


class _PlainSink:
    """A volatile publisher, which caches nothing."""

    keeps: ClassVar[bool] = False

    def __init__(
        self, context: EndpointContext, key: str, options: PublisherOptions, convert: Convert | None = None
    ) -> None:
        self._convert = None if convert is None else _Version(key, convert)
        self._declare = partial(
            context.session.declare_publisher, key, allowed_destination=context.reach, encoding=_encoding(convert)
        )
        self._publisher = self._declare(
            congestion_control=options.congestion, priority=options.priority, express=options.express
        )
        self._large: zenoh.Publisher | None = None
        self._matching = _Matching(self._publisher, context.graph)
        self._blocks = options.congestion is zenoh.CongestionControl.BLOCK
        self._put = self._publisher.put
        # the large publisher continues the count under the same id, so that subscribers see one source without gaps
        self._infos = source_infos(self._publisher)

    def send(self, payload: bytes, attachment: bytes) -> None:
        if self._blocks:
            flush_joined()
        if not self._matching.reaches():
            return
        if self._convert is not None:
            converted = self._convert(payload)
            if converted is None:
                return
            payload = converted
        if len(payload) > LARGE and self._large is None and not self._blocks:
            # later messages use this publisher too, so that none overtakes the large message
            self._large = self._declare(congestion_control=zenoh.CongestionControl.DROP, priority=BEHIND)
            self._put = self._large.put
        prepare_to_send(len(payload))
        self._put(payload, attachment=attachment, source_info=next(self._infos))

    def matched(self) -> bool:
        return self._matching.now()

    def close(self) -> None:
        self._matching.close()
        for publisher in (self._publisher, self._large):
            if publisher is not None:
                undeclare(publisher)


class _LatchedSink:
    """A transient-local publisher, which caches its last samples for late joiners."""

    keeps: ClassVar[bool] = True

    def __init__(
        self, context: EndpointContext, key: str, options: PublisherOptions, qos: Qos, convert: Convert | None = None
    ) -> None:
        self._convert = None if convert is None else _Version(key, convert)
        reliable = qos.reliability is Reliability.RELIABLE
        depth = cache_depth(qos)
        # zenoh's buffers, which its cache shares; they are published on keys that are added later
        self.stored: deque[tuple[zenoh.ZBytes, bytes]] = deque(maxlen=depth)
        self._publisher = LatchedPublisher(
            context.session,
            key,
            depth,
            context.delays if reliable else None,
            reach=context.reach,
            congestion=options.congestion,
            priority=options.priority,
            express=options.express,
            encoding=_encoding(convert),
        )
        # the wheel's AdvancedPublisher does not show whether it is matched
        self._shadow = context.session.declare_publisher(key, allowed_destination=context.reach)

    def send(self, payload: bytes, attachment: bytes) -> None:
        self._send(zenoh.ZBytes(payload), attachment)

    def _send(self, payload: zenoh.ZBytes, attachment: bytes) -> None:
        self.stored.append((payload, attachment))
        if self._convert is not None:
            converted = self._convert(payload.to_bytes())
            if converted is None:
                return
            payload = zenoh.ZBytes(converted)
        self._publisher.put(payload, attachment)

    def restore(self, samples: Iterable[tuple[zenoh.ZBytes, bytes]]) -> None:
        """Publish and cache the samples of another sink."""
        for payload, attachment in samples:
            self._send(payload, attachment)

    def matched(self) -> bool:
        return _matching(self._shadow)

    def close(self) -> None:
        undeclare(self._shadow)
        self._publisher.close()


def _encoding(convert: Convert | None) -> zenoh.Encoding | None:
    return None if convert is None else CONVERTED


class PublisherOptions:
    """How zenoh transports a publisher's samples.

    As in rmw_zenoh, samples are dropped on a congested link, and only RELIABLE with KEEP_ALL blocks, because one slow
    peer must not delay the others. A reliable latched subscription recovers dropped samples from the publisher's cache.
    """

    def __init__(self, qos: Qos, priority: str, express: bool | None, queue: int | None = None) -> None:
        self.blocks = qos.reliability is Reliability.RELIABLE and qos.history is History.KEEP_ALL
        self.congestion = zenoh.CongestionControl.BLOCK if self.blocks else zenoh.CongestionControl.DROP
        self.priority: zenoh.Priority = SamplePriority[priority.upper()].value
        self.express = self.priority == SamplePriority.COMMAND.value if express is None else express
        self.queue = queue or (1 if self.priority == SamplePriority.COMMAND.value else QUEUE)


def cache_depth(qos: Qos) -> int:
    """Return how many samples a latched publisher with this QoS caches, and a latched subscription requests."""
    return KEEP_ALL_CACHE if qos.history is History.KEEP_ALL else min(max(qos.depth, 1), MAX_CACHE)


class HubPublisher:
    """Publishes one topic on the hub; created by `bridge.hub.session.Hub.publisher`. Safe to use from any thread.

    Each sample is published with the same number on all of the publisher's keys (`bridge.hub.endpoints.variants`), so
    that a subscription that receives it on two of them delivers it only once.

    Attributes:
        gid: the 16 bytes that identify the publisher in its samples.
        by_lane: number of messages sent on at least one lane.
    """

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        topic: str,
        qos: Qos,
        options: PublisherOptions,
    ) -> None:
        self.topic, self.key = topic, key
        self.gid = gid_of(token)
        self._command, self._queue = options.priority == SamplePriority.COMMAND.value, options.queue
        self._outlets: tuple[Outlet, ...] = ()
        self._writer: LaneWriter | None = None
        self._why = NO_LANE
        self.by_lane = 0
        self._limit, self._on_close = context.limit, context.closed
        self._lock = Lock()
        self._sequence = 0
        self._plain = partial(_PlainSink, context, options=options)
        self._stored: _LatchedSink | None = None
        if qos.latched:
            self._latched = partial(_LatchedSink, context, options=options, qos=qos)
            self._base: _Sink = (stored := self._latched(key))
            self._stored = stored
            self._why = "messages are stored for late joiners"
        else:
            self._base = self._plain(key)
            if context.lane is not None and not options.blocks:
                self._writer = context.lane.writer
                self._why = context.lane.why
        self._more: dict[str, _Sink] = {}  # by type hash
        self._sinks: tuple[_Sink, ...] = (self._base,)
        """The sinks of all keys; empty once the publisher is closed."""
        # register with the variants and the lane before the token announces the publisher
        self._variants = context.variants
        self._variants.add(self, token)
        if self._writer is not None:
            self._writer.add(self)
        self._withdraw = context.graph.announce(token)

    def put(self, payload: bytes, source_time_ns: int | None = None) -> None:
        """Publish CDR bytes, which begin with the encapsulation header.

        ``source_time_ns`` is the message's source timestamp (system time), by default now. Raises `HubClosedError` if
        the publisher or its session is closed, and `HubError` if the message is larger than the hub's limit.
        """
        size = len(payload)
        if size > self._limit:
            raise HubError(f"message of {size} bytes on {self.topic}: the hub's limit is {self._limit}")
        LARGE_MESSAGES.passed(size)
        if source_time_ns is None:
            source_time_ns = time.time_ns()
        # the lock is held while sending, so that the numbers arrive in order
        with self._lock:
            if not self._sinks:
                raise HubClosedError(f"publisher of {self.topic} is closed")
            self._sequence += 1
            attachment = _pack(self._sequence, source_time_ns, GID_SIZE, self.gid)
            if self._outlets:
                self.by_lane += 1
                for outlet in self._outlets:
                    outlet.send(attachment, payload)
            try:
                for sink in self._sinks:
                    sink.send(payload, attachment)
            except zenoh.ZError as err:
                raise HubClosedError(f"cannot publish on {self.topic}: {zenoh_reason(err)}") from None

    def pass_over(self) -> bool:
        """Count a message without encoding it, if no subscription exists; return False if it has to be `put`.

        Nothing receives the messages of a volatile publisher without subscriptions. Later subscriptions see the same
        sequence numbers as if the message had been put. Raises `HubClosedError` if the publisher is closed.
        """
        with self._lock:
            if not self._sinks:
                raise HubClosedError(f"publisher of {self.topic} is closed")
            if self._outlets or self._stored is not None or self._any_matched():
                return False
            self._sequence += 1
            return True

    def matched(self) -> bool:
        """Return whether any subscription exists, in another session or on another node of a shared session."""
        with self._lock:
            return bool(self._sinks) and (bool(self._outlets) or self._any_matched())

    def _any_matched(self) -> bool:
        # called for each message; a generator would cost several times as much for one sink
        for sink in self._sinks:  # noqa: SIM110
            if sink.matched():
                return True
        return False

    def way(self) -> tuple[str, str]:
        """Return the current transport, and the reason for zenoh if it is used or the publisher cannot use the lane.

        The transport is ``lane``, ``zenoh``, ``both``, or "" if no subscription exists.
        """
        with self._lock:
            lane = bool(self._outlets)
            other = self._any_matched()
        if lane or self._writer is not None:
            return {(True, False): "lane", (True, True): "both", (False, True): "zenoh"}.get((lane, other), ""), (
                "a subscription is not on the lane" if other else ""
            )
        return ("zenoh" if other else ""), self._why

    def attach(self, outlet: Outlet) -> None:
        """Send the number of the last message on a lane, and from now on all messages."""
        with self._lock:
            outlet.command = outlet.command or self._command
            outlet.depth = max(outlet.depth, self._queue)
            if outlet not in self._outlets:
                self._outlets += (outlet,)
            outlet.mark(self.gid, self._sequence)

    def detach(self, outlet: Outlet) -> None:
        """Stop sending on a lane."""
        with self._lock:
            self._outlets = tuple(other for other in self._outlets if other is not outlet)

    def follow_variants(self, variants: Variants) -> None:
        """Publish also under the other hashes that subscriptions announce, with the cached samples for latched ones."""
        for type_hash, latched in variants.items():
            latched = latched and self._stored is not None
            sink = self._more.get(type_hash)
            if sink is None or (latched and not sink.keeps):
                key, known = key_variant(self.key, type_hash), self._variants.converter(*key_type(self.key), type_hash)
                convert = None if known is same else known
                self._replace(
                    type_hash, self._latched(key, convert=convert) if latched else self._plain(key, convert=convert)
                )
        for type_hash in self._more.keys() - variants.keys():
            self._replace(type_hash, None)

    def _replace(self, type_hash: str, sink: _Sink | None) -> None:
        stored = None if self._stored is None else self._stored.stored
        restored: set[bytes] = set()
        if stored is not None and isinstance(sink, _LatchedSink):
            # restore most samples without the lock: a congested link must not delay the messages on the other keys
            with self._lock:
                samples = tuple(stored)
            restored.update(attachment for _, attachment in samples)
            sink.restore(samples)
        with self._lock:
            closed = not self._sinks
            before = self._more.pop(type_hash, None)
            if sink is not None and not closed:
                if stored is not None and isinstance(sink, _LatchedSink):
                    sink.restore(sample for sample in stored if sample[1] not in restored)
                self._more[type_hash] = sink
            if not closed:
                self._sinks = (self._base, *self._more.values())
        if before is not None:
            before.close()
        if sink is not None and closed:
            sink.close()

    def close(self) -> None:
        """Leave the graph and drop the cached samples. Safe to call twice."""
        with self._lock:
            sinks, self._sinks = self._sinks, ()
            self._more.clear()
            self._outlets = ()
        if sinks:
            self._variants.remove(self)
            if self._writer is not None:
                self._writer.remove(self)
            for sink in sinks:
                sink.close()
            self._withdraw()  # last: a publisher that has left the graph sends late joiners nothing
            self._on_close(self)
