"""The engine of one side: it follows both graphs, maintains the routes between them, and reports their state.

One loop thread owns the routes. When a graph changes, it compares the wanted routes with the existing ones and updates
only the differences.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from bridge.config.sections.routing import RoutingSection
from bridge.hub.graph.tokens import Origin
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from bridge.routing.check_loop import CheckLoop
from bridge.routing.decision import RouteDecision
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.edge import Edge
from bridge.routing.explain import explain
from bridge.routing.hold import Hold
from bridge.routing.peer_watch import PeerWatch
from bridge.routing.route import EngineContext, Route
from bridge.routing.routes import EngineRoutes
from bridge.routing.rules import RuleSet
from bridge.routing.stall import StallDetector
from bridge.routing.type_exchange import TypeExchange
from bridge.status import Lease, RefusedRoute, WorkerStatus

_log = logging.getLogger(__name__)

_RATE_SECONDS = 0.9
"""Minimum seconds between two measurements of the rates, less than `bridge.daemon.protocol.QUIET_INTERVAL`."""


@dataclass(frozen=True, slots=True)
class Summary:
    """The state of an engine. ``network`` is None while unavailable; ``rate`` is in messages and calls per second.

    ``standing_by`` names the daemons that are active instead; ``waiting`` is the reason why nothing is bridged yet.
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


class NetworkTokens:
    """Announces on the hub the network that an engine bridges, the network's members, and its subscribed velocities.

    The members are the workers on the network. Only the engine's loop calls the methods; any thread may read
    ``network``, which is None while the network is unavailable.
    """

    def __init__(self, hub: Hub, side: str, daemon: str) -> None:
        self._hub, self._side, self._daemon = hub, side, daemon
        self.network: str | None = None
        self._members: dict[str, Callable[[], None]] = {}
        self._velocities: dict[tuple[str, str], Callable[[], None]] = {}

    def change(self, network: str | None) -> None:
        """Announce a changed network, or withdraw the announcement if it is None."""
        self.network = network
        self._hub.set_origin(Origin(self._side, network, self._daemon) if network is not None else None)

    def announce_members(self, members: frozenset[str]) -> None:
        """Announce the members; call it before endpoints are opened, and with no members once all are closed."""
        for member in members - self._members.keys():
            self._members[member] = self._hub.graph.announce_member(member)
        for member in self._members.keys() - members:
            self._members.pop(member)()

    def announce_velocities(self, velocities: frozenset[tuple[str, str]]) -> None:
        """Announce the hub topics and types of the velocities that the side's own nodes subscribe to."""
        for topic, type_name in velocities - self._velocities.keys():
            self._velocities[topic, type_name] = self._hub.graph.announce_velocity(topic, type_name)
        for velocity in self._velocities.keys() - velocities:
            self._velocities.pop(velocity)()


class _Checked(NamedTuple):
    """The result of a check, which is replaced as a whole so that any thread can read it without a lock."""

    decisions: tuple[RouteDecision, ...] = ()
    refused: int = 0


class Engine:
    """Routes between one edge and the hub.

    Only the thread of the check loop decides on the routes, and writes the last check, the rate and the tokens. Other
    threads may read these, each of which is replaced as a whole, and wake the loop.
    """

    def __init__(
        self, edge: Edge, hub: Hub, routing: RoutingSection, daemon: str, on_failure: Callable[[str], None],
        registry: Registry | None = None, hold: Hold | None = None,
    ) -> None:  # fmt: skip
        self.edge, self.hub = edge, hub
        self._on_failure = on_failure
        self._loop = CheckLoop(edge.side, self._check, on_failure)
        self._peers = PeerWatch(edge, hub, daemon, self._loop.wake)
        small, bulk = (Dispatcher(f"midspan-{edge.side}-{size}") for size in ("small", "bulk"))
        types, wake = TypeExchange(hub, edge, self.graph_changed), self.graph_changed
        self._context = EngineContext(
            hub, edge, StallDetector(edge.resumed), self._peers.lease, types, small, bulk, wake, registry, hold
        )
        self._routes = EngineRoutes(self._context, daemon, RuleSet(routing))
        self._tokens = NetworkTokens(hub, edge.side, daemon)
        self._term = 0
        self._checked = _Checked()
        self._rate, self._rate_at = 0.0, time.monotonic()
        self._closers: list[Callable[[], None]] = []

    @property
    def stall_detector(self) -> StallDetector:
        """Detects that this process was suspended; runs between `start` and `stop`."""
        return self._context.stall_detector

    # -- life ----------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start following both graphs."""
        context = self._context
        context.small.start()
        context.bulk.start()
        self._closers = [self.hub.graph.watch(self.graph_changed), context.types.serve()]
        self.edge.start(self)
        context.stall_detector.start()
        self._peers.start()
        self._loop.start()

    def stop(self) -> None:
        """Close every endpoint on both networks."""
        context = self._context
        self._loop.stop()
        for closer in self._closers:
            closer()
        self._closers = []
        context.types.close()
        context.small.stop()
        context.bulk.stop()
        self._routes.close()
        context.held_calls.close()
        context.later.close(1.0)
        self._peers.stop()
        context.stall_detector.stop()
        self.edge.stop()

    def reload(self, routing: RoutingSection) -> None:
        """Apply new rules; only routes whose policy changed are closed and opened again."""
        self._routes.rules = RuleSet(routing)
        self._loop.wake()

    def graph_changed(self) -> None:
        """Schedule a check after a graph change. Only wakes a thread; may be called from any thread."""
        self._loop.wake()
        self._peers.wake()

    def presence_changed(self) -> None:
        """Handle a change of other Midspan workers. Only wakes a thread; may be called from any thread."""
        self._peers.wake()

    def message_refused(self, topic: str, reason: str, why: str) -> None:
        """Count a message that the edge received and refused."""
        for route in self._routes.topics_to_hub.routes():
            if route.side_topic == topic:
                route.bad(why, reason)

    def edge_failed(self, reason: str) -> None:
        """Fail the worker, because the edge cannot continue."""
        self._on_failure(reason)

    # -- the loop ------------------------------------------------------------------------------------------------------

    def _check(self) -> bool:
        """Compare the wanted routes with the existing ones; return whether any is refused and has to be tried again."""
        network = self.edge.network()
        if network != self._tokens.network:
            self._change_network(network)
        outcome, decisions = self._peers.outcome, list[RouteDecision]()
        if not outcome.active or outcome.term != self._term:
            decisions = self._routes.stand_by(
                f"on standby: {outcome.holder} is active on this network" if outcome.holder else outcome.waiting
            )
            self._term = outcome.term
        self._tokens.announce_members(outcome.members if outcome.active else frozenset())
        if outcome.active:
            decisions = self._routes.follow(outcome, joined=network is not None)
        self._tokens.announce_velocities(self._routes.velocities)
        refused = sum(decision.refused for decision in decisions)
        self._checked = _Checked(tuple(decisions), refused)
        return refused > 0

    def _change_network(self, network: str | None) -> None:
        _log.info("%s network: %s", self.edge.side, network or "unavailable")
        if network is None or not self.edge.outlives_network:
            self._routes.leave_network()
        self._tokens.change(network)

    def tap(self, topic: str, seconds: float) -> dict[str, str]:
        """Publish a topic that is not bridged, for a number of seconds; see `SideToHubTopics.tap`."""
        return self._routes.topics_to_hub.tap(topic, seconds)

    # -- reports -------------------------------------------------------------------------------------------------------

    def alive(self) -> str:
        """Raise `TimeoutError` if a thread hangs; return a text about a busy one, or ""."""
        reports = [
            self._loop.alive(),
            self._peers.alive(),
            *(d.alive(f"publishing to {self.edge.side}") for d in (self._context.small, self._context.bulk)),
        ]
        return next(filter(None, reports), "")

    def routes(self) -> Sequence[Route]:
        """Return the routes of topics and services in both directions."""
        return self._routes.all()

    def decisions(self) -> list[RouteDecision]:
        """Return the decisions on each topic and service at the last check."""
        return list(self._checked.decisions)

    def measure_rates(self) -> None:
        """Update the rates of the routes, at most once a second; called at each heartbeat of the worker."""
        now = time.monotonic()
        if now - self._rate_at > _RATE_SECONDS:
            self._rate_at = now
            self._rate = sum(route.counters.tick() for route in self._routes.all())

    def summary(self) -> Summary:
        """Return a summary of the engine's state; its cost does not grow with the number of routes."""
        outcome, routes = self._peers.outcome, len(self.routes())
        network, refused = self._tokens.network, self._checked.refused
        return Summary(network, routes, refused, self._rate, outcome.standing_by, outcome.waiting)

    def status(self, warnings: Sequence[str] = (), **fields: Any) -> WorkerStatus:
        """Return the status document: routes, refusals and warnings, with the given fields and warnings added."""
        outcome = self._peers.outcome
        routes = (route.status() for route in self.routes())
        return WorkerStatus(
            **fields,
            network=self._tokens.network,
            standby=outcome.standing_by,
            waiting=outcome.waiting,
            lease=Lease(active=outcome.active, changes=self._peers.changes, members=len(outcome.members)),
            routes=sorted(routes, key=lambda route: (route.topic, route.direction)),
            refused=[RefusedRoute(**decision.as_dict()) for decision in self.decisions() if decision.refused],
            warnings=[*self.edge.warnings(), *self._routes.warnings(), *self._refused_tokens(), *warnings],
        )

    def _refused_tokens(self) -> list[str]:
        graph = self.hub.graph
        if not graph.refused:
            return []
        return [f"{graph.refused} liveliness tokens on the hub were ignored, the last one: {graph.trouble}"]

    def explain(self, topic: str) -> list[dict[str, Any]]:
        """Return all decisions on a topic, service or action; on everything for ``""``."""
        return explain(topic, self._checked.decisions, self.edge.endpoints(), self.edge.programs())
