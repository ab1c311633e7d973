"""The routes of topics from the side into the hub."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

from bridge.adapters.base import Endpoint, Kind, MadeBy
from bridge.hub.keyexpr import topic_key
from bridge.routing.gate import EntryGate
from bridge.routing.guard import TAPS
from bridge.routing.inroute import InRoute
from bridge.routing.joint import Joint, attempt, convert
from bridge.routing.route import RouteKey
from bridge.routing.rules import Decision
from bridge.routing.verdict import Verdict

_MAX_TAPS = 100
_TAP_ANSWER = 2.0


class Inward:
    """Follows the side's publishers; the engine's loop alone calls it, but for `tap` and `routes`."""

    def __init__(self, joint: Joint) -> None:
        self._joint = joint
        self._routes: dict[RouteKey, InRoute] = {}
        self._taps: dict[str, float] = {}

    def routes(self) -> list[InRoute]:
        """All routes now."""
        return list(self._routes.values())

    def close(self) -> None:
        """Close all routes."""
        for key in list(self._routes):
            self._routes.pop(key).close()

    def rest(self, endpoints: Sequence[Endpoint], verdicts: list[Verdict], why: str) -> None:
        """Have no routes; one verdict for each topic, which tells why."""
        self.close()
        found = {(e.topic, e.type) for e in endpoints if e.kind is Kind.PUBLISHER}
        verdicts += [Verdict.resting("in", topic, type_name, why) for topic, type_name in sorted(found)]

    def follow(self, gate: EntryGate, endpoints: Sequence[Endpoint], verdicts: list[Verdict]) -> None:
        """Make the routes what the side's graph and the rules say; one verdict for each topic."""
        wanted: dict[RouteKey, list[Endpoint]] = defaultdict(list)
        for endpoint in endpoints:
            if endpoint.kind is not Kind.PUBLISHER:
                continue
            if endpoint.made_by is MadeBy.NATIVE:
                wanted[RouteKey(endpoint.topic, endpoint.type, endpoint.type_id)].append(endpoint)
            else:
                verdicts.append(Verdict.not_native(endpoint))
        # What is gone makes room first: a side may have one type per topic, and the hub one topic per name.
        for key in [k for k in self._routes if k not in wanted]:
            route = self._routes[key]
            if route.static and route.decision == gate.decide("topic", key.topic, key.type_name):
                route.update([])
            else:
                self._routes.pop(key).close()
        taken = {route.hub_topic: key for key, route in self._routes.items()}
        for key, publishers in wanted.items():
            self._follow(key, publishers, gate, taken, verdicts)

    def _follow(
        self,
        key: RouteKey,
        endpoints: list[Endpoint],
        gate: EntryGate,
        taken: dict[str, RouteKey],
        verdicts: list[Verdict],
    ) -> None:
        decision = gate.decide("topic", key.topic, key.type_name)
        hub_topic = self._joint.edge.hub_name(decision.name)
        verdict = Verdict("in", key.topic, hub_topic, key.type_name, decision)
        verdicts.append(verdict)
        if not decision.allowed and time.monotonic() < self._taps.get(key.topic, 0.0):
            hub_topic = f"{TAPS}{self._joint.edge.side}{self._joint.edge.hub_name(key.topic)}"
            decision = replace(decision, allowed=True, name=hub_topic)
        route = self._routes.get(key)
        if route is not None and (not decision.allowed or route.decision != decision):
            self._routes.pop(key).close()
            route = None
        if not decision.allowed:
            return
        holder = taken.get(hub_topic, key)
        if holder.topic != key.topic:
            verdict.refuse(f"{holder.topic} already crosses under the name {hub_topic}", "rename one of them by a rule")
            return
        if route is None:
            route = self._open(key, hub_topic, endpoints[0], decision, verdict)
            if route is None:
                return
            taken[hub_topic] = key
        attempt(route, lambda: route.update(endpoints), verdict)

    def _open(
        self, key: RouteKey, hub_topic: str, endpoint: Endpoint, decision: Decision, verdict: Verdict
    ) -> InRoute | None:
        conversion = convert(lambda: self._joint.edge.to_hub(endpoint), verdict)
        if conversion is None:
            return None
        self._joint.types.tell(conversion.target)
        route = InRoute(key, hub_topic, conversion, decision, self._joint)
        self._routes[key] = route
        return route

    def tap(self, topic: str, seconds: float) -> dict[str, str]:
        """Show a topic that does not cross on the hub for so many seconds, under a name that nobody takes up.

        Returns the hub topic, type, hash and zenoh key; {} where the side has no such topic. Ask again to go on.
        """
        if len(self._taps) > _MAX_TAPS:
            self._taps = {t: until for t, until in self._taps.items() if until > time.monotonic()}
        if len(self._taps) > _MAX_TAPS or not any(
            e.topic == topic and e.kind is Kind.PUBLISHER for e in self._joint.edge.endpoints()
        ):
            return {}
        self._taps[topic] = time.monotonic() + min(seconds, 60.0)
        self._joint.wake()
        deadline = time.monotonic() + _TAP_ANSWER
        while time.monotonic() < deadline:
            route = next((r for r in self.routes() if r.side_topic == topic), None)
            if route is not None:
                target = route.conversion.target
                key = topic_key(self._joint.hub.domain, route.hub_topic, target.name, target.type_id)
                return {"topic": route.hub_topic, "type": target.name, "hash": target.type_id, "key": key}
            time.sleep(0.02)
        return {}
