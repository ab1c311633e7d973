"""Servers on the hub, offered on the side."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

from bridge.adapters.base import Endpoint, Kind, MadeBy
from bridge.hub.graph import HubEndpoint
from bridge.hub.service import HubClient
from bridge.routing.election import Outcome
from bridge.routing.gate import ExitGate
from bridge.routing.guard import may_carry, may_leave
from bridge.routing.joint import Joint, attempt, convert
from bridge.routing.route import RouteKey
from bridge.routing.services.route import ServiceRoute
from bridge.routing.verdict import Verdict

_SERVICE: Final = "service"


class OutService(ServiceRoute):
    """A server of the hub, called from the side. It is offered there once there is somebody to call."""

    direction = "out"

    def open(self) -> None:
        """Make what is missing of both ends."""
        conversion, joint = self.conversion, self._joint
        self.request, self.reply = conversion.request_to_hub, conversion.response_to_side
        if self._far is None:
            hub = conversion.hub
            self._far = joint.hub.client(self.hub_topic, hub.name, self.key.type_id, joint.wake)
        if self._near is None and isinstance(self._far, HubClient) and self._far.ready:
            self._near = joint.edge.serve(self.side_topic, conversion.side, self.call)


class ServiceOutward:
    """Follows the hub's servers; the engine's loop alone calls it, but for `routes`."""

    def __init__(self, joint: Joint) -> None:
        self._joint = joint
        self._routes: dict[RouteKey, OutService] = {}

    def routes(self) -> list[OutService]:
        """All routes now."""
        return list(self._routes.values())

    def close(self, why: str = "") -> None:
        """Close all routes."""
        for key in list(self._routes):
            self._routes.pop(key).close(why)

    def rest(self, verdicts: list[Verdict], why: str) -> None:
        """Have no routes; one verdict for each service, which tells why."""
        self.close(f"{why}; call again later")
        servers = [e for e in self._joint.hub.graph.servers() if may_leave(e, self._joint.edge)]
        found = {(e.topic, e.type_name) for e in servers}
        verdicts += [Verdict.resting("out", name, type_name, why, _SERVICE) for name, type_name in sorted(found)]

    def leave(self) -> None:
        """Close the routes of servers that are gone, before an action's topics are: its last words are to go out."""
        there = {(e.topic, e.type_name, e.type_hash) for e in self._joint.hub.graph.servers()}
        for key in [k for k in self._routes if (k.topic, k.type_name, k.type_id) not in there]:
            self._routes.pop(key).close()

    def follow(self, gate: ExitGate, endpoints: Sequence[Endpoint], verdicts: list[Verdict], outcome: Outcome) -> None:
        """Make the routes what both graphs, the rules and the election say, after `leave`; one verdict each.

        Args:
            gate: the rules.
            endpoints: the side's graph: a name that is served there is not served there by us.
            verdicts: what was decided.
            outcome: of the election.
        """
        groups: dict[RouteKey, list[HubEndpoint]] = defaultdict(list)
        for endpoint in self._joint.hub.graph.servers():
            if not endpoint.own:
                groups[RouteKey(endpoint.topic, endpoint.type_name, endpoint.type_hash)].append(endpoint)
        natives = {e.topic: e for e in endpoints if e.kind is Kind.SERVER and e.made_by is not MadeBy.MIDSPAN}
        taken = {route.side_topic: key for key, route in self._routes.items()}
        for key, servers in groups.items():
            verdict = self._judge(key, servers, gate, outcome)
            verdicts.append(verdict)
            if verdict.kind == "bridged":
                self._refuse_second(key, verdict, natives, taken)
            if verdict.kind == "bridged":
                self._keep(key, servers, verdict)
                taken[verdict.topic] = key
            elif key in self._routes:
                self._routes.pop(key).close(f"{key.topic} is not bridged any more")

    def _judge(self, key: RouteKey, servers: list[HubEndpoint], gate: ExitGate, outcome: Outcome) -> Verdict:
        """What the loop guard, the election and the rules say of one service."""
        edge, name, type_name = self._joint.edge, key.topic, key.type_name
        foreign = [e for e in servers if may_leave(e, edge)]
        carried = [e for e in foreign if may_carry(e, outcome)]
        if not foreign:
            return Verdict.own_network("out", name, type_name, _SERVICE)
        if not carried:
            carrier = outcome.carriers.get(foreign[0].zid, "")
            why = f"standing by: {carrier} puts it on this network" if carrier else "not agreed yet who puts it here"
            return Verdict.resting("out", name, type_name, why, _SERVICE)
        decisions = [gate.decide(_SERVICE, e.origin, name, type_name) for e in carried]
        decision = next((d for d in decisions if d.allowed), decisions[0])
        side_name = decision.name if decision.name != name else edge.side_name(name)
        placeless = edge.why_not(side_name, type_name) if decision.allowed else ""
        if placeless:
            return Verdict.placeless(side_name, name, type_name, placeless, _SERVICE)
        return Verdict("out", side_name, name, type_name, decision, of=_SERVICE)

    def _refuse_second(
        self, key: RouteKey, verdict: Verdict, natives: dict[str, Endpoint], taken: dict[str, RouteKey]
    ) -> None:
        """A call goes to one server: what is served on the side itself, or by another route, is not served again."""
        name, holder = verdict.topic, taken.get(verdict.topic, key)
        cure = "give one of them another name by a rule with 'rename'"
        if name in natives:
            verdict.refuse(f"{natives[name].node} serves {name} there already", cure)
        elif holder.topic != key.topic:
            verdict.refuse(f"{holder.topic} is already offered under the name {name}", cure)
        elif holder != key:
            verdict.refuse(f"{name} is already offered with the type {holder.type_name}", cure)

    def _keep(self, key: RouteKey, servers: list[HubEndpoint], verdict: Verdict) -> None:
        route = self._routes.get(key)
        if route is not None and route.decision != verdict.decision:
            self._routes.pop(key).close(f"{key.topic} is bridged under other rules now; call again")
            route = None
        if route is None:
            conversion = convert(lambda: self._joint.edge.service_from_hub(key.type_name, key.type_id), verdict)
            if conversion is None:
                self._joint.types.ask(key.type_name, key.type_id)
                return
            names = (key.topic, verdict.topic)
            route = self._routes[key] = OutService(key, names, conversion, verdict.decision, self._joint)
        route.servers = len(servers)
        attempt(route, route.open, verdict)
