"""Topic routes from the hub to the side, and the set that opens and closes them."""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Iterable, Sequence

from typing_extensions import override

from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import Origin
from bridge.hub.lane.lent import LentPayload
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.copies import copied
from bridge.messages.errors import MessageError
from bridge.messages.transcode.conversion import Conversion
from bridge.routing.admission import carries_commands
from bridge.routing.backlog import HeldMessage
from bridge.routing.counters import LATENCY_BOUNDS
from bridge.routing.decision import OWN_NETWORK, RouteDecision, RouteKey, hub_groups
from bridge.routing.dispatcher import RouteQueue
from bridge.routing.edge import EdgePublisher, Endpoint
from bridge.routing.election import Outcome
from bridge.routing.gates import ExitGate, may_carry, may_leave
from bridge.routing.hub_end import HeldSamples, HubSource, HubSources, RouteSubscription
from bridge.routing.limits import QUEUE_DEPTH, Priority, combined_qos, stream_depth
from bridge.routing.rewrites import TF_TYPE, with_spread
from bridge.routing.route import EngineContext, RouteSet, TopicRoute
from bridge.routing.rules import RoutePolicy
from bridge.routing.shortcut import Exit
from bridge.routing.side_publishers import STATIC, SidePublishers
from bridge.routing.velocities import native_velocities, preferred_type, velocity_to_side
from bridge.status import RouteStatus

PENDING_SECONDS = 2.0
"""Seconds for which a message from an unknown publisher is held."""


class HubToSideRoute(TopicRoute):
    """Publishes one topic and type of the hub on the side.

    Each latched hub publisher remains a separate source on the side. Samples from publishers that the engine did not
    allow (on this same network, or not yet known) are not published. A fast stream without a subscriber on the side is
    not subscribed to on the hub.

    The engine's loop calls `update` and replaces the sources; samples arrive on the receiving threads of zenoh and the
    lane. All these threads publish only while they hold ``queue.publishing``, except that the exit (in C) publishes
    while no thread holds it; the backlogs have their own locks.

    Attributes:
        origin: origin of the topic's first publisher, None for a native program on the hub.
        queue: publishes or queues each message that arrives.
        held: messages that wait for the classification of their publishers, or for the lease.
    """

    direction = "out"

    def __init__(
        self, key: RouteKey, side_topic: str, origin: Origin | None, conversion: Conversion, policy: RoutePolicy,
        context: EngineContext,
    ) -> None:  # fmt: skip
        super().__init__(key, (key.topic, side_topic), with_spread(conversion, key.topic), policy, context)
        self.origin = origin
        self._followed: tuple[Sequence[HubEndpoint], ...] = ()
        self._sources = HubSources()
        self._subscription = RouteSubscription(self._subscribe)
        self._publishers = SidePublishers(self._advertise)
        admits = None if self._limit is None else self._admits
        self.queue = RouteQueue(context.small, context.bulk, self.handle, self.crowded_out, admits)
        self.held = HeldSamples(self.crowded_out)
        self._exit = self.counters.exit = self._make_exit()

    def _make_exit(self) -> Exit | None:
        """Return the shorter path for small messages; None if each message needs a check that only Python makes."""
        if Exit is None or not self._is_plain():
            return None
        conditions = self._lease, self._context.hold, (self.queue.line, self.held.unknown.line), self.queue.locked
        return Exit(*conditions, self._program, self._max_payload, LATENCY_BOUNDS)

    # -- the engine's loop ---------------------------------------------------------------------------------------------

    def update(
        self, allowed: Sequence[HubEndpoint], refused: Sequence[HubEndpoint], waiting: Sequence[HubEndpoint] = ()
    ) -> None:
        """Follow the hub's publishers of this topic; called only by the engine's loop.

        ``waiting``: publishers that may be allowed later, when their origin is known or the election has ended. Their
        latched messages are stored until then, because they arrive only once.
        """
        followed = (allowed, refused, waiting)
        if followed != self._followed:
            self._followed = ()  # in case the update fails
            self._follow(allowed, refused, waiting)
            self._followed = followed
        self._follow_demand(allowed)
        self._release_latched()
        self._retry_pending()

    def _follow(
        self, allowed: Sequence[HubEndpoint], refused: Sequence[HubEndpoint], waiting: Sequence[HubEndpoint]
    ) -> None:
        before = self._sources.allowed
        sources = self._sources.updated(allowed, refused, waiting, self.latches)
        if self._exit is not None:
            self._exit.allow(())
        self._open_publishers(sources.allowed.values())  # before a message of a new source needs one
        self._sources = sources
        self._allow_plain()
        for gid in before.keys() - self._sources.allowed.keys():
            if before[gid].latched and not self.static:
                self._publishers.drop_source(gid, sources.allowed)
                self._subscription.depart(gid)
        if allowed and not self._subscription.paused:
            self._receive_from(allowed)
        self._subscription.request_returned(self._sources.allowed, self.queue.publishing, self._remove_held)

    def _allow_plain(self) -> None:
        """Let the exit send the messages of publishers that need no special care."""
        if self._exit is not None and self._priority is not Priority.COMMAND:
            self._exit.send_by(getattr(self._publishers.volatile, "native", None))
            self._exit.allow(frozenset(gid for gid, source in self._sources.allowed.items() if not source.latched))

    def _open_publishers(self, sources: Iterable[HubSource]) -> None:
        latched = [s.endpoint.qos.depth for s in sources if s.latched]
        volatile = [s.endpoint.qos.depth for s in sources if not s.latched]
        self._priority = self.queue.priority = self.priority_of(latched=bool(latched))
        self.queue.depth = self.policy.depth or QUEUE_DEPTH[self._priority]
        if latched:
            self._publishers.open_latched(max(latched), transforms=self.hub_type == TF_TYPE)
        if volatile and self._publishers.volatile is None:
            if self._priority is Priority.COMMAND:
                self._publishers.open_volatile(1, int(self.policy.timeout * 1e9))
            else:
                self._publishers.open_volatile(max(stream_depth(self.conversion.source.definition), *volatile))

    def _advertise(self, qos: Qos) -> EdgePublisher:
        return self._context.edge.advertise(self.side_topic, self.conversion.target, self.override(qos))

    def _follow_demand(self, allowed: Sequence[HubEndpoint]) -> None:
        """Unsubscribe from a fast stream while the side has no subscriber; subscribe again when one appears."""
        streams = self._priority is Priority.STREAM and self._publishers.latched is None
        volatile = self._publishers.volatile if streams else None
        wanted = volatile is None or volatile.has_subscribers
        self._subscription.follow_demand(self.counters.messages, wanted=wanted)
        if allowed and not self._subscription.open and not self._subscription.paused:
            self._receive_from(allowed)

    def _receive_from(self, publishers: Sequence[HubEndpoint]) -> None:
        qos = combined_qos([e.qos for e in publishers])
        if self._priority is Priority.COMMAND:
            qos = Qos(qos.reliability, Durability.VOLATILE, depth=1)
        if self._subscription.request(qos):
            self._qos = qos

    def _remove_held(self, sources: Collection[bytes]) -> None:
        """Remove the held messages of publishers whose caches will deliver them. Requires ``queue.publishing``."""
        self.held.remove(sources)
        self.queue.remove(sources)

    def _subscribe(self, qos: Qos) -> HubSubscription:
        if qos.latched:
            allowed = (source.endpoint for source in self._sources.allowed.values())
            endpoints = (*allowed, *self._sources.waiting.values())
            with self.queue.publishing:
                self._remove_held({e.gid for e in endpoints if e.qos.latched and e.qos.depth <= qos.depth})
        source = self.conversion.source
        subscription = self._context.hub.subscription(
            self.hub_topic, source.name, self.key.type_id, qos, self.queue.receive, self._refused_by_hub
        )
        if self._exit is not None:
            self._exit.since = self._subscription.since
            subscription.hand_to(self._exit)
        return subscription

    def _release_latched(self) -> None:
        if self._lease.over or not self.held.latched:
            return
        sources = self._sources
        with self.queue.publishing:  # before the removal: a newer message must not overtake these
            for waiting in self.held.latched.pop_matching(lambda w: w.source not in sources.waiting):
                source = sources.allowed.get(waiting.message.gid)
                if source is not None:
                    self._publish(waiting.message, source)

    def _retry_pending(self) -> None:
        before = self.held.unknown.overdue(PENDING_SECONDS)
        if self.held.unknown:
            with self.queue.publishing:  # before the removal: a newer message must not overtake these
                for pending in self.held.unknown.pop_matching(lambda _: True):
                    self._retry(pending, before)

    def _retry(self, pending: HeldMessage[HubSample], before: float) -> None:
        sample, sources = pending.message, self._sources
        source, endpoint = sources.of(sample), sources.waiting.get(sample.gid)
        if source is not None:
            if not self.over_rate(sample.data, latched=source.latched):
                self._publish(sample, source)
        elif endpoint is not None:
            if self.latches(endpoint.qos):
                self.held.add_latched(sample, endpoint)
        elif sample.gid not in sources.refused and pending.since >= before:
            self.held.unknown.put_back(pending)
        elif sample.gid not in sources.refused:
            self.counters.dropped("unknown")

    # -- samples -------------------------------------------------------------------------------------------------------

    def _refused_by_hub(self, reason: str, why: str) -> None:
        """Count a sample that the hub subscription refused; called on a receiving thread."""
        self.bad(why, reason)

    def _admits(self, sample: HubSample) -> bool:
        source = self._sources.of(sample)
        return source is None or not self.over_rate(sample.data, latched=source.latched)

    def handle(self, sample: HubSample) -> None:
        """Publish a message on the side, or hold it until its publisher is known.

        The loop may replace the sources meanwhile, and then handles the messages that are held or retained. So this
        method checks the sources again after it has held or retained a message.
        """
        sources = self._sources
        source = sources.allowed.get(sample.gid) or sources.of(sample)
        waiting = sources.waiting.get(sample.gid)
        latched = waiting is not None and self.latches(waiting.qos) if source is None else source.latched
        if latched and self.held.unknown.holds(sample.gid):
            self.held.add_unknown(sample)
            self._context.wake()
        elif latched and sample.gid in sources.allowed and self.held.latched.holds(sample.gid):
            self.held.add_latched(sample, sources.allowed[sample.gid].endpoint)  # after the older ones
            if not self._lease.over:
                self._context.wake()
        elif source is not None:
            if self.held.unknown.holds(sample.gid):  # of a publisher that has just become known
                for pending in self.held.unknown.pop_matching(lambda w: w.source == sample.gid):
                    self._retry(pending, -math.inf)
            self._publish(sample, source)
            if latched and source.endpoint.gid not in self._sources.allowed:
                self._publishers.drop_source(sample.gid)
        elif waiting is not None:
            if latched:
                self.held.add_latched(sample, waiting)
                if self._sources is not sources:
                    self._context.wake()
        elif sample.gid not in sources.refused:
            if self._priority is Priority.COMMAND:  # a command is never stored for later
                self.counters.dropped("unknown")
            else:
                self.held.add_unknown(sample)
            self._context.wake()

    def _is_blocked(self, source: HubSource) -> bool:
        """Return whether a message of a planner on the hub may not pass now; Midspan's own zeros may."""
        hold, endpoint = self._context.hold, source.endpoint
        return (
            hold is not None
            and hold.blocks_native(self.hub_topic)
            and endpoint.origin is None
            and not self._context.hub.graph.is_midspan(endpoint.zid)
        )

    def _publish(self, sample: HubSample, source: HubSource) -> None:
        if self._lease.over:
            if source.latched:
                self.held.add_latched(sample, source.endpoint)
                if not self._lease.over:  # it returned meanwhile, and its check may not have seen the message
                    self._context.wake()
            else:
                self.counters.dropped("standby")
            return
        if self._is_blocked(source):
            self.counters.dropped("held")
            return
        if self._priority is Priority.COMMAND and self.is_stale(sample.data, source.age, sample.source_time_ns):
            self.counters.dropped("stale")
            return
        publishers = self._publishers
        publisher = publishers.latched if source.latched else publishers.volatile
        if publisher is None:
            self.counters.dropped("unknown")
            return
        try:
            lent = sample.payload  # it stays valid while it is referenced
            if source.latched or not isinstance(lent, LentPayload):
                size = self._send(publisher, sample, source)
            else:
                size = self._send_lent(publisher, lent, sample.gid.hex())
        except (MessageError, ValueError) as err:
            self.bad(str(err))
            return
        if size is None:
            return
        self.counters.crossed(size)
        # A message cached for late joiners has no latency to count. Compare monotonic times: the clock may be set.
        latency = time.time_ns() - sample.source_time_ns
        if time.monotonic() - latency / 1e9 >= self._subscription.since:
            self.counters.add_latency(latency)

    def _send(self, publisher: EdgePublisher, sample: HubSample, source: HubSource) -> int | None:
        """Convert and publish a message; return its size, None if it is too large."""
        data, name, publishers = sample.data(), sample.gid.hex(), self._publishers
        if source.latched and sample.gid != source.endpoint.gid:
            publishers.add_invented(source.endpoint.gid, sample.gid)
        if source.latched and publishers.static is not None:
            data, name = publishers.static.merge(data), STATIC
        if self.conversion.convert is not None:
            data = self.conversion.convert(data)
        if self.too_large(len(data)):
            return None
        publisher.send(data, name)
        return len(data)

    def _send_lent(self, publisher: EdgePublisher, lent: LentPayload, name: str) -> int | None:
        """Convert and publish a message from the writer's memory; return its size, None if it is too large."""
        data = self._direct.read(lent.view)
        if self.too_large(len(data)):
            return None
        if isinstance(data, memoryview) and not self._context.edge.sends_views:
            data = copied(data)
        publisher.send(data, name)  # type: ignore[arg-type]  # a view only if it is accepted
        return len(data)

    @property
    @override
    def static(self) -> bool:
        return self._publishers.static is not None

    @override
    def close(self, why: str = "") -> None:  # only pending calls need the reason
        if self._exit is not None:
            self._exit.open = False
            self._exit.send_by(None)
        self._subscription.close()
        self._publishers.close()
        self.queue.clear()

    @override
    def status(self) -> RouteStatus:
        if (losses := self._subscription.losses()) is not None:
            self.counters.missed(*losses)
        self.counters.drops["slow"] = self._publishers.dropped
        status = self.describe(len(self._sources.allowed), *self._subscription.status())
        paused = self._subscription.paused and status.state == "active"
        return status.model_copy(update={"state": "unheard"}) if paused else status


class HubToSideTopics(RouteSet[tuple[RouteKey, str], HubToSideRoute]):
    """The routes of the topics that the hub's publishers send."""

    direction = "out"
    _outcome = Outcome()
    _velocities: Collection[tuple[str, str]] = ()

    @override
    def candidates(self, endpoints: Sequence[Endpoint]) -> set[tuple[str, str]]:  # only the hub's graph matters
        publishers = self._context.hub.graph.publishers()
        return {(e.topic, e.type_name) for e in publishers if may_leave(e, self._context.edge)}

    def follow(
        self, gate: ExitGate, endpoints: Sequence[Endpoint], decisions: list[RouteDecision], outcome: Outcome
    ) -> None:
        """Update the routes according to both graphs, the rules and the election; append a decision for each topic."""
        self._outcome, self._velocities = outcome, native_velocities(endpoints)
        groups = hub_groups(self._context.hub.graph.publishers(), self._context.hub.versions)
        # Close ended routes first: a side may have one type per topic.
        outdated = (
            k
            for k, route in self._routes.items()
            if k[0] not in groups or preferred_type(k[1], route.side_type, self._velocities)
        )
        self._end(list(outdated), gate)
        live: set[tuple[RouteKey, str]] = set()
        for key, publishers in groups.items():
            self._follow(key, publishers, gate, live, decisions)
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
            conversion = decision.convert(lambda: velocity_to_side(edge, key.type_name, key.type_id, policy))
            if conversion is None:
                self._context.types.ask(key.type_name, key.type_id)
                return
            if other := preferred_type(side_topic, conversion.target.name, self._velocities):
                decision.refuse(
                    f"nodes on the side subscribe to {side_topic} as {other}",
                    f"convert it with a rule: 'to: {edge.side}', 'stamped: {str('Stamped' in other).lower()}'",
                )
                return
            commands = carries_commands(policy, (key.topic, side_topic), conversion.source.name)
            if edge.one_queue and not self._share_topic(side_topic, decision, commands=commands):
                return
            origin = endpoints[0][0].origin
            route = self._routes[out_key] = HubToSideRoute(key, side_topic, origin, conversion, policy, self._context)
        live.add(out_key)
        route.attempt(lambda: route.update(*endpoints), decision)

    def _share_topic(self, side_topic: str, decision: RouteDecision, *, commands: bool) -> bool:
        """Close the routes that the commands of a new route exclude from its topic; refuse it if it is excluded itself.

        Return whether the route may exist. Commands have precedence whichever came first: one of them may be a stop.
        """
        others = [k for k, r in self._routes.items() if k[1] == side_topic and r.commands is not commands]
        if others and not commands:
            decision.refuse(
                f"{side_topic} has commands, which are not queued, so it cannot have other messages, too",
                "set `priority: command` in the rules of both topics, or rename one of the two",
            )
            return False
        for key in others:
            self._routes.pop(key).close()
            self._context.wake()  # the next check refuses them
        return True
