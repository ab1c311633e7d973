"""A topic of the hub on its way to the side."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bridge.adapters.base import EdgePublisher
from bridge.hub.graph import HubEndpoint
from bridge.hub.origin import Origin
from bridge.hub.qos import Durability, Qos, Reliability
from bridge.hub.subscription import HubSample, HubSubscription
from bridge.messages.conversion import Conversion
from bridge.messages.errors import MessageError
from bridge.routing.age import AgeGate
from bridge.routing.backlog import Backlog
from bridge.routing.joint import Joint
from bridge.routing.priority import Priority
from bridge.routing.rate import RateLimit
from bridge.routing.route import (
    BULK,
    MAX_PENDING,
    QUEUE_BYTES,
    QUEUE_DEPTH,
    RouteKey,
    TopicRoute,
    joint_qos,
    stream_depth,
)
from bridge.routing.rules import Decision
from bridge.routing.static_tf import TF_TYPE, StaticTransforms

_log = logging.getLogger(__name__)

PENDING_SECONDS = 2.0
"""How long a message of a publisher that is not known to the route waits for it."""

_STATIC = "static transforms"


@dataclass(slots=True)
class _Source:
    endpoint: HubEndpoint
    latched: bool
    age: AgeGate


class OutRoute(TopicRoute):
    """One topic and type of the hub, published on the side.

    Latched hub publishers each stay a source of their own on the side; samples of publishers that the engine did not
    name (they come from this very network, or are not yet known) do not pass. ``origin`` is where the topic's first
    publisher comes from, None for a native program of the hub.
    """

    direction = "out"

    def __init__(
        self,
        key: RouteKey,
        side_topic: str,
        origin: Origin | None,
        conversion: Conversion,
        decision: Decision,
        joint: Joint,
    ) -> None:
        super().__init__(key, key.topic, side_topic, conversion, decision)
        self.origin = origin
        self._joint = joint
        self._dispatcher = joint.small
        self._followed: tuple[Sequence[HubEndpoint], ...] = ()
        self._sources: dict[bytes, _Source] = {}
        self._refused: frozenset[bytes] = frozenset()
        self._waiting: dict[bytes, HubEndpoint] = {}
        self._kept = Backlog[HubSample](QUEUE_DEPTH[Priority.STATE], QUEUE_BYTES, self._crowded_out)
        self._natives: dict[str, _Source] = {}
        self._queue: deque[HubSample] = deque()
        self._queued_bytes = 0
        self._lock = threading.Lock()
        self._publishing = threading.Lock()
        self._pending = Backlog[HubSample](MAX_PENDING, QUEUE_BYTES, self._crowded_out)
        self._latched: EdgePublisher | None = None
        self._volatile: EdgePublisher | None = None
        self._subscription: HubSubscription | None = None
        self._static: StaticTransforms | None = None
        self._qos = Qos()
        self._limit = RateLimit(decision.rate) if decision.rate else None
        self._priority = Priority.STREAM
        self._depth = 1
        self._since_ns = 0

    def update(
        self, allowed: Sequence[HubEndpoint], refused: Sequence[HubEndpoint], waiting: Sequence[HubEndpoint] = ()
    ) -> None:
        """Follow the hub's publishers of this topic; called by the engine's loop alone.

        ``waiting``: those that may pass later, once it is known who made them or agreed who carries them. What the
        latched ones say meanwhile comes only once, and is kept for then.
        """
        followed = (allowed, refused, waiting)
        if followed != self._followed:
            self._followed = ()  # until all of it is done
            self._follow(allowed, refused, waiting)
            self._followed = followed
        self._release_kept()
        self._retry_pending()

    def _follow(
        self, allowed: Sequence[HubEndpoint], refused: Sequence[HubEndpoint], waiting: Sequence[HubEndpoint]
    ) -> None:
        current = {e.gid: e for e in allowed}
        for gone in [g for g in self._sources if g not in current]:
            source = self._sources.pop(gone)
            if source.latched and self._latched is not None and self._static is None:
                self._latched.forget(gone.hex())
        for gid, endpoint in current.items():
            if gid not in self._sources:
                self._sources[gid] = _Source(endpoint, self._is_latched(endpoint), AgeGate())
        self._refused = frozenset(e.gid for e in refused)
        self._waiting = {e.gid: e for e in waiting}
        # Some participants (zenoh-ros2-sdk) put a GID of their own making in their samples.
        self._natives = {s.endpoint.zid: s for s in self._sources.values() if s.endpoint.origin is None}
        self._advertise()
        if allowed:
            self._subscribe(joint_qos([e.qos for e in allowed]))

    def _is_latched(self, endpoint: HubEndpoint) -> bool:
        latched = self.decision.override(endpoint.qos).latched
        return latched and self.priority_of(latched=latched) is not Priority.COMMAND

    def _advertise(self) -> None:
        latched = any(s.latched for s in self._sources.values())
        self._priority = self.priority_of(latched=latched)
        self._depth = self.decision.depth or QUEUE_DEPTH[self._priority]
        if latched and self._latched is None:
            if self.hub_type == TF_TYPE:
                self._static = StaticTransforms()
            depth = 1 if self._static else max(s.endpoint.qos.depth for s in self._sources.values() if s.latched)
            self._latched = self._advertise_as(Durability.TRANSIENT_LOCAL, depth)
        if self._volatile is None and any(not s.latched for s in self._sources.values()):
            told = max(s.endpoint.qos.depth for s in self._sources.values() if not s.latched)
            depth = max(stream_depth(self.conversion.source.definition), told)
            self._volatile = self._advertise_as(Durability.VOLATILE, 1 if self._priority is Priority.COMMAND else depth)

    def _advertise_as(self, durability: Durability, depth: int) -> EdgePublisher:
        # Reliable writers are heard by reliable and by best-effort readers alike.
        qos = self.decision.override(Qos(Reliability.RELIABLE, durability, depth=min(max(depth, 1), 1000)))
        return self._joint.edge.advertise(self.side_topic, self.conversion.target, qos)

    def _subscribe(self, qos: Qos) -> None:
        if self._priority is Priority.COMMAND:
            qos = Qos(qos.reliability, Durability.VOLATILE, depth=1)
        if self._subscription is not None and qos.durability is self._qos.durability:
            return
        if self._subscription is not None:
            self._subscription.close()
        self._qos = qos
        self._since_ns = time.time_ns()
        source = self.conversion.source
        self._subscription = self._joint.hub.subscription(
            self.hub_topic, source.name, self.key.type_id, qos, self._received, self._refused_by_hub
        )

    def _refused_by_hub(self, reason: str, why: str) -> None:
        """A sample without a fitting attachment, or too large; runs on zenoh's receiving thread."""
        self.bad(why, reason)

    def _received(self, sample: HubSample) -> None:
        """Publish a small message, append a large one and wake; runs on zenoh's receiving thread.

        Messages stay in order: nothing is published here while one is queued or being published elsewhere.
        """
        size = len(sample.payload)
        with self._lock:
            if self._limit is not None and self._priority is not Priority.STATE and not self._limit.passes():
                self.counters.dropped("rate")
                return
            at_once = size <= BULK and not self._queue and self._publishing.acquire(blocking=False)
            if not at_once:
                self._append(sample, size)
            dispatcher = self._dispatcher
        if not at_once:
            dispatcher.submit(self._priority, self._next)
            return
        try:
            dispatcher.here(self._handle, sample)
        finally:
            self._publishing.release()

    def _append(self, sample: HubSample, size: int) -> None:
        self._queue.append(sample)
        self._queued_bytes += size
        while len(self._queue) > self._depth or (self._queued_bytes > QUEUE_BYTES and len(self._queue) > 1):
            self._queued_bytes -= len(self._queue.popleft().payload)
            self.counters.dropped("queue")
        if size > BULK and len(self._queue) == 1:
            self._dispatcher = self._joint.bulk

    def _next(self) -> None:
        with self._publishing:
            with self._lock:
                if not self._queue:
                    return
                sample = self._queue.popleft()
                self._queued_bytes -= len(sample.payload)
            self._handle(sample)

    def _source_of(self, sample: HubSample) -> _Source | None:
        known = self._sources.get(sample.gid)
        if known is not None or sample.gid in self._refused or sample.gid in self._waiting:
            return known
        return self._natives.get(sample.zid) if sample.zid else next(iter(self._natives.values()), None)

    def _handle(self, sample: HubSample) -> None:
        source = self._sources.get(sample.gid) or self._source_of(sample)
        if source is not None:
            self._publish(sample, source)
            return
        waiting = self._waiting.get(sample.gid)
        if waiting is not None:
            if self._is_latched(waiting):
                self._keep(sample, waiting)
        elif sample.gid not in self._refused:
            if self._priority is Priority.COMMAND:  # never kept for later
                self.counters.dropped("unknown")
            else:
                self._pending.add(sample.gid, sample, len(sample.payload))
            self._joint.wake()

    def _crowded_out(self) -> None:
        self.counters.dropped("queue")

    def _keep(self, sample: HubSample, endpoint: HubEndpoint) -> None:
        depth = min(max(endpoint.qos.depth, 1), MAX_PENDING)
        self._kept.keep(sample.gid, sample, len(sample.payload), depth)

    def _release_kept(self) -> None:
        if self._joint.lease.over:
            return
        for waiting in self._kept.take(lambda w: w.source not in self._waiting):
            source = self._sources.get(waiting.message.gid)
            if source is not None:
                with self._publishing:
                    self._publish(waiting.message, source)

    def _retry_pending(self) -> None:
        before = time.monotonic() - PENDING_SECONDS
        for pending in self._pending.take(lambda _: True):
            sample = pending.message
            source = self._source_of(sample)
            endpoint = self._waiting.get(sample.gid)
            if source is not None:
                with self._publishing:
                    self._publish(sample, source)
            elif endpoint is not None:
                if self._is_latched(endpoint):
                    self._keep(sample, endpoint)
            elif sample.gid not in self._refused and pending.since > before:
                self._pending.put_back(pending)
            elif sample.gid not in self._refused:
                self.counters.dropped("unknown")

    def _publish(self, sample: HubSample, source: _Source) -> None:
        if self._joint.lease.over:
            if source.latched:
                self._keep(sample, source.endpoint)
            else:
                self.counters.dropped("standby")
            return
        if self._priority is Priority.COMMAND and self._stale(sample, source):
            self.counters.dropped("stale")
            return
        publisher = self._latched if source.latched else self._volatile
        if publisher is None:
            self.counters.dropped("unknown")
            return
        try:
            data, name = sample.payload.to_bytes(), sample.gid.hex()
            if self._static is not None and source.latched:
                data, name = self._static.merge(data), _STATIC
            if self.conversion.convert is not None:
                data = self.conversion.convert(data)
            if self.too_large(len(data), self._joint.hub.max_payload):
                return
            publisher.send(data, name)
        except (MessageError, ValueError) as err:
            self.bad(str(err))
            return
        self.counters.crossed(len(data))
        if sample.source_time_ns >= self._since_ns:  # what was kept for late joiners says nothing of the way's length
            self.counters.latency(time.time_ns() - sample.source_time_ns)

    def _stale(self, sample: HubSample, source: _Source) -> bool:
        timeout = self.decision.timeout
        return self._joint.pulse.stood_still(timeout) or source.age.age(sample.source_time_ns) > timeout

    @property
    def static(self) -> bool:
        """Whether the route carries merged static transforms, which stay when their publishers leave."""
        return self._static is not None

    def close(self) -> None:
        """Give back everything on both networks."""
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None
        for publisher in (self._latched, self._volatile):
            if publisher is not None:
                publisher.close()
        self._latched = self._volatile = None
        with self._lock:
            self._queue.clear()
            self._queued_bytes = 0

    def status(self) -> dict[str, Any]:
        """The route as it stands in the status document."""
        if self._subscription is not None:
            self.counters.drops["lost"] = self._subscription.lost
        publishers = [p for p in (self._latched, self._volatile) if p is not None]
        self.counters.drops["slow"] = max((p.dropped for p in publishers), default=0)
        return self.describe(self._priority, self._qos, len(self._sources), active=bool(self._sources))
