"""Servers of the side, offered on the hub."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Final

from bridge.adapters.base import Endpoint, Kind, MadeBy
from bridge.hub.call import Abandon, CallError, Done
from bridge.messages.refusals import refusal
from bridge.routing.gate import EntryGate
from bridge.routing.joint import Joint, attempt, convert
from bridge.routing.route import RouteKey
from bridge.routing.rules import Decision
from bridge.routing.services.route import ServiceRoute
from bridge.routing.verdict import Verdict

_SERVICE: Final = "service"


class InService(ServiceRoute):
    """A server of the side, called from the hub.

    A client of rmw_zenoh hears no errors. That of an action gets the reply that says no, where there is one: the goal
    is refused, or has been aborted.
    """

    direction = "in"
    _refusal: Callable[[], bytes] | None = None

    def open(self) -> None:
        """Make what is missing of both ends."""
        conversion, joint = self.conversion, self._joint
        self.request, self.reply = conversion.request_to_side, conversion.response_to_hub
        if self._far is None:
            self._far = joint.edge.caller(self.side_topic, conversion.side)
        if self._near is None:
            hub = conversion.hub
            if joint.registry is not None:
                self._refusal = refusal(joint.registry, hub.name, hub.type_id)
            self._near = joint.hub.server(self.hub_topic, hub.name, hub.type_id, self.call)

    def call(self, request: bytes, done: Done) -> Abandon:
        """A caller on the hub asks."""
        refuse = self._refusal
        if refuse is None:
            return super().call(request, done)
        return super().call(request, lambda result: done(refuse() if isinstance(result, CallError) else result))


class ServiceInward:
    """Follows the side's servers; the engine's loop alone calls it, but for `routes`."""

    def __init__(self, joint: Joint) -> None:
        self._joint = joint
        self._routes: dict[RouteKey, InService] = {}

    def routes(self) -> list[InService]:
        """All routes now."""
        return list(self._routes.values())

    def close(self, why: str = "") -> None:
        """Close all routes."""
        for key in list(self._routes):
            self._routes.pop(key).close(why)

    def rest(self, endpoints: Sequence[Endpoint], verdicts: list[Verdict], why: str) -> None:
        """Have no routes; one verdict for each service, which tells why."""
        self.close(f"{why}; call again later")
        found = {(e.topic, e.type) for e in endpoints if e.kind is Kind.SERVER}
        verdicts += [Verdict.resting("in", name, type_name, why, _SERVICE) for name, type_name in sorted(found)]

    def leave(self, endpoints: Sequence[Endpoint]) -> None:
        """Close the routes of servers that are gone, before an action's topics are: its last words are to go out."""
        servers = [e for e in endpoints if e.kind is Kind.SERVER and e.made_by is MadeBy.NATIVE]
        there = {(e.topic, e.type, e.type_id) for e in servers}
        for key in [k for k in self._routes if (k.topic, k.type_name, k.type_id) not in there]:
            self._routes.pop(key).close()

    def follow(self, gate: EntryGate, endpoints: Sequence[Endpoint], verdicts: list[Verdict]) -> None:
        """Make the routes what the side's graph and the rules say, after `leave`; one verdict for each service."""
        wanted: dict[RouteKey, list[Endpoint]] = defaultdict(list)
        for endpoint in endpoints:
            if endpoint.kind is not Kind.SERVER:
                continue
            if endpoint.made_by is MadeBy.NATIVE:
                wanted[RouteKey(endpoint.topic, endpoint.type, endpoint.type_id)].append(endpoint)
            else:
                verdicts.append(Verdict.not_native(endpoint))
        taken = {route.hub_topic: key for key, route in self._routes.items()}
        for key, servers in wanted.items():
            self._follow(key, servers, gate, taken, verdicts)

    def _follow(
        self,
        key: RouteKey,
        servers: list[Endpoint],
        gate: EntryGate,
        taken: dict[str, RouteKey],
        verdicts: list[Verdict],
    ) -> None:
        decision = gate.decide(_SERVICE, key.topic, key.type_name)
        hub_name = self._joint.edge.hub_name(decision.name)
        verdict = Verdict("in", key.topic, hub_name, key.type_name, decision, of=_SERVICE)
        verdicts.append(verdict)
        route = self._routes.get(key)
        trouble = self._trouble(key, hub_name, taken) if decision.allowed else ""
        if route is not None and (not decision.allowed or trouble or route.decision != decision):
            self._routes.pop(key).close(f"{key.topic} is not bridged any more")
            taken.pop(hub_name, None)
            route = None
        if trouble:
            verdict.refuse(trouble, "give one of them another name by a rule with 'rename'")
        if not decision.allowed or trouble:
            return
        if route is None:
            route = self._make(key, hub_name, servers[0], decision, verdict)
            if route is None:
                return
            taken[hub_name] = key
        route.servers = len(servers)
        attempt(route, route.open, verdict)

    def _trouble(self, key: RouteKey, hub_name: str, taken: dict[str, RouteKey]) -> str:
        """Why the hub has no place for a service, "" where it has: a call goes to one server."""
        holder = taken.get(hub_name, key)
        if holder.topic != key.topic:
            return f"{holder.topic} is already offered under the name {hub_name}"
        if holder != key:
            return f"{holder.topic} is already offered with the type {holder.type_name}"
        open_here = key in self._routes and self._routes[key].offered
        for other in self._joint.hub.graph.servers(hub_name):
            # of two bridges that began in the same moment, the same one gives way for both
            if not other.own and not (open_here and other.origin and self._joint.hub.zid < other.zid):
                return f"{other.node} serves {hub_name} on the hub already"
        return ""

    def _make(
        self, key: RouteKey, hub_name: str, server: Endpoint, decision: Decision, verdict: Verdict
    ) -> InService | None:
        conversion = convert(lambda: self._joint.edge.service_to_hub(server), verdict)
        if conversion is None:
            return None
        self._joint.types.tell(conversion.hub)
        route = InService(key, (hub_name, key.topic), conversion, decision, self._joint)
        self._routes[key] = route
        return route
