"""The engine of one side: follows both graphs, maintains the routes between them, and reports.

One loop thread owns the routes. When a graph changes, it compares the wanted routes with the existing ones and updates
only the differences.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from bridge.config.sections.routing import RoutingSection
from bridge.hub.graph.tokens import Origin
from bridge.hub.session import Hub
from bridge.messages.actions import split
from bridge.messages.registry import Registry
from bridge.progress import StepWatch
from bridge.routing.decision import RouteDecision
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.edge import Edge, Endpoint, Kind
from bridge.routing.election import Outcome
from bridge.routing.gates import EntryGate, ExitGate
from bridge.routing.hold import Hold
from bridge.routing.hub_to_side import HubToSideTopics
from bridge.routing.peer_watch import PeerWatch
from bridge.routing.route import EngineContext, Route
from bridge.routing.rules import RuleSet
from bridge.routing.services.hub_to_side import HubToSideServices
from bridge.routing.services.side_to_hub import SideToHubServices
from bridge.routing.side_to_hub import SideToHubTopics
from bridge.routing.stall import StallDetector
from bridge.routing.type_exchange import TypeExchange
from bridge.status import Lease, RefusedRoute, WorkerStatus

_log = logging.getLogger(__name__)

_TICK = 1.0
_POLL = 10.0  # a check without a wake-up, in case a notification is missed
_SHARE, _LONGEST = 1000, 60.0  # the pause is at least 1000 times the last cost: 0.1 % of a core
_RETRY = 2.0  # refused routes may work by now
_SETTLE = 0.02
_STEP_SECONDS = 3.0  # a loop step without progress for longer hangs
_ENDS = {
    Kind.SUBSCRIPTION: ("topic", "it has no publisher; subscribed by {}"),
    Kind.CLIENT: ("service", "it has no server; clients: {}"),
}


@dataclass(frozen=True, slots=True)
class Summary:
    """State of an engine; ``network`` is None while unavailable, ``rate`` messages and calls per second of all routes.

    ``standing_by`` names the daemons that are active instead, ``waiting`` is the reason why nothing crosses yet.
    """

    network: str | None
    routes: int
    refused: int
    rate: float
    standing_by: str = ""
    waiting: str = ""

    @property
    def state(self) -> Literal["running", "waiting", "standby"]:
        """The state in one word."""
        if self.standing_by:
            return "standby"
        return "waiting" if self.network is None or self.waiting else "running"

    @property
    def text(self) -> str:
        """Details of the state for people; "" while the network is unavailable."""
        if self.standing_by:
            return f"{self.standing_by} is active on this network"
        if self.network is None or self.waiting:
            return self.waiting if self.network is not None else ""
        refused = f", {self.refused} refused" if self.refused else ""
        return f"{self.routes} routes, {self.rate:.0f} msg/s{refused}"


class Engine:
    """Routes between one edge and the hub."""

    def __init__(
        self, edge: Edge, hub: Hub, routing: RoutingSection, daemon: str, on_failure: Callable[[str], None],
        registry: Registry | None = None, hold: Hold | None = None,
    ) -> None:  # fmt: skip
        self.edge, self.hub = edge, hub
        self._rules = RuleSet(routing)
        self._daemon = daemon
        self._on_failure = on_failure
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._stall_detector = StallDetector(edge.resumed)
        self._beat = time.monotonic()
        self._step = StepWatch(_STEP_SECONDS)
        self._decisions: list[RouteDecision] = []
        self._refused = 0
        self._rate = 0.0
        self._network: str | None = None
        self._types = TypeExchange(hub, edge, self.graph_changed)
        small, bulk = (Dispatcher(f"midspan-{edge.side}-{size}") for size in ("small", "bulk"))
        self._peers = PeerWatch(edge, hub, daemon, self._wake.set)
        lease, wake = self._peers.lease, self.graph_changed
        self._context = EngineContext(
            hub, edge, self._stall_detector, lease, self._types, small, bulk, wake, registry, hold
        )
        self._members: dict[str, Callable[[], None]] = {}
        self._term = 0
        self._topics_to_hub, self._topics_to_side = SideToHubTopics(self._context), HubToSideTopics(self._context)
        self._services_to_hub = SideToHubServices(self._context)
        self._services_to_side = HubToSideServices(self._context)
        self._route_sets = (self._services_to_hub, self._services_to_side, self._topics_to_hub, self._topics_to_side)
        self._closers: list[Callable[[], None]] = []
        self._thread = threading.Thread(target=self._run, name=f"midspan-{edge.side}-engine", daemon=True)

    # -- life ----------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start following both graphs."""
        self._context.small.start()
        self._context.bulk.start()
        self._closers = [self.hub.graph.watch(self.graph_changed), self._types.serve()]
        self.edge.start(self)
        self._stall_detector.start()
        self._peers.start()
        self._thread.start()

    def stop(self) -> None:
        """Close every endpoint on both networks."""
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(3.0)
        for closer in self._closers:
            closer()
        self._closers = []
        self._types.close()
        self._context.small.stop()
        self._context.bulk.stop()
        for routes in self._route_sets:
            routes.close()
        self._peers.stop()
        self._stall_detector.stop()
        self.edge.stop()

    def reload(self, routing: RoutingSection) -> None:
        """Apply new rules; only routes whose policy changed are updated."""
        self._rules = RuleSet(routing)
        self._wake.set()

    def graph_changed(self) -> None:
        """Schedule a check after a graph change. Only wakes; may be called from any thread."""
        self._wake.set()
        self._peers.wake()

    def presence_changed(self) -> None:
        """Handle a change of other Midspan workers. Only wakes; may be called from any thread."""
        self._peers.wake()

    def message_refused(self, topic: str, reason: str, why: str) -> None:
        """Count a message that the edge received and refused."""
        for route in self._topics_to_hub.routes():
            if route.side_topic == topic:
                route.bad(why, reason)

    def edge_failed(self, reason: str) -> None:
        """Fail the worker: the edge cannot continue."""
        self._on_failure(reason)

    # -- the loop ------------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        self._step.begin()
        tick = check = 0.0
        while not self._stopping.is_set():
            woken = self._wake.wait(max(0.0, min(tick, check) - time.monotonic()))
            now = time.monotonic()
            if woken or now >= check:
                self._wake.clear()
                cost = time.thread_time()
                try:
                    self._reconcile()
                except Exception as err:
                    _log.exception("%s: following the graphs failed", self.edge.side)
                    self._on_failure(f"following the graphs failed: {err}")
                    return
                cost = time.thread_time() - cost
                pause = _RETRY if self._refused else max(_POLL, min(_SHARE * cost, _LONGEST))
                check = now + pause
                self._stopping.wait(_SETTLE)
            if now >= tick:
                tick = now + _TICK
                self._rate = sum(route.counters.tick() for route in self.routes())
            self._beat = time.monotonic()

    def _reconcile(self) -> None:
        network = self.edge.network()
        if network != self._network:
            self._change_network(network)
        rules, decisions, outcome = self._rules, list[RouteDecision](), self._peers.outcome
        if not outcome.active or outcome.term != self._term:
            reason = f"on standby: {outcome.holder} is active on this network" if outcome.holder else outcome.waiting
            self._stand_by(decisions, reason)
            self._term = outcome.term
        self._announce_members(outcome.members if outcome.active else frozenset())
        if outcome.active:
            decisions.clear()
            self._follow(rules, decisions, outcome, network)
        with self._lock:
            self._decisions = decisions
        self._refused = sum(1 for decision in decisions if decision.refused)

    def _stand_by(self, decisions: list[RouteDecision], why: str) -> None:
        endpoints = self.edge.endpoints()
        for routes in self._route_sets:
            if self.edge.services or routes.kind == "topic":
                routes.stand_by(endpoints, decisions, why)

    def _follow(self, rules: RuleSet, decisions: list[RouteDecision], outcome: Outcome, network: str | None) -> None:
        """Bring the routes in line with both graphs, the rules and the election."""
        endpoints = self.edge.endpoints()
        self._services_to_hub.close_departed(endpoints)
        self._services_to_side.close_departed()
        if network is not None:
            entry = EntryGate(rules, self.edge.side, endpoints)
            self._topics_to_hub.follow(entry, endpoints, decisions)
            if self.edge.services:
                self._services_to_hub.follow(entry, endpoints, decisions)
        leaving = ExitGate(rules, self.edge.side, self._daemon, self.hub.graph.endpoints())
        self._topics_to_side.follow(leaving, decisions, outcome)
        if self.edge.services:
            self._services_to_side.follow(leaving, endpoints, decisions, outcome)

    def _announce_members(self, members: frozenset[str]) -> None:
        """Announce the network's members on the hub before any endpoint of this engine, and until none can exist."""
        for member in members - self._members.keys():
            self._members[member] = self.hub.graph.announce_member(member)
        for member in self._members.keys() - members:
            self._members.pop(member)()

    def _change_network(self, network: str | None) -> None:
        _log.info("%s network: %s", self.edge.side, network or "unavailable")
        if network is None or not self.edge.outlives_network:
            self._services_to_hub.close(f"the {self.edge.side} network of the server is unavailable")
            self._topics_to_hub.close()
        self._network = network
        self.hub.set_origin(Origin(self.edge.side, network, self._daemon) if network is not None else None)

    def tap(self, topic: str, seconds: float) -> dict[str, str]:
        """Show a topic that does not cross on the hub for a number of seconds; see `SideToHubTopics.tap`."""
        return self._topics_to_hub.tap(topic, seconds)

    # -- reports -------------------------------------------------------------------------------------------------------

    def alive(self) -> str:
        """Raise `TimeoutError` if the loop or a dispatcher hangs; return a text about a busy loop, or ""."""
        reports = [
            self._step.judge(f"the {self.edge.side} engine's loop", self._beat),
            self._peers.alive(),
            *(d.alive(f"publishing to {self.edge.side}") for d in (self._context.small, self._context.bulk)),
        ]
        return next(filter(None, reports), "")

    def routes(self) -> Sequence[Route]:
        """Return all current routes."""
        return [route for routes in self._route_sets for route in routes.routes()]

    def decisions(self) -> list[RouteDecision]:
        """Return the decisions on each topic and service at the last check."""
        with self._lock:
            return list(self._decisions)

    def summary(self) -> Summary:
        """Return the engine's state in numbers; cheap with any number of routes."""
        outcome, routes = self._peers.outcome, len(self.routes())
        return Summary(self._network, routes, self._refused, self._rate, outcome.standing_by, outcome.waiting)

    def status(self, warnings: Sequence[str] = (), **fields: Any) -> WorkerStatus:
        """Return the status document: routes, refusals and warnings, with further fields and warnings."""
        outcome = self._peers.outcome
        routes = (route.status() for route in self.routes())
        return WorkerStatus(
            **fields,
            network=self._network,
            standby=outcome.standing_by,
            waiting=outcome.waiting,
            lease=Lease(active=outcome.active, changes=self._peers.changes, members=len(outcome.members)),
            routes=sorted(routes, key=lambda route: (route.topic, route.direction)),
            refused=[RefusedRoute(**decision.as_dict()) for decision in self.decisions() if decision.refused],
            warnings=[*self.edge.warnings(), *self._left_out(), *self._refused_tokens(), *warnings],
        )

    def _refused_tokens(self) -> list[str]:
        graph = self.hub.graph
        if not graph.refused:
            return []
        return [f"{graph.refused} liveliness tokens on the hub were ignored, the last one: {graph.trouble}"]

    def _left_out(self) -> list[str]:
        return sorted({
            f"{route.side_topic}: {', '.join(route.conversion.left_out)} does not cross: this machine's"
            f" {route.hub_type} has no such field (the publisher's md5 is {route.conversion.source.type_id})"
            for route in self._topics_to_hub.routes()
            if route.conversion.left_out
        })  # fmt: skip

    def explain(self, topic: str) -> list[dict[str, Any]]:
        """Return all decisions on a topic, service or action; on everything for ``""``.

        The name on the side and the one on the hub both match; an action's name matches its five parts.
        """
        name = topic if topic.startswith("/") or not topic else "/" + topic

        def wanted(*names: str) -> bool:
            return not name or any(name in (candidate, split(candidate)[0]) for candidate in names)

        decisions = [v.as_dict() for v in self.decisions() if wanted(v.topic, v.hub_topic)]
        decided = {str(entry[key]) for entry in decisions for key in ("topic", "hub_topic")}
        ends: dict[tuple[Kind, str], list[Endpoint]] = defaultdict(list)
        for endpoint in self.edge.endpoints():
            if endpoint.kind in _ENDS and wanted(endpoint.topic) and endpoint.topic not in decided:
                ends[endpoint.kind, endpoint.topic].append(endpoint)
        for (kind, topic_name), endpoints in ends.items():
            of, text = _ENDS[kind]
            reason = text.format(", ".join(sorted({e.node for e in endpoints})))
            decisions.append(RouteDecision.one_ended(topic_name, endpoints[0].type, reason, of).as_dict())
        return decisions
