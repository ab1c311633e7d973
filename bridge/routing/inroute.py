"""A topic of the side on its way into the hub."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from bridge.adapters.base import EdgeSubscription, Endpoint
from bridge.clock import CLOCK_TOPIC, CLOCK_TYPE
from bridge.hub.errors import HubError
from bridge.hub.publisher import HubPublisher
from bridge.hub.qos import Durability, Qos, Reliability
from bridge.messages.conversion import Conversion
from bridge.messages.errors import MessageError
from bridge.routing.age import AgeGate
from bridge.routing.backlog import Backlog
from bridge.routing.joint import Joint
from bridge.routing.lane import Lane
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

PENDING_SECONDS = 5.0
"""How long a message of a publisher that is not known to the route waits for it."""


@dataclass(slots=True)
class _Source:
    endpoint: Endpoint
    publisher: HubPublisher
    latched: bool
    age: AgeGate


class _Message(NamedTuple):
    payload: bytes
    known: _Source
    source: str
    time_ns: int | None


class InRoute(TopicRoute):
    """One topic and type of the side, published on the hub.

    Each latched publisher of the side has a hub publisher of its own, so that its last message goes when it goes; the
    others share one. Static transforms are merged and kept by one publisher for the life of the route; transforms that
    are not latched pass beside them as they are.
    """

    direction = "in"

    def __init__(
        self,
        key: RouteKey,
        hub_topic: str,
        conversion: Conversion,
        decision: Decision,
        joint: Joint,
    ) -> None:
        super().__init__(key, hub_topic, key.topic, conversion, decision)
        self._joint = joint
        # a session does not hear on the hub what it says itself
        self._tells_time = (hub_topic, self.hub_type) == (CLOCK_TOPIC, CLOCK_TYPE) and joint.edge.clock.simulated
        self._sources: dict[str, _Source] = {}
        self._shared: HubPublisher | None = None
        self._static: StaticTransforms | None = None
        self._static_publisher: HubPublisher | None = None
        self._static_lock = threading.Lock()
        self._followed: Sequence[Endpoint] | None = None
        self._pending = Backlog[tuple[bytes, int | None]](
            MAX_PENDING, QUEUE_BYTES, lambda: self.counters.dropped("queue")
        )
        self._subscription: EdgeSubscription | None = None
        self._qos = Qos()
        self._limit = RateLimit(decision.rate) if decision.rate else None
        self._priority = Priority.STREAM
        depth = decision.depth or QUEUE_DEPTH[self._priority]
        name = f"midspan-in{self.side_topic}"
        self._large = Lane(name, depth, QUEUE_BYTES, self._carry_large, lambda: self.counters.dropped("queue"))

    def update(self, endpoints: Sequence[Endpoint]) -> None:
        """Follow the side's publishers of this topic; called by the engine's loop alone."""
        if endpoints == self._followed:
            self._flush_pending()
            return
        self._followed = None  # until all of it is done
        current = {e.id: e for e in endpoints}
        for gone in [s for s in self._sources if s not in current]:
            self._remove(gone)
        for endpoint in endpoints:
            known = self._sources.get(endpoint.id)
            if known is None or known.endpoint.qos != endpoint.qos:
                if known is not None:
                    self._remove(endpoint.id)
                self._add(endpoint)
        if endpoints:
            self._qos = joint_qos([e.qos for e in endpoints])
            self._subscribe()
        self._followed = endpoints
        self._flush_pending()

    def _latched(self, endpoint: Endpoint) -> bool:
        latched = self.decision.override(endpoint.qos).latched
        return latched and self.priority_of(latched=latched) is not Priority.COMMAND

    def _add(self, endpoint: Endpoint) -> None:
        latched = self._latched(endpoint)
        self._priority = self.priority_of(latched=latched or any(s.latched for s in self._sources.values()))
        if latched and self.hub_type == TF_TYPE:
            publisher = self._for_static()
        elif latched:
            publisher = self._publisher(endpoint.qos)
        else:
            if self._shared is None:
                self._shared = self._publisher(endpoint.qos)
            publisher = self._shared
        self._sources[endpoint.id] = _Source(endpoint, publisher, latched, AgeGate())

    def _for_static(self) -> HubPublisher:
        if self._static_publisher is None:
            self._static = StaticTransforms()
            self._static_publisher = self._publisher(Qos(durability=Durability.TRANSIENT_LOCAL, depth=1))
        return self._static_publisher

    def _publisher(self, qos: Qos) -> HubPublisher:
        qos = self.decision.override(qos)
        if self._priority is Priority.COMMAND:
            qos = Qos(qos.reliability, Durability.VOLATILE, depth=1)
        target = self.conversion.target
        return self._joint.hub.publisher(
            self.hub_topic, target.name, target.type_id, qos, priority=self._priority.value
        )

    def _remove(self, source: str) -> None:
        known = self._sources.pop(source)
        self._pending.take(lambda waiting: waiting.source == source)
        if known.publisher is self._static_publisher:
            return
        if known.publisher is not self._shared:
            known.publisher.close()
        elif not any(s.publisher is self._shared for s in self._sources.values()):
            self._shared.close()
            self._shared = None

    def _subscribe(self) -> None:
        """Subscribe once, asking for the most; the edge hears each publisher as far as that one offers it.

        Subscribing again when a publisher comes with another QoS would bring the latched messages a second time.
        """
        if self._subscription is not None:
            return
        command = self._priority is Priority.COMMAND
        wish = Qos(
            Reliability.RELIABLE,
            Durability.VOLATILE if command else Durability.TRANSIENT_LOCAL,
            depth=1 if command else stream_depth(self.conversion.target.definition),
        )
        wish = self.decision.override(wish)
        self._subscription = self._joint.edge.subscribe(self.key.topic, self.conversion.source, wish, self._deliver)

    def _flush_pending(self) -> None:
        before = time.monotonic() - PENDING_SECONDS
        for waiting in self._pending.take(lambda w: w.source in self._sources or w.since < before):
            if waiting.source in self._sources:
                payload, time_ns = waiting.message
                self._deliver(payload, str(waiting.source), time_ns)
            else:
                self.counters.dropped("unknown")

    def _deliver(self, payload: bytes, source: str, time_ns: int | None) -> None:
        known = self._sources.get(source)
        counters = self.counters
        if self._joint.lease.over:
            counters.dropped("standby")
            return
        if known is None:
            # On the graph for the edge, not yet for us: the newest waits until the engine comes back with `update`.
            if self._priority is Priority.COMMAND:
                counters.dropped("unknown")  # a command is never kept for later
            else:
                counters.dropped("unknown", self._pending.keep(source, (payload, time_ns), len(payload), depth=1))
            self._joint.wake()
            return
        if self._priority is Priority.COMMAND and self._stale(known, time_ns):
            counters.dropped("stale")
            return
        if self._limit is not None and not known.latched and not self._limit.passes():
            counters.dropped("rate")
            return
        if self.too_large(len(payload), self._joint.hub.max_payload):
            return
        if len(payload) > BULK or self._large.busy:
            self._large.put(_Message(payload, known, source, time_ns), len(payload))
        else:
            self._carry(payload, known, time_ns)

    def _carry_large(self, message: _Message) -> None:
        payload, known, source, time_ns = message
        if self._sources.get(source) is known:
            self._carry(payload, known, time_ns)
        else:
            self.counters.dropped("unknown")  # gone while it waited

    def _carry(self, payload: bytes, known: _Source, time_ns: int | None) -> None:
        try:
            convert = self.conversion.convert
            data = payload if convert is None else convert(payload)
            if self.too_large(len(data), self._joint.hub.max_payload):
                return
            if self._static is not None and known.latched:
                with self._static_lock:
                    known.publisher.put(self._static.merge(data), time_ns)
            else:
                known.publisher.put(data, time_ns)
        except (MessageError, HubError, ValueError) as err:
            self.bad(str(err))
            return
        self.counters.crossed(len(data))
        if self._tells_time:
            self._joint.edge.clock.hear(data)

    def _stale(self, known: _Source, time_ns: int | None) -> bool:
        timeout = self.decision.timeout
        return self._joint.pulse.stood_still(timeout) or (time_ns is not None and known.age.age(time_ns) > timeout)

    @property
    def static(self) -> bool:
        """Whether the route carries merged static transforms, which stay when their publishers leave."""
        return self._static is not None

    def close(self) -> None:
        """Give back everything on both networks."""
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None
        self._large.close()
        for source in list(self._sources):
            self._remove(source)
        for publisher in (self._shared, self._static_publisher):
            if publisher is not None:
                publisher.close()
        self._shared = self._static_publisher = None

    def status(self) -> dict[str, Any]:
        """The route as it stands in the status document."""
        if self._subscription is not None:
            self.counters.drops["lost"] = self._subscription.lost
        return self.describe(self._priority, self._qos, len(self._sources), active=bool(self._sources))
