"""Routes of topics from the hub to the side, and the set of them."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from typing_extensions import override

from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.errors import MessageError
from bridge.messages.transcode.conversion import Conversion
from bridge.routing.backlog import Backlog
from bridge.routing.decision import OWN_NETWORK, RouteDecision, RouteKey, hub_groups
from bridge.routing.edge import EdgePublisher, Endpoint
from bridge.routing.election import Outcome
from bridge.routing.gates import ExitGate, may_carry, may_leave
from bridge.routing.limits import BULK, MAX_PENDING, QUEUE_BYTES, QUEUE_DEPTH, Priority, combined_qos, stream_depth
from bridge.routing.rewrites import TF_TYPE, StaticTransforms, with_spread
from bridge.routing.route import EngineContext, RouteSet, TopicRoute
from bridge.routing.rules import RoutePolicy
from bridge.routing.stall import AgeGate
from bridge.status import RouteStatus

PENDING_SECONDS = 2.0
"""Seconds for which a message from an unknown publisher is held."""

UNHEARD = 10.0
"""Seconds without a subscriber on the side after which a fast stream stays on the hub."""

QUICK = 5.0
"""Messages per second from which a stream counts as fast: a new subscriber misses some of them anyway. Rarer messages
may be events, which a new subscriber must not miss."""

_STATIC = "static transforms"


@dataclass(slots=True)
class _Source:
    endpoint: HubEndpoint
    latched: bool
    age: AgeGate


class HubToSideRoute(TopicRoute):
    """One topic and type of the hub, published on the side.

    Each latched hub publisher stays a separate source on the side. Samples of publishers that the engine did not name
    (from this same network, or not yet known) do not pass. ``origin`` is that of the topic's first publisher, None for
    a native program of the hub. A fast stream without a subscriber on the side stays on the hub. ``pending``: messages
    that are held until their publisher is known.
    """

    direction = "out"

    def __init__(
        self, key: RouteKey, side_topic: str, origin: Origin | None, conversion: Conversion, policy: RoutePolicy,
        context: EngineContext,
    ) -> None:  # fmt: skip
        super().__init__(key, (key.topic, side_topic), with_spread(conversion, key.topic), policy, context)
        self.origin = origin
        self._lease = context.lease
        self._dispatcher = context.small
        self._followed: tuple[Sequence[HubEndpoint], ...] = ()
        self._sources: dict[bytes, _Source] = {}
        self._refused: frozenset[bytes] = frozenset()
        self._waiting: dict[bytes, HubEndpoint] = {}
        self._waiting_latched = Backlog[HubSample](QUEUE_DEPTH[Priority.STATE], QUEUE_BYTES, self.crowded_out)
        self._natives: dict[str, _Source] = {}
        self._queue: deque[HubSample] = deque()
        self._queued_bytes = 0
        self._lock = threading.Lock()
        self._publishing = threading.Lock()
        self.pending = Backlog[HubSample](MAX_PENDING, QUEUE_BYTES, self.crowded_out)
        self._latched: EdgePublisher | None = None
        self._volatile: EdgePublisher | None = None
        self._subscription: HubSubscription | None = None
        self._depth = 1
        self._subscribed = 0.0
        self._since, self._messages_then = time.monotonic(), 0
        self._heard = self._unheard = False
        self._lost_before = self._by_lane_before = 0

    def update(
        self, allowed: Sequence[HubEndpoint], refused: Sequence[HubEndpoint], waiting: Sequence[HubEndpoint] = ()
    ) -> None:
        """Follow the hub's publishers of this topic; called only by the engine's loop.

        ``waiting``: publishers that may pass later, once their origin is known or the election has ended. Their latched
        messages arrive only once, and are stored until then.
        """
        followed = (allowed, refused, waiting)
        if followed != self._followed:
            self._followed = ()  # in case the update fails
            self._follow(allowed, refused, waiting)
            self._followed = followed
        self._follow_listeners(allowed)
        self._release_latched()
        self._retry_pending()

    def _follow(
        self, allowed: Sequence[HubEndpoint], refused: Sequence[HubEndpoint], waiting: Sequence[HubEndpoint]
    ) -> None:
        current = {e.gid: e for e in allowed}
        for departed in [g for g in self._sources if g not in current]:
            source = self._sources.pop(departed)
            if source.latched and self._latched is not None and self._static is None:
                self._latched.drop_source(departed.hex())
        for gid, endpoint in current.items():
            if gid not in self._sources:
                self._sources[gid] = _Source(endpoint, self.latches(endpoint.qos), AgeGate())
        self._refused = frozenset(e.gid for e in refused)
        self._waiting = {e.gid: e for e in waiting}
        # Some participants (zenoh-ros2-sdk) put an invented GID in their samples.
        self._natives = {s.endpoint.zid: s for s in self._sources.values() if s.endpoint.origin is None}
        self._advertise()
        if allowed and not self._unheard:
            self._subscribe(combined_qos([e.qos for e in allowed]))

    def _follow_listeners(self, allowed: Sequence[HubEndpoint]) -> None:
        """Keep a fast stream on the hub while it has no subscriber on the side; subscribe with the first one."""
        volatile = self._volatile if self._priority is Priority.STREAM and self._latched is None else None
        before, wanted = self._heard, volatile is None or volatile.has_subscribers
        self._heard = wanted
        seconds, messages = time.monotonic() - self._since, self.counters.messages - self._messages_then
        if before or seconds > UNHEARD:  # a subscriber of the last check may have left just now
            self._since, self._messages_then = time.monotonic(), self.counters.messages
        if wanted and self._unheard:
            self._unheard = False
            if allowed:
                self._subscribe(combined_qos([e.qos for e in allowed]))
        elif (
            not wanted
            and not before
            and seconds > UNHEARD
            and messages > QUICK * seconds
            and self._subscription is not None
        ):
            self._unheard = True
            self._leave_hub()

    def _leave_hub(self) -> None:
        if self._subscription is not None:
            self._lost_before += self._subscription.lost
            self._by_lane_before += self._subscription.by_lane
            self._subscription.close()
            self._subscription = None

    def _advertise(self) -> None:
        latched = any(s.latched for s in self._sources.values())
        self._priority = self.priority_of(latched=latched)
        self._depth = self.policy.depth or QUEUE_DEPTH[self._priority]
        if latched and self._latched is None:
            if self.hub_type == TF_TYPE:
                self._static = StaticTransforms()
            depth = 1 if self._static else max(s.endpoint.qos.depth for s in self._sources.values() if s.latched)
            self._latched = self._advertise_as(Durability.TRANSIENT_LOCAL, depth)
        if self._volatile is None and any(not s.latched for s in self._sources.values()):
            reported = max(s.endpoint.qos.depth for s in self._sources.values() if not s.latched)
            depth = max(stream_depth(self.conversion.source.definition), reported)
            self._volatile = self._advertise_as(Durability.VOLATILE, 1 if self._priority is Priority.COMMAND else depth)

    def _advertise_as(self, durability: Durability, depth: int) -> EdgePublisher:
        # Reliable writers match reliable and best-effort readers.
        qos = self.policy.override(Qos(Reliability.RELIABLE, durability, depth=min(max(depth, 1), 1000)))
        return self._context.edge.advertise(self.side_topic, self.conversion.target, qos)

    def _subscribe(self, qos: Qos) -> None:
        if self._priority is Priority.COMMAND:
            qos = Qos(qos.reliability, Durability.VOLATILE, depth=1)
        if self._subscription is not None and qos.durability is self._qos.durability:
            return
        self._leave_hub()
        self._qos = qos
        self._subscribed = time.monotonic()
        source = self.conversion.source
        self._subscription = self._context.hub.subscription(
            self.hub_topic, source.name, self.key.type_id, qos, self.received, self._refused_by_hub
        )

    def _refused_by_hub(self, reason: str, why: str) -> None:
        """Count a sample without a valid attachment, or too large; runs on zenoh's receiving thread."""
        self.bad(why, reason)

    def received(self, sample: HubSample) -> None:
        """Publish a small message, append a large one and wake; runs on zenoh's receiving thread.

        Messages stay in order: nothing is published here while one is queued or being published elsewhere.
        """
        size = len(sample.payload)
        with self._lock:
            if self._limit is not None:
                known = self._source_of(sample)
                if known is not None and self.over_rate(latched=known.latched):
                    return
            at_once = size <= BULK and not self._queue and self._publishing.acquire(blocking=False)
            if not at_once:
                self._append(sample, size)
            dispatcher = self._dispatcher
        if not at_once:
            dispatcher.submit(self._priority, self._next)
            return
        try:
            dispatcher.here(self.handle, sample)
        finally:
            self._publishing.release()

    def _append(self, sample: HubSample, size: int) -> None:
        self._queue.append(sample)
        self._queued_bytes += size
        while len(self._queue) > self._depth or (self._queued_bytes > QUEUE_BYTES and len(self._queue) > 1):
            self._queued_bytes -= len(self._queue.popleft().payload)
            self.counters.dropped("queue")
        if size > BULK and len(self._queue) == 1:
            self._dispatcher = self._context.bulk

    def _next(self) -> None:
        with self._publishing:
            with self._lock:
                if not self._queue:
                    return
                sample = self._queue.popleft()
                self._queued_bytes -= len(sample.payload)
            self.handle(sample)

    def _source_of(self, sample: HubSample) -> _Source | None:
        known = self._sources.get(sample.gid)
        if known is not None or sample.gid in self._refused or sample.gid in self._waiting:
            return known
        return self._natives.get(sample.zid) if sample.zid else next(iter(self._natives.values()), None)

    def handle(self, sample: HubSample) -> None:
        """Publish a message on the side, or hold it until its publisher is known."""
        source = self._sources.get(sample.gid) or self._source_of(sample)
        if source is not None:
            self._publish(sample, source)
            return
        waiting = self._waiting.get(sample.gid)
        if waiting is not None:
            if self.latches(waiting.qos):
                self._keep(sample, waiting)
        elif sample.gid not in self._refused:
            if self._priority is Priority.COMMAND:  # never kept for later
                self.counters.dropped("unknown")
            else:
                self.pending.add(sample.gid, sample, len(sample.payload))
            self._context.wake()

    def _keep(self, sample: HubSample, endpoint: HubEndpoint) -> None:
        depth = min(max(endpoint.qos.depth, 1), MAX_PENDING)
        self._waiting_latched.keep(sample.gid, sample, len(sample.payload), depth)

    def _release_latched(self) -> None:
        if self._lease.over:
            return
        for waiting in self._waiting_latched.pop_matching(lambda w: w.source not in self._waiting):
            source = self._sources.get(waiting.message.gid)
            if source is not None:
                with self._publishing:
                    self._publish(waiting.message, source)

    def _retry_pending(self) -> None:
        before = time.monotonic() - PENDING_SECONDS
        for pending in self.pending.pop_matching(lambda _: True):
            sample = pending.message
            source = self._source_of(sample)
            endpoint = self._waiting.get(sample.gid)
            if source is not None:
                if not self.over_rate(latched=source.latched):
                    with self._publishing:
                        self._publish(sample, source)
            elif endpoint is not None:
                if self.latches(endpoint.qos):
                    self._keep(sample, endpoint)
            elif sample.gid not in self._refused and pending.since > before:
                self.pending.put_back(pending)
            elif sample.gid not in self._refused:
                self.counters.dropped("unknown")

    def _publish(self, sample: HubSample, source: _Source) -> None:
        if self._lease.over:
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
            if self.too_large(len(data)):
                return
            publisher.send(data, name)
        except (MessageError, ValueError) as err:
            self.bad(str(err))
            return
        self.counters.crossed(len(data))
        # The age of a message cached for late joiners is not a latency. The system clock may be set meanwhile.
        latency = time.time_ns() - sample.source_time_ns
        if time.monotonic() - latency / 1e9 >= self._subscribed:
            self.counters.latency(latency)

    def _stale(self, sample: HubSample, source: _Source) -> bool:
        timeout = self.policy.timeout
        return self._context.stall_detector.stood_still(timeout) or source.age.age(sample.source_time_ns) > timeout

    @override
    def close(self, why: str = "") -> None:  # only pending calls need the reason
        self._leave_hub()
        for publisher in (self._latched, self._volatile):
            if publisher is not None:
                publisher.close()
        self._latched = self._volatile = None
        with self._lock:
            self._queue.clear()
            self._queued_bytes = 0

    @override
    def status(self) -> RouteStatus:
        transport, by_lane = ("", ""), self._by_lane_before
        if (subscription := self._subscription) is not None:
            self.counters.missed(self._lost_before + subscription.lost, subscription.losses)
            transport, by_lane = (subscription.way, subscription.why), by_lane + subscription.by_lane
        publishers = [p for p in (self._latched, self._volatile) if p is not None]
        self.counters.drops["slow"] = max((p.dropped for p in publishers), default=0)
        status = self.describe(len(self._sources), transport, by_lane)
        unheard = self._unheard and status.state == "active"
        return status.model_copy(update={"state": "unheard"}) if unheard else status


class HubToSideTopics(RouteSet[tuple[RouteKey, str], HubToSideRoute]):
    """Follows the hub's publishers."""

    direction = "out"
    _outcome = Outcome()

    @override
    def candidates(self, endpoints: Sequence[Endpoint]) -> set[tuple[str, str]]:  # the hub's graph counts
        publishers = self._context.hub.graph.publishers()
        return {(e.topic, e.type_name) for e in publishers if may_leave(e, self._context.edge)}

    def follow(self, gate: ExitGate, decisions: list[RouteDecision], outcome: Outcome) -> None:
        """Update the routes for the hub's graph, the rules and the election; append one decision for each topic."""
        self._outcome = outcome
        groups = hub_groups(self._context.hub.graph.publishers())
        # Close ended routes first: a side may have one type per topic.
        self._end([k for k in self._routes if k[0] not in groups], gate)
        live: set[tuple[RouteKey, str]] = set()
        for key, endpoints in groups.items():
            self._follow(key, endpoints, gate, live, decisions)
        self._end([k for k in self._routes if k[0] in groups and k not in live], gate)

    def _end(self, out_keys: list[tuple[RouteKey, str]], gate: ExitGate) -> None:
        for out_key in out_keys:
            route, key = self._routes[out_key], out_key[0]
            if route.static and route.policy == gate.decide("topic", route.origin, key.topic, key.type_name):
                route.update([], [])
            else:
                self._routes.pop(out_key).close()

    def _follow(
        self, key: RouteKey, endpoints: list[HubEndpoint], gate: ExitGate, live: set[tuple[RouteKey, str]],
        decisions: list[RouteDecision],
    ) -> None:  # fmt: skip
        by_name: dict[str, tuple[RoutePolicy, list[HubEndpoint]]] = {}
        refused: list[HubEndpoint] = []
        elsewhere: list[HubEndpoint] = []
        for endpoint in endpoints:
            if not may_leave(endpoint, self._context.edge):
                refused.append(endpoint)
                continue
            if not may_carry(endpoint, self._outcome):
                elsewhere.append(endpoint)
                continue
            policy = gate.decide("topic", endpoint.origin, key.topic, key.type_name)
            side_topic = policy.name if policy.name != key.topic else self._context.edge.side_name(key.topic)
            placeless = self._context.edge.why_not(side_topic, key.type_name)
            if policy.allowed and placeless:
                refused.append(endpoint)
                decisions.append(
                    RouteDecision.unrouted("out", side_topic, key.type_name, placeless, hub_topic=key.topic)
                )
            elif policy.allowed:
                by_name.setdefault(side_topic, (policy, []))[1].append(endpoint)
            else:
                refused.append(endpoint)
                decisions.append(RouteDecision("out", side_topic, key.topic, key.type_name, policy))
        carriers = sorted({self._outcome.carriers.get(e.zid, "") for e in elsewhere})
        decisions += [RouteDecision.carried_by(carrier, key.topic, key.type_name) for carrier in carriers]
        for side_topic, (policy, allowed) in by_name.items():
            decision = RouteDecision("out", side_topic, key.topic, key.type_name, policy)
            decisions.append(decision)
            waiting = [e for e in endpoints if e.pending or e in elsewhere]
            others = [e for e in endpoints if e not in allowed and e not in waiting]
            self._route(key, side_topic, policy, (allowed, others, waiting), live, decision)
        if not by_name and refused and all(not may_leave(e, self._context.edge) for e in refused):
            decisions.append(RouteDecision.unrouted("out", key.topic, key.type_name, OWN_NETWORK))

    def _route(
        self, key: RouteKey, side_topic: str, policy: RoutePolicy,
        endpoints: tuple[list[HubEndpoint], list[HubEndpoint], list[HubEndpoint]], live: set[tuple[RouteKey, str]],
        decision: RouteDecision,
    ) -> None:  # fmt: skip
        edge, out_key = self._context.edge, (key, side_topic)
        route = self._routes.get(out_key)
        if route is not None and route.policy != policy:
            self._routes.pop(out_key).close()
            route = None
        if route is None:
            conversion = decision.convert(lambda: edge.from_hub(key.type_name, key.type_id))
            if conversion is None:
                self._context.types.ask(key.type_name, key.type_id)
                return
            route = HubToSideRoute(key, side_topic, endpoints[0][0].origin, conversion, policy, self._context)
            self._routes[out_key] = route
        live.add(out_key)
        route.attempt(lambda: route.update(*endpoints), decision)
