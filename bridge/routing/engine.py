"""The engine of one side: follows both graphs, keeps the routes between them, and reports.

One loop thread owns the routes. It wakes when a graph changes, compares what should be with what is, and touches only
what differs.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from bridge.adapters.base import Edge, Endpoint, Kind
from bridge.config.sections.routing import RoutingSection
from bridge.hub.origin import Origin
from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from bridge.routing.age import Pulse
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.election import Outcome
from bridge.routing.gate import EntryGate, ExitGate
from bridge.routing.inward import Inward
from bridge.routing.joint import Joint
from bridge.routing.outward import Outward
from bridge.routing.route import Route
from bridge.routing.rules import RuleSet
from bridge.routing.services.inward import ServiceInward
from bridge.routing.services.outward import ServiceOutward
from bridge.routing.subject import split
from bridge.routing.typebook import TypeBook
from bridge.routing.verdict import Verdict
from bridge.routing.watch import Watch

_log = logging.getLogger(__name__)

_TICK = 1.0
_LOOK = 10.0  # a look without being woken, should a change ever go untold
_SHARE, _LONGEST = 1000, 60.0  # nor sooner than after so many times what the last one cost: 0.1 % of a core
_RETRY = 2.0  # what was refused may work by now
_SETTLE = 0.02
_ENDS = {
    Kind.SUBSCRIPTION: ("topic", "nobody publishes it; {} would listen"),
    Kind.CLIENT: ("service", "nobody serves it; {} would call"),
}


@dataclass(frozen=True, slots=True)
class Summary:
    """How an engine is.

    Attributes:
        network: identity of the side's network, None while it is away.
        routes: how many there are.
        refused: topics and services that cannot cross.
        rate: messages and calls per second over all routes.
        standing_by: the daemons that are active on the network in our stead, else "".
        waiting: why nothing crosses yet, else "".
    """

    network: str | None
    routes: int
    refused: int
    rate: float
    standing_by: str = ""
    waiting: str = ""

    @property
    def state(self) -> Literal["running", "waiting", "standby"]:
        """One word."""
        if self.standing_by:
            return "standby"
        return "waiting" if self.network is None or self.waiting else "running"

    @property
    def text(self) -> str:
        """What stands beside the word, for people; "" where the network is away."""
        if self.standing_by:
            return f"{self.standing_by} is active on this network"
        if self.network is None or self.waiting:
            return self.waiting if self.network is not None else ""
        refused = f", {self.refused} refused" if self.refused else ""
        return f"{self.routes} routes, {self.rate:.0f} msg/s{refused}"


class Engine:
    """Routes between one edge and the hub."""

    def __init__(
        self,
        edge: Edge,
        hub: Hub,
        routing: RoutingSection,
        daemon: str,
        on_failure: Callable[[str], None],
        registry: Registry | None = None,
    ) -> None:
        self.edge, self.hub = edge, hub
        self._rules = RuleSet(routing)
        self._daemon = daemon
        self._on_failure = on_failure
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._pulse = Pulse(edge.went_on)
        self._beat = time.monotonic()
        self._verdicts: list[Verdict] = []
        self._refused = 0
        self._rate = 0.0
        self._network: str | None = None
        self._types = TypeBook(hub, edge, self.graph_changed)
        small, bulk = (Dispatcher(f"midspan-{edge.side}-{size}") for size in ("small", "bulk"))
        self._watch = Watch(edge, hub, daemon, self._wake.set)
        lease, wake = self._watch.lease, self.graph_changed
        self._joint = Joint(hub, edge, self._pulse, lease, self._types, small, bulk, wake, registry)
        self._members: dict[str, Callable[[], None]] = {}
        self._term = 0
        self._inward, self._outward = Inward(self._joint), Outward(self._joint)
        self._services = ServiceInward(self._joint), ServiceOutward(self._joint)
        self._closers: list[Callable[[], None]] = []
        self._thread = threading.Thread(target=self._run, name=f"midspan-{edge.side}-engine", daemon=True)

    # -- life ----------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start following both graphs."""
        self._joint.small.start()
        self._joint.bulk.start()
        self._closers = [self.hub.graph.watch(self.graph_changed), self._types.serve()]
        self.edge.start(self)
        self._pulse.start()
        self._watch.start()
        self._thread.start()

    def stop(self) -> None:
        """Give back every endpoint on both networks."""
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(3.0)
        for closer in self._closers:
            closer()
        self._closers = []
        self._types.close()
        self._joint.small.stop()
        self._joint.bulk.stop()
        for follower in (*self._services, self._inward, self._outward):
            follower.close()
        self._watch.stop()
        self._pulse.stop()
        self.edge.stop()

    def reload(self, routing: RoutingSection) -> None:
        """Take up other rules; only routes whose decision changed are touched."""
        self._rules = RuleSet(routing)
        self._wake.set()

    def graph_changed(self) -> None:
        """A graph changed: look again soon. Only wakes; may be called from any thread."""
        self._wake.set()
        self._watch.wake()

    def presence_changed(self) -> None:
        """Another Midspan worker came, went or announced something. Only wakes; may be called from any thread."""
        self._watch.wake()

    def message_refused(self, topic: str, reason: str, why: str) -> None:
        """Count a message that the edge took off the wire and refused."""
        for route in self._inward.routes():
            if route.side_topic == topic:
                route.bad(why, reason)

    def edge_failed(self, reason: str) -> None:
        """The edge cannot go on: tell the worker."""
        self._on_failure(reason)

    # -- the loop ------------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        tick = look = 0.0
        while not self._stopping.is_set():
            woken = self._wake.wait(max(0.0, min(tick, look) - time.monotonic()))
            now = time.monotonic()
            if woken or now >= look:
                self._wake.clear()
                cost = time.thread_time()
                try:
                    self._reconcile()
                except Exception as err:
                    _log.exception("%s: following the graphs failed", self.edge.side)
                    self._on_failure(f"following the graphs failed: {err}")
                    return
                cost = time.thread_time() - cost
                pause = _RETRY if self._refused else max(_LOOK, min(_SHARE * cost, _LONGEST))
                look = now + pause
                self._stopping.wait(_SETTLE)
            if now >= tick:
                tick = now + _TICK
                self._rate = sum(route.counters.tick() for route in self.routes())
            self._beat = time.monotonic()

    def _reconcile(self) -> None:
        network = self.edge.network()
        if network != self._network:
            self._change_network(network)
        rules, verdicts, outcome = self._rules, list[Verdict](), self._watch.outcome
        if not outcome.active or outcome.term != self._term:
            why = f"standing by: {outcome.holder} is active on this network" if outcome.holder else outcome.waiting
            self._rest(verdicts, why)
            self._term = outcome.term
        self._tell_members(outcome.members if outcome.active else frozenset())
        if outcome.active:
            verdicts.clear()
            self._follow(rules, verdicts, outcome, network)
        with self._lock:
            self._verdicts = verdicts
        self._refused = sum(1 for verdict in verdicts if verdict.refused)

    def _rest(self, verdicts: list[Verdict], why: str) -> None:
        """Have no routes."""
        inward, outward = self._services
        endpoints = self.edge.endpoints()
        if self.edge.services:
            inward.rest(endpoints, verdicts, why)
            outward.rest(verdicts, why)
        self._inward.rest(endpoints, verdicts, why)
        self._outward.rest(verdicts, why)

    def _follow(self, rules: RuleSet, verdicts: list[Verdict], outcome: Outcome, network: str | None) -> None:
        """Make the routes what both graphs, the rules and the election say."""
        inward, outward = self._services
        endpoints = self.edge.endpoints()
        inward.leave(endpoints)
        outward.leave()
        if network is not None:
            entry = EntryGate(rules, self.edge.side, endpoints)
            self._inward.follow(entry, endpoints, verdicts)
            if self.edge.services:
                inward.follow(entry, endpoints, verdicts)
        leaving = ExitGate(rules, self.edge.side, self._daemon, self.hub.graph.endpoints())
        self._outward.follow(leaving, verdicts, outcome)
        if self.edge.services:
            outward.follow(leaving, endpoints, verdicts, outcome)

    def _tell_members(self, members: frozenset[str]) -> None:
        """Tell on the hub who is on our network, before any endpoint of ours and as long as there may be one."""
        for member in members - self._members.keys():
            self._members[member] = self.hub.graph.announce_member(member)
        for member in self._members.keys() - members:
            self._members.pop(member)()

    def _change_network(self, network: str | None) -> None:
        _log.info("%s network: %s", self.edge.side, network or "away")
        self._services[0].close(f"the {self.edge.side} network of the server is away")
        self._inward.close()
        self._network = network
        self.hub.set_origin(Origin(self.edge.side, network, self._daemon) if network is not None else None)

    def tap(self, topic: str, seconds: float) -> dict[str, str]:
        """Show a topic that does not cross on the hub for so many seconds; see `Inward.tap`."""
        return self._inward.tap(topic, seconds)

    # -- reports -------------------------------------------------------------------------------------------------------

    def alive(self) -> None:
        """Raise `TimeoutError` where the loop or a dispatcher stands still."""
        late = time.monotonic() - self._beat
        if late > 3.0:
            msg = f"the {self.edge.side} engine's loop has not turned for {late:.1f} s"
            raise TimeoutError(msg)
        if self._watch.stuck_for() > 3.0:
            msg = f"watching the other workers on {self.edge.side} has been stuck for {self._watch.stuck_for():.1f} s"
            raise TimeoutError(msg)
        for dispatcher in (self._joint.small, self._joint.bulk):
            stuck = dispatcher.stuck_for()
            if stuck > 4.0:
                msg = f"publishing to {self.edge.side} has been stuck for {stuck:.1f} s"
                raise TimeoutError(msg)

    def routes(self) -> Sequence[Route]:
        """All routes now."""
        inward, outward = self._services
        return [*self._inward.routes(), *self._outward.routes(), *inward.routes(), *outward.routes()]

    def verdicts(self) -> list[Verdict]:
        """What was decided of each topic and service at the last look."""
        with self._lock:
            return list(self._verdicts)

    def summary(self) -> Summary:
        """How the engine is, in numbers; cheap, whatever the number of routes."""
        outcome, routes = self._watch.outcome, len(self.routes())
        return Summary(self._network, routes, self._refused, self._rate, outcome.standing_by, outcome.waiting)

    def status(self) -> dict[str, Any]:
        """Routes, refusals and warnings as they stand in the status document."""
        return {
            "network": self._network,
            "standby": self._watch.outcome.standing_by,
            "waiting": self._watch.outcome.waiting,
            "routes": sorted((r.status() for r in self.routes()), key=lambda r: (str(r["topic"]), str(r["direction"]))),
            "refused": [v.as_dict() for v in self.verdicts() if v.refused],
            "warnings": [*self.edge.warnings(), *self._left_out(), *self._refused_tokens()],
        }

    def _refused_tokens(self) -> list[str]:
        graph = self.hub.graph
        if not graph.refused:
            return []
        return [f"{graph.refused} liveliness tokens on the hub were left out, the last one: {graph.trouble}"]

    def _left_out(self) -> list[str]:
        return sorted({
            f"{route.side_topic}: {', '.join(route.conversion.left_out)} does not cross: this machine's"
            f" {route.hub_type} has no such field (the publisher's md5 is {route.conversion.source.type_id})"
            for route in self._inward.routes()
            if route.conversion.left_out
        })  # fmt: skip

    def explain(self, topic: str) -> list[dict[str, Any]]:
        """Everything that was decided of a topic, a service or an action; of all for ``""``.

        It goes by the name on the side and by that on the hub; an action's is that of its five parts.
        """
        name = topic if topic.startswith("/") or not topic else "/" + topic

        def wanted(*names: str) -> bool:
            return not name or any(name in (each, split(each)[0]) for each in names)

        found = [v.as_dict() for v in self.verdicts() if wanted(v.topic, v.hub_topic)]
        told = {str(entry[key]) for entry in found for key in ("topic", "hub_topic")}
        ends: dict[tuple[Kind, str], list[Endpoint]] = defaultdict(list)
        for endpoint in self.edge.endpoints():
            if endpoint.kind in _ENDS and wanted(endpoint.topic) and endpoint.topic not in told:
                ends[endpoint.kind, endpoint.topic].append(endpoint)
        for (kind, name_heard), endpoints in ends.items():
            of, text = _ENDS[kind]
            why = text.format(", ".join(sorted({e.node for e in endpoints})))
            found.append(Verdict.one_ended(name_heard, endpoints[0].type, why, of).as_dict())
        return found
