"""Topic routes from the side to the hub, and the set that opens and closes them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from typing_extensions import override

from bridge.clock import CLOCK_TOPIC, CLOCK_TYPE
from bridge.concurrency import BoundedQueue
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.errors import HubError
from bridge.hub.graph.tokens import TAPS
from bridge.hub.lane.blocks import StoredMessage
from bridge.hub.wire.keys import topic_key
from bridge.hub.wire.qos import LATCHED, Durability, Qos, Reliability
from bridge.messages.errors import MessageError
from bridge.messages.transcode.conversion import Conversion
from bridge.routing.backlog import Backlog
from bridge.routing.counters import CARRY_BOUNDS
from bridge.routing.decision import RouteDecision, RouteKey, native_groups
from bridge.routing.edge import EdgeSubscription, Endpoint, Kind
from bridge.routing.gates import EntryGate
from bridge.routing.limits import BULK, MAX_PENDING, QUEUE_BYTES, QUEUE_DEPTH, Priority, combined_qos, stream_depth
from bridge.routing.rewrites import TF_TYPE, StaticTransforms
from bridge.routing.route import EngineContext, RouteSet, TopicRoute
from bridge.routing.rules import RoutePolicy
from bridge.routing.shortcut import Doorway
from bridge.routing.stall import AgeGate
from bridge.routing.velocities import velocity_to_hub
from bridge.status import RouteStatus

PENDING_SECONDS = 5.0
"""Seconds for which a message from an unknown publisher is held."""


class StaticPublisher:
    """The hub publisher of a route's static transforms, which it merges. `put` is thread-safe."""

    def __init__(self, publisher: HubPublisher) -> None:
        self.publisher = publisher
        self._transforms = StaticTransforms()
        self._lock = threading.Lock()

    def put(self, payload: bytes, source_time_ns: int | None = None) -> None:
        """Merge a TFMessage (CDR), and publish all transforms; raises `ValueError` if the message is invalid."""
        with self._lock:
            self.publisher.put(self._transforms.merge(payload), source_time_ns)


@dataclass(slots=True)
class _SidePublisher:
    """A publisher on the side; ``put`` publishes its messages on the hub through ``hub_publisher``."""

    endpoint: Endpoint
    hub_publisher: HubPublisher
    put: Callable[[bytes, int | None], None]
    latched: bool
    age: AgeGate


class _Held(NamedTuple):
    payload: bytes
    time_ns: int | None
    leased: bool
    """Whether it arrived while the worker had the lease."""


class _Message(NamedTuple):
    payload: bytes
    publisher: _SidePublisher
    source: str
    time_ns: int | None
    since: float


class SideToHubRoute(TopicRoute):
    """Publishes one topic and type of the side on the hub.

    Each latched publisher on the side has its own hub publisher, so that its cached messages disappear when it leaves;
    all other publishers share one hub publisher. Static transforms are merged, and one hub publisher retains them for
    the life of the route; transforms that are not latched are published unchanged.

    ``pending`` holds messages until their publisher is known, or until the worker has the lease. The lock
    ``_releasing`` is held while they are removed and published, so that a newer message, which another thread delivers,
    is published after them.
    """

    direction = "in"

    def __init__(
        self, key: RouteKey, hub_topic: str, conversion: Conversion, policy: RoutePolicy, context: EngineContext
    ) -> None:
        super().__init__(key, (hub_topic, key.topic), conversion, policy, context)
        # a session does not receive its own publications from the hub
        self._tells_time = (hub_topic, self.hub_type) == (CLOCK_TOPIC, CLOCK_TYPE) and context.edge.clock.simulated
        self._sources: dict[str, _SidePublisher] = {}
        self._shared: HubPublisher | None = None
        self._static: StaticPublisher | None = None
        self._by_lane_before = 0
        self._followed: Sequence[Endpoint] | None = None
        self.pending = Backlog[_Held](MAX_PENDING, QUEUE_BYTES, self.crowded_out)
        self._releasing = threading.Lock()
        self._subscription: EdgeSubscription | None = None
        self._hold, self._own_threads = context.hold, context.edge.own_threads
        depth = policy.depth or QUEUE_DEPTH[self._priority]
        name = f"midspan-in{self.side_topic}"
        self._queues = False  # until the first large message
        self._large = BoundedQueue(name, depth, QUEUE_BYTES, self._carry_large, self.crowded_out)
        self._doorway = self.counters.doorway = self._make_doorway()

    def _make_doorway(self) -> Doorway | None:
        """Return the shorter path for small messages; None if each message needs a check that only Python makes."""
        if Doorway is None or not self._is_plain() or self._tells_time:
            return None
        conditions = (self._lease, self._hold, self.pending.line)
        return Doorway(self.deliver, *conditions, self._program, self._max_payload, CARRY_BOUNDS)

    def update(self, endpoints: Sequence[Endpoint]) -> None:
        """Follow the side's publishers of this topic; called only by the engine's loop."""
        if endpoints == self._followed:
            self._flush_pending()
            return
        self._followed = None  # in case the update fails
        current = {e.id: e for e in endpoints}
        for departed in [s for s in self._sources if s not in current]:
            self._remove(departed)
        for endpoint in endpoints:
            publisher = self._sources.get(endpoint.id)
            if publisher is None or publisher.endpoint.qos != endpoint.qos:
                if publisher is not None:
                    self._remove(endpoint.id)
                self._add(endpoint)
        if endpoints:
            self._qos = combined_qos([e.qos for e in endpoints])
            self._subscribe()
        self._followed = endpoints
        self._flush_pending()
        self._admit_plain()

    def _admit_plain(self) -> None:
        """Let the doorway send the messages of publishers that need no special care."""
        if self._doorway is not None and self._priority is not Priority.COMMAND:
            for source, publisher in self._sources.items():
                if not publisher.latched:
                    self._doorway.admit(source, publisher.hub_publisher.sender)

    def _add(self, endpoint: Endpoint) -> None:
        latched = self.latches(endpoint.qos)
        self._priority = self.priority_of(latched=latched or any(s.latched for s in self._sources.values()))
        if latched and self.hub_type == TF_TYPE:
            if self._static is None:
                self._static = StaticPublisher(self._publisher(LATCHED))
            publisher, put = self._static.publisher, self._static.put
        elif latched:
            publisher = self._publisher(endpoint.qos)
            put = publisher.put
        else:
            if self._shared is None:
                self._shared = self._publisher(endpoint.qos)
            publisher, put = self._shared, self._shared.put
        self._sources[endpoint.id] = _SidePublisher(endpoint, publisher, put, latched, AgeGate())

    def _publisher(self, qos: Qos) -> HubPublisher:
        qos = self.override(qos)
        if self._priority is Priority.COMMAND:
            qos = Qos(qos.reliability, Durability.VOLATILE, depth=1)
        target = self.conversion.target
        return self._context.hub.publisher(
            self.hub_topic, target.name, target.type_id, qos, priority=self._priority.value, queue=self.policy.depth
        )

    def _remove(self, source: str) -> None:
        if self._doorway is not None:
            self._doorway.dismiss(source)
        publisher = self._sources.pop(source)
        self.pending.pop_matching(lambda waiting: waiting.source == source)
        if self._static is not None and publisher.hub_publisher is self._static.publisher:
            return
        if publisher.hub_publisher is not self._shared:
            publisher.hub_publisher.close()
        elif not any(s.hub_publisher is self._shared for s in self._sources.values()):
            self._by_lane_before += self._shared.by_lane
            self._shared.close()
            self._shared = None

    def _subscribe(self) -> None:
        """Subscribe once, with the strongest QoS, which the edge adapts to each publisher.

        A second subscription for publishers with a different QoS would deliver latched messages twice.
        """
        if self._subscription is not None:
            return
        command = self._priority is Priority.COMMAND
        wanted = Qos(
            Reliability.RELIABLE,
            Durability.VOLATILE if command else Durability.TRANSIENT_LOCAL,
            depth=1 if command else stream_depth(self.conversion.target.definition),
        )
        wanted = self.override(wanted)
        deliver = self._doorway or self.deliver
        self._subscription = self._context.edge.subscribe(self.key.topic, self.conversion.source, wanted, deliver)

    def _flush_pending(self) -> None:
        """Publish the held messages of known publishers, and drop the overdue ones of unknown publishers."""
        if self._lease.over:
            return
        before = self.pending.overdue(PENDING_SECONDS)
        if self.pending:
            self._release_first()
            for _ in self.pending.pop_matching(lambda w: w.source not in self._sources and w.since < before):
                self.counters.dropped("unknown")

    def _release_first(self, then: Callable[[], None] = lambda: None) -> None:
        """Publish the held messages of known publishers, before all newer ones."""
        with self._releasing:
            if self._doorway is not None:
                self._doorway.releasing = True
            try:
                self._release()
                then()
            finally:
                if self._doorway is not None:
                    self._doorway.releasing = False

    def _release(self) -> None:
        for waiting in self.pending.pop_matching(lambda w: w.source in self._sources):
            source = str(waiting.source)
            publisher = self._sources.get(source)
            payload, time_ns, leased = waiting.message
            if publisher is None:
                self.counters.dropped("unknown")  # the publisher left meanwhile
            elif leased or publisher.latched:
                self._pass(publisher, source, payload, time_ns, time.monotonic())
            else:
                self.counters.dropped("standby")

    def deliver(self, payload: bytes, source: str, time_ns: int | None) -> None:
        """Handle a message from one of the side's publishers; the edge or the doorway calls this, on any thread."""
        publisher = self._sources.get(source)
        since = time.monotonic()
        # pending first, because a release empties it while it holds the lock
        held = self.pending or self._releasing.locked()
        if publisher is None or publisher.latched or held or since > self._lease.until:
            self._deliver_rare(publisher, payload, source, time_ns)
        else:
            self._pass(publisher, source, payload, time_ns, since, at_once=self._own_threads)

    def _deliver_rare(self, publisher: _SidePublisher | None, payload: bytes, source: str, time_ns: int | None) -> None:
        """Handle a message that is latched, from an unknown publisher, without the lease, or newer than held ones."""
        counters = self.counters
        if self._lease.over:
            # a latched message arrives only once, and the route may continue
            if publisher.latched if publisher is not None else self._priority is not Priority.COMMAND:
                depth = 1 if publisher is None else min(max(publisher.endpoint.qos.depth, 1), MAX_PENDING)
                held = _Held(payload, time_ns, leased=False)
                counters.dropped("standby", self.pending.keep(source, held, len(payload), depth))
                if not self._lease.over:  # it returned meanwhile, and its check may not have seen the message
                    self._context.wake()
            else:
                counters.dropped("standby")
        elif publisher is None and not self._is_blocked():
            # The engine may not have seen the publisher yet: hold its messages until the engine calls `update`.
            if self._priority is Priority.COMMAND:
                counters.dropped("unknown")  # a command is never held
            else:
                self.pending.add(source, _Held(payload, time_ns, leased=True), len(payload))
            self._context.wake()
        elif publisher is None:
            counters.dropped("held")
        elif self.pending or self._releasing.locked():
            self._release_first(lambda: self._pass(publisher, source, payload, time_ns, time.monotonic()))
        else:
            self._pass(publisher, source, payload, time_ns, time.monotonic())

    def _is_blocked(self) -> bool:
        return self._hold is not None and self._hold.blocks(self.hub_topic)

    def _pass(
        self, publisher: _SidePublisher, source: str, payload: bytes, time_ns: int | None, since: float,
        *, at_once: bool = False,
    ) -> None:  # fmt: skip
        """Publish a known publisher's message, which arrived at ``since`` (monotonic), unless it has to be dropped.

        ``at_once``: the calling thread may publish large messages if that cannot block: no zenoh subscription exists.
        """
        size = len(payload)
        if self._hold is not None and self._is_blocked():
            self.counters.dropped("held")
        elif self._priority is Priority.COMMAND and self.is_stale(lambda: payload, publisher.age, time_ns):
            self.counters.dropped("stale")
        elif (self._limit and self.over_rate(lambda: payload, latched=publisher.latched)) or self.too_large(size):
            return
        elif (self._queues and self._large.busy) or (
            size > BULK and not (at_once and publisher.hub_publisher.blocks() is not None)
        ):
            self._queues = True
            if self._doorway is not None:
                self._doorway.open = False  # small messages would overtake this one
            self._large.put(_Message(payload, publisher, source, time_ns, since), size)
        else:
            self._carry(payload, publisher, time_ns, since)

    def _carry_large(self, message: _Message) -> None:
        payload, publisher, source, time_ns, since = message
        if self._sources.get(source) is publisher:
            self._carry(payload, publisher, time_ns, since)
        else:
            self.counters.dropped("unknown")  # the publisher left meanwhile

    def _carry(self, payload: bytes, publisher: _SidePublisher, time_ns: int | None, since: float) -> None:
        data: bytes | StoredMessage = payload
        try:
            data = self._converted(payload, publisher)
            size = len(data)
            if self.too_large(size):
                return
            if isinstance(data, bytes):
                publisher.put(data, time_ns)
            else:
                publisher.hub_publisher.put(data, time_ns)
        except (MessageError, HubError, ValueError) as err:
            self.bad(str(err))
            return
        finally:
            if isinstance(data, StoredMessage):
                data.release()
        self.counters.carried(size, since)
        if self._tells_time and isinstance(data, bytes):
            self._context.edge.clock.receive(data)

    def _converted(self, payload: bytes, publisher: _SidePublisher) -> bytes | StoredMessage:
        """Return a converted message, a large one in a block of the lane if all subscriptions are on lanes."""
        blocks = publisher.hub_publisher.blocks() if len(payload) > BULK else None
        if blocks is None:
            convert = self.conversion.convert
            return payload if convert is None else convert(payload)
        stored = StoredMessage(blocks)
        try:
            converted = self._direct.write(payload, stored.room)
        except BaseException:
            stored.release()
            raise
        return stored if converted is None else converted

    @property
    @override
    def static(self) -> bool:
        return self._static is not None

    @override
    def close(self, why: str = "") -> None:  # only pending calls need the reason
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None
        self._large.close()
        for source in list(self._sources):
            self._remove(source)
        if self._shared is not None:
            self._shared.close()
        if self._static is not None:
            self._static.publisher.close()
        self._shared = self._static = None

    @override
    def status(self) -> RouteStatus:
        if self._subscription is not None:
            self.counters.drops["lost"] = self._subscription.lost
        publishers = {s.hub_publisher.gid: s.hub_publisher for s in tuple(self._sources.values())}.values()
        status = [publisher.way() for publisher in publishers]
        transports = {transport for transport, _ in status if transport}
        transport = "both" if len(transports) > 1 else next(iter(transports), "")
        reason = next((reason for _, reason in status if reason), "")
        by_lane = self._by_lane_before + sum(publisher.by_lane for publisher in publishers)
        return self.describe(len(self._sources), (transport, reason), by_lane)


_MAX_TAPS = 100
_TAP_ANSWER = 2.0


class SideToHubTopics(RouteSet[RouteKey, SideToHubRoute]):
    """The routes of the topics that the side's publishers send.

    Any thread may call `tap`, which waits for ``_changed`` until its route exists.
    """

    direction = "in"

    def __init__(self, context: EngineContext) -> None:
        super().__init__(context)
        self._taps: dict[str, float] = {}
        self._changed = threading.Condition()

    @override
    def candidates(self, endpoints: Sequence[Endpoint]) -> set[tuple[str, str]]:
        return {(e.topic, e.type) for e in endpoints if e.kind is Kind.PUBLISHER}

    def follow(self, gate: EntryGate, endpoints: Sequence[Endpoint], decisions: list[RouteDecision]) -> None:
        """Update the routes according to the side's graph and the rules; append a decision for each topic."""
        wanted = native_groups(endpoints, Kind.PUBLISHER, decisions)
        # Close ended routes first: a side may have one type per topic, and the hub one topic per name.
        for key in [k for k in self._routes if k not in wanted]:
            route = self._routes[key]
            if route.static and route.policy == gate.decide("topic", key.topic, key.type_name):
                route.update([])
            else:
                self._routes.pop(key).close()
        taken = {route.hub_topic: key for key, route in self._routes.items()}
        for key, publishers in wanted.items():
            self._follow(key, publishers, gate, taken, decisions)
        with self._changed:
            self._changed.notify_all()

    def _follow(
        self, key: RouteKey, endpoints: list[Endpoint], gate: EntryGate, taken: dict[str, RouteKey],
        decisions: list[RouteDecision],
    ) -> None:  # fmt: skip
        policy = gate.decide("topic", key.topic, key.type_name)
        hub_topic = self._context.edge.hub_name(policy.name)
        decision = RouteDecision("in", key.topic, hub_topic, key.type_name, policy)
        decisions.append(decision)
        if not policy.allowed and time.monotonic() < self._taps.get(key.topic, 0.0):
            hub_topic = f"{TAPS}{self._context.edge.side}{self._context.edge.hub_name(key.topic)}"
            policy = replace(policy, allowed=True, name=hub_topic)
        route = self._routes.get(key)
        if route is not None and (not policy.allowed or route.policy != policy):
            self._routes.pop(key).close()
            route = None
        if not policy.allowed:
            return
        holder = taken.get(hub_topic, key)
        if holder.topic != key.topic:
            decision.refuse(
                f"{holder.topic} is already bridged under the name {hub_topic}", "rename one of them with a rule"
            )
            return
        if route is None:
            conversion = decision.convert(lambda: velocity_to_hub(self._context.edge, endpoints[0], policy))
            if conversion is None:
                return
            self._context.types.offer(conversion.target)
            route = self._routes[key] = SideToHubRoute(key, hub_topic, conversion, policy, self._context)
            taken[hub_topic] = key
        route.attempt(lambda: route.update(endpoints), decision)

    def tap(self, topic: str, seconds: float) -> dict[str, str]:
        """Publish a topic that is not bridged, for ``seconds``, under a name on the hub that no side routes.

        Return the hub topic, type, hash and zenoh key; {} if the side lacks the topic, too many topics are tapped, or
        no route exists within 2 s. Call it again to extend the time, which is at most 60 s.
        """
        if len(self._taps) >= _MAX_TAPS:
            self._taps = {t: until for t, until in self._taps.items() if until > time.monotonic()}
        if (topic not in self._taps and len(self._taps) >= _MAX_TAPS) or not any(
            e.topic == topic and e.kind is Kind.PUBLISHER for e in self._context.edge.endpoints()
        ):
            return {}
        self._taps[topic] = time.monotonic() + min(seconds, 60.0)
        with self._changed:
            self._context.wake()
            route = self._changed.wait_for(lambda: self._route_of(topic), _TAP_ANSWER)
        if route is None:
            return {}
        target = route.conversion.target
        key = topic_key(self._context.hub.domain, route.hub_topic, target.name, target.type_id)
        return {"topic": route.hub_topic, "type": target.name, "hash": target.type_id, "key": key}

    def _route_of(self, topic: str) -> SideToHubRoute | None:
        return next((route for route in self.routes() if route.side_topic == topic), None)
