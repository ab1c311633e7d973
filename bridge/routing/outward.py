"""The routes of topics from the hub to the side."""

from __future__ import annotations

from collections import defaultdict

from bridge.hub.graph import HubEndpoint
from bridge.routing.election import Outcome
from bridge.routing.gate import ExitGate
from bridge.routing.guard import may_carry, may_leave
from bridge.routing.joint import Joint, attempt, convert
from bridge.routing.outroute import OutRoute
from bridge.routing.route import RouteKey
from bridge.routing.rules import Decision
from bridge.routing.verdict import Verdict


class Outward:
    """Follows the hub's publishers; the engine's loop alone calls it, but for `routes`."""

    def __init__(self, joint: Joint) -> None:
        self._joint = joint
        self._routes: dict[tuple[RouteKey, str], OutRoute] = {}
        self._outcome = Outcome()

    def routes(self) -> list[OutRoute]:
        """All routes now."""
        return list(self._routes.values())

    def close(self) -> None:
        """Close all routes."""
        for key in list(self._routes):
            self._routes.pop(key).close()

    def rest(self, verdicts: list[Verdict], why: str) -> None:
        """Have no routes; one verdict for each topic, which tells why."""
        self.close()
        publishers = [e for e in self._joint.hub.graph.publishers() if may_leave(e, self._joint.edge)]
        found = {(e.topic, e.type_name) for e in publishers}
        verdicts += [Verdict.resting("out", topic, type_name, why) for topic, type_name in sorted(found)]

    def follow(self, gate: ExitGate, verdicts: list[Verdict], outcome: Outcome) -> None:
        """Make the routes what the hub's graph, the rules and the election say; one verdict for each topic."""
        self._outcome = outcome
        groups: dict[RouteKey, list[HubEndpoint]] = defaultdict(list)
        for endpoint in self._joint.hub.graph.publishers():
            if not endpoint.own:
                groups[RouteKey(endpoint.topic, endpoint.type_name, endpoint.type_hash)].append(endpoint)
        # What is gone makes room first: a side may have one type per topic.
        self._end([k for k in self._routes if k[0] not in groups], gate)
        live: set[tuple[RouteKey, str]] = set()
        for key, endpoints in groups.items():
            self._follow(key, endpoints, gate, live, verdicts)
        self._end([k for k in self._routes if k[0] in groups and k not in live], gate)

    def _end(self, out_keys: list[tuple[RouteKey, str]], gate: ExitGate) -> None:
        for out_key in out_keys:
            route, key = self._routes[out_key], out_key[0]
            if route.static and route.decision == gate.decide("topic", route.origin, key.topic, key.type_name):
                route.update([], [])
            else:
                self._routes.pop(out_key).close()

    def _follow(
        self,
        key: RouteKey,
        endpoints: list[HubEndpoint],
        gate: ExitGate,
        live: set[tuple[RouteKey, str]],
        verdicts: list[Verdict],
    ) -> None:
        by_name: dict[str, tuple[Decision, list[HubEndpoint]]] = {}
        refused: list[HubEndpoint] = []
        elsewhere: list[HubEndpoint] = []
        for endpoint in endpoints:
            if not may_leave(endpoint, self._joint.edge):
                refused.append(endpoint)
                continue
            if not may_carry(endpoint, self._outcome):
                elsewhere.append(endpoint)
                continue
            decision = gate.decide("topic", endpoint.origin, key.topic, key.type_name)
            side_topic = decision.name if decision.name != key.topic else self._joint.edge.side_name(key.topic)
            placeless = self._joint.edge.why_not(side_topic, key.type_name)
            if decision.allowed and placeless:
                refused.append(endpoint)
                verdicts.append(Verdict.placeless(side_topic, key.topic, key.type_name, placeless))
            elif decision.allowed:
                by_name.setdefault(side_topic, (decision, []))[1].append(endpoint)
            else:
                refused.append(endpoint)
                verdicts.append(Verdict("out", side_topic, key.topic, key.type_name, decision))
        for carrier in sorted({self._outcome.carriers.get(e.zid, "") for e in elsewhere}):
            why = f"standing by: {carrier} puts it on this network" if carrier else "not agreed yet who puts it here"
            verdicts.append(Verdict.resting("out", key.topic, key.type_name, why))
        for side_topic, (decision, allowed) in by_name.items():
            verdict = Verdict("out", side_topic, key.topic, key.type_name, decision)
            verdicts.append(verdict)
            waiting = [e for e in endpoints if e.pending or e in elsewhere]
            others = [e for e in endpoints if e not in allowed and e not in waiting]
            self._keep(key, side_topic, decision, (allowed, others, waiting), live, verdict)
        if not by_name and refused and all(not may_leave(e, self._joint.edge) for e in refused):
            verdicts.append(Verdict.own_network("out", key.topic, key.type_name))

    def _keep(
        self,
        key: RouteKey,
        side_topic: str,
        decision: Decision,
        endpoints: tuple[list[HubEndpoint], list[HubEndpoint], list[HubEndpoint]],
        live: set[tuple[RouteKey, str]],
        verdict: Verdict,
    ) -> None:
        out_key = (key, side_topic)
        route = self._routes.get(out_key)
        if route is not None and route.decision != decision:
            self._routes.pop(out_key).close()
            route = None
        if route is None:
            conversion = convert(lambda: self._joint.edge.from_hub(key.type_name, key.type_id), verdict)
            if conversion is None:
                self._joint.types.ask(key.type_name, key.type_id)
                return
            route = OutRoute(key, side_topic, endpoints[0][0].origin, conversion, decision, self._joint)
            self._routes[out_key] = route
        live.add(out_key)
        attempt(route, lambda: route.update(*endpoints), verdict)
