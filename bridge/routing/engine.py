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
from dataclasses import dataclass, replace
from typing import Any

from bridge.adapters.base import Conversion, Edge, Endpoint, Kind, MadeBy
from bridge.config.model import RoutingSection
from bridge.hub.graph import HubEndpoint
from bridge.hub.keyexpr import topic_key
from bridge.hub.origin import Origin
from bridge.hub.session import Hub
from bridge.messages.errors import MessageTypeError
from bridge.routing.age import Pulse
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.guard import TAPS, may_leave, origin_side
from bridge.routing.inroute import InRoute
from bridge.routing.outroute import OutRoute
from bridge.routing.route import Route, RouteKey
from bridge.routing.rules import Decision, RuleSet
from bridge.routing.typebook import TypeBook
from bridge.routing.verdict import Verdict

_log = logging.getLogger(__name__)

_PULSE = 0.1
_TICK = 1.0
_LOOK = 10.0  # a look without being woken, should a change ever go untold
_RETRY = 2.0  # what was refused may work by now
_SETTLE = 0.02
_MAX_TAPS = 100


@dataclass(frozen=True, slots=True)
class Summary:
    """How an engine is, in numbers."""

    network: str | None
    routes: int
    refused: int
    rate: float


class Engine:
    """Routes between one edge and the hub."""

    def __init__(
        self, edge: Edge, hub: Hub, routing: RoutingSection, daemon: str, on_failure: Callable[[str], None]
    ) -> None:
        self.edge, self.hub = edge, hub
        self._rules = RuleSet(routing)
        self._daemon = daemon
        self._on_failure = on_failure
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._pulse = Pulse()
        self._beat = time.monotonic()
        self._small = Dispatcher(f"midspan-{edge.side}-small")
        self._bulk = Dispatcher(f"midspan-{edge.side}-bulk")
        self._in: dict[RouteKey, InRoute] = {}
        self._out: dict[tuple[RouteKey, str], OutRoute] = {}
        self._verdicts: list[Verdict] = []
        self._network: str | None = None
        self._taps: dict[str, float] = {}
        self._types = TypeBook(hub, edge, self.graph_changed)
        self._closers: list[Callable[[], None]] = []
        self._thread = threading.Thread(target=self._run, name=f"midspan-{edge.side}-engine", daemon=True)

    # -- life ----------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start following both graphs."""
        self._small.start()
        self._bulk.start()
        self._closers = [self.hub.graph.watch(self.graph_changed), self._types.serve()]
        self.edge.start(self)
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
        for dispatcher in (self._small, self._bulk):
            dispatcher.stop()
        for route in [*self._in.values(), *self._out.values()]:
            route.close()
        self._in.clear()
        self._out.clear()
        self.edge.stop()

    def reload(self, routing: RoutingSection) -> None:
        """Take up other rules; only routes whose decision changed are touched."""
        self._rules = RuleSet(routing)
        self._wake.set()

    def graph_changed(self) -> None:
        """A graph changed: look again soon. Only wakes; may be called from any thread."""
        self._wake.set()

    def edge_failed(self, reason: str) -> None:
        """The edge cannot go on: tell the worker."""
        self._on_failure(reason)

    # -- the loop ------------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        tick = look = 0.0
        while not self._stopping.is_set():
            self._pulse.beat()
            woken = self._wake.wait(_PULSE)
            now = time.monotonic()
            if woken or now >= look:
                self._wake.clear()
                try:
                    self._reconcile()
                except Exception as err:
                    _log.exception("%s: following the graphs failed", self.edge.side)
                    self._on_failure(f"following the graphs failed: {err}")
                    return
                look = now + (_RETRY if any(v.refused for v in self._verdicts) else _LOOK)
                self._stopping.wait(_SETTLE)
            if now >= tick:
                tick = now + _TICK
                for route in self.routes():
                    route.counters.tick()
            self._beat = time.monotonic()

    def _reconcile(self) -> None:
        network = self.edge.network()
        if network != self._network:
            self._change_network(network)
        verdicts: list[Verdict] = []
        if network is not None:
            self._follow_side(verdicts)
        self._follow_hub(verdicts)
        with self._lock:
            self._verdicts = verdicts

    def _change_network(self, network: str | None) -> None:
        _log.info("%s network: %s", self.edge.side, network or "away")
        for key in list(self._in):
            self._in.pop(key).close()
        self._network = network
        self.hub.set_origin(Origin(self.edge.side, network, self._daemon) if network is not None else None)

    # -- from the side into the hub ------------------------------------------------------------------------------------

    def _follow_side(self, verdicts: list[Verdict]) -> None:
        wanted: dict[RouteKey, list[Endpoint]] = defaultdict(list)
        for endpoint in self.edge.endpoints():
            if endpoint.kind is not Kind.PUBLISHER:
                continue
            if endpoint.made_by is MadeBy.NATIVE:
                wanted[RouteKey(endpoint.topic, endpoint.type, endpoint.type_id)].append(endpoint)
            else:
                verdicts.append(Verdict.not_native(endpoint))
        # What is gone makes room first: a side may have one type per topic, and the hub one topic per name.
        for key in [k for k in self._in if k not in wanted]:
            if self._in[key].static:
                self._in[key].update([])
            else:
                self._in.pop(key).close()
        taken = {route.hub_topic: key for key, route in self._in.items()}
        for key, endpoints in wanted.items():
            self._follow_in(key, endpoints, taken, verdicts)

    def _follow_in(
        self, key: RouteKey, endpoints: list[Endpoint], taken: dict[str, RouteKey], verdicts: list[Verdict]
    ) -> None:
        decision = self._rules.enter(self.edge.side, key.topic, _ros2_name(key.type_name))
        hub_topic = self.edge.hub_name(decision.name)
        verdict = Verdict("in", key.topic, hub_topic, key.type_name, decision)
        verdicts.append(verdict)
        if not decision.allowed and time.monotonic() < self._taps.get(key.topic, 0.0):
            hub_topic = f"{TAPS}{self.edge.side}{self.edge.hub_name(key.topic)}"
            decision = replace(decision, allowed=True, name=hub_topic)
        route = self._in.get(key)
        if route is not None and (not decision.allowed or route.decision != decision):
            self._in.pop(key).close()
            route = None
        if not decision.allowed:
            return
        holder = taken.get(hub_topic, key)
        if holder.topic != key.topic:
            verdict.refuse(f"{holder.topic} already crosses under the name {hub_topic}", "rename one of them by a rule")
            return
        if route is None:
            route = self._open_in(key, hub_topic, endpoints[0], decision, verdict)
            if route is None:
                return
            taken[hub_topic] = key
        self._try(route, lambda: route.update(endpoints), verdict)

    def _open_in(
        self, key: RouteKey, hub_topic: str, endpoint: Endpoint, decision: Decision, verdict: Verdict
    ) -> InRoute | None:
        conversion = self._convert(lambda: self.edge.to_hub(endpoint), verdict)
        if conversion is None:
            return None
        self._types.tell(conversion.target)
        route = InRoute(
            key, hub_topic, conversion, decision,
            hub=self.hub, edge=self.edge, pulse=self._pulse, unknown_source=self.graph_changed,
        )  # fmt: skip
        self._in[key] = route
        return route

    def tap(self, topic: str, seconds: float) -> dict[str, str]:
        """Show a topic that does not cross on the hub for so many seconds, under a name that nobody takes up.

        Returns the hub topic, type, hash and zenoh key; {} where the side has no such topic. Ask again to go on.
        """
        if len(self._taps) > _MAX_TAPS:
            self._taps = {t: until for t, until in self._taps.items() if until > time.monotonic()}
        if len(self._taps) > _MAX_TAPS or not any(
            e.topic == topic and e.kind is Kind.PUBLISHER for e in self.edge.endpoints()
        ):
            return {}
        self._taps[topic] = time.monotonic() + min(seconds, 60.0)
        self._wake.set()
        deadline = time.monotonic() + 2.0
        while time.monotonic() < deadline:
            route = next((r for r in list(self._in.values()) if r.side_topic == topic), None)
            if route is not None:
                target = route.conversion.target
                key = topic_key(self.hub.domain, route.hub_topic, target.name, target.type_id)
                return {"topic": route.hub_topic, "type": target.name, "hash": target.type_id, "key": key}
            self._stopping.wait(0.02)
        return {}

    # -- from the hub to the side --------------------------------------------------------------------------------------

    def _follow_hub(self, verdicts: list[Verdict]) -> None:
        groups: dict[RouteKey, list[HubEndpoint]] = defaultdict(list)
        for endpoint in self.hub.graph.publishers():
            if not endpoint.own:
                groups[RouteKey(endpoint.topic, endpoint.type_name, endpoint.type_hash)].append(endpoint)
        self._end_out([k for k in self._out if k[0] not in groups])
        live: set[tuple[RouteKey, str]] = set()
        for key, endpoints in groups.items():
            self._follow_out(key, endpoints, live, verdicts)
        self._end_out([k for k in self._out if k[0] in groups and k not in live])

    def _end_out(self, out_keys: list[tuple[RouteKey, str]]) -> None:
        for out_key in out_keys:
            if self._out[out_key].static:
                self._out[out_key].update([], [])
            else:
                self._out.pop(out_key).close()

    def _follow_out(
        self, key: RouteKey, endpoints: list[HubEndpoint], live: set[tuple[RouteKey, str]], verdicts: list[Verdict]
    ) -> None:
        by_name: dict[str, tuple[Decision, list[HubEndpoint]]] = {}
        refused: list[HubEndpoint] = []
        for endpoint in endpoints:
            if not may_leave(endpoint, self.edge):
                refused.append(endpoint)
                continue
            decision = self._rules.leave(origin_side(endpoint), self.edge.side, key.topic, key.type_name)
            side_topic = decision.name if decision.name != key.topic else self.edge.side_name(key.topic)
            if decision.allowed:
                by_name.setdefault(side_topic, (decision, []))[1].append(endpoint)
            else:
                refused.append(endpoint)
                verdicts.append(Verdict("out", side_topic, key.topic, key.type_name, decision))
        for side_topic, (decision, allowed) in by_name.items():
            verdict = Verdict("out", side_topic, key.topic, key.type_name, decision)
            verdicts.append(verdict)
            others = refused + [e for e in endpoints if e not in allowed and e not in refused]
            self._keep_out(key, side_topic, decision, (allowed, others), live, verdict)
        if not by_name and refused and all(not may_leave(e, self.edge) for e in refused):
            verdicts.append(Verdict.own_network("out", key.topic, key.type_name))

    def _keep_out(
        self,
        key: RouteKey,
        side_topic: str,
        decision: Decision,
        endpoints: tuple[list[HubEndpoint], list[HubEndpoint]],
        live: set[tuple[RouteKey, str]],
        verdict: Verdict,
    ) -> None:
        out_key = (key, side_topic)
        route = self._out.get(out_key)
        if route is not None and route.decision != decision:
            self._out.pop(out_key).close()
            route = None
        if route is None:
            conversion = self._convert(lambda: self.edge.from_hub(key.type_name, key.type_id), verdict)
            if conversion is None:
                self._types.ask(key.type_name, key.type_id)
                return
            route = OutRoute(
                key, side_topic, conversion, decision,
                hub=self.hub, edge=self.edge, pulse=self._pulse, small=self._small, bulk=self._bulk,
                unknown_source=self.graph_changed,
            )  # fmt: skip
            self._out[out_key] = route
        live.add(out_key)
        self._try(route, lambda: route.update(*endpoints), verdict)

    def _convert(self, make: Callable[[], Conversion], verdict: Verdict) -> Conversion | None:
        try:
            return make()
        except MessageTypeError as err:
            verdict.refuse(str(err), err.cure)
            return None

    def _try(self, route: Route, update: Callable[[], None], verdict: Verdict) -> None:
        """One route's failure is its own: it is reported and tried again at the next look."""
        try:
            update()
        except MessageTypeError as err:
            verdict.refuse(str(err), err.cure)
        except Exception as err:
            verdict.refuse(f"{type(err).__name__}: {err}", "")
            if verdict.reason != route.refused:
                _log.exception("%s %s", verdict.direction, verdict.topic)
        route.refused = verdict.reason

    # -- reports -------------------------------------------------------------------------------------------------------

    def alive(self) -> None:
        """Raise `TimeoutError` where the loop or a dispatcher stands still."""
        late = time.monotonic() - self._beat
        if late > 3.0:
            msg = f"the {self.edge.side} engine's loop has not turned for {late:.1f} s"
            raise TimeoutError(msg)
        for dispatcher in (self._small, self._bulk):
            stuck = dispatcher.stuck_for()
            if stuck > 4.0:
                msg = f"publishing to {self.edge.side} has been stuck for {stuck:.1f} s"
                raise TimeoutError(msg)

    def routes(self) -> Sequence[Route]:
        """All routes now."""
        return [*list(self._in.values()), *list(self._out.values())]

    def verdicts(self) -> list[Verdict]:
        """What was decided of each topic at the last look."""
        with self._lock:
            return list(self._verdicts)

    def summary(self) -> Summary:
        """How the engine is, in numbers."""
        routes = [r.status() for r in self.routes()]
        refused = sum(1 for v in self.verdicts() if v.refused)
        return Summary(self._network, len(routes), refused, sum(float(r["rate"]) for r in routes))

    def status(self) -> dict[str, Any]:
        """Routes, refusals and warnings as they stand in the status document."""
        return {
            "network": self._network,
            "routes": sorted((r.status() for r in self.routes()), key=lambda r: (str(r["topic"]), str(r["direction"]))),
            "refused": [v.as_dict() for v in self.verdicts() if v.refused],
            "warnings": [*self.edge.warnings(), *self._left_out()],
        }

    def _left_out(self) -> list[str]:
        return sorted({
            f"{route.side_topic}: {', '.join(route.conversion.left_out)} does not cross: this machine's"
            f" {route.hub_type} has no such field (the publisher's md5 is {route.conversion.source.type_id})"
            for route in list(self._in.values())
            if route.conversion.left_out
        })  # fmt: skip

    def explain(self, topic: str) -> list[dict[str, Any]]:
        """Everything that was decided of a topic, by its name on the side or on the hub; of all topics for ``""``."""
        name = topic if topic.startswith("/") or not topic else "/" + topic
        found = [v.as_dict() for v in self.verdicts() if not name or name in (v.topic, v.hub_topic)]
        told = {str(entry[key]) for entry in found for key in ("topic", "hub_topic")}
        heard: dict[str, list[Endpoint]] = defaultdict(list)
        for endpoint in self.edge.endpoints():
            wanted = endpoint.topic == name or not name
            if wanted and endpoint.kind is Kind.SUBSCRIPTION and endpoint.topic not in told:
                heard[endpoint.topic].append(endpoint)
        for topic_heard, endpoints in heard.items():
            nodes = ", ".join(sorted({e.node for e in endpoints}))
            found.append(Verdict.no_publisher(topic_heard, endpoints[0].type, nodes).as_dict())
        return found


def _ros2_name(type_name: str) -> str:
    """A type's ROS 2 spelling as far as the name alone tells, for the rules' ``type`` globs."""
    package, _, name = type_name.partition("/")
    return type_name if "/" in name or not name else f"{package}/msg/{name}"
