"""Services whose servers are on the hub, offered on the side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from typing_extensions import override

from bridge.hub.endpoints.services import HubClient
from bridge.hub.graph import HubEndpoint
from bridge.routing.decision import OWN_NETWORK, RouteDecision, RouteKey, hub_groups, hub_key
from bridge.routing.edge import Endpoint, Kind, MadeBy
from bridge.routing.election import Outcome
from bridge.routing.gates import ExitGate, may_carry, may_leave
from bridge.routing.route import RouteSet
from bridge.routing.services.route import ServiceRoute
from bridge.routing.versions import second_version

_SERVICE: Final = "service"


class HubToSideService(ServiceRoute):
    """A service whose server is on the hub, offered on the side while the server is available."""

    direction = "out"

    @override
    def open(self) -> None:
        conversion, context = self.conversion, self._context
        self.request, self.reply = conversion.request_to_hub, conversion.response_to_side
        if self._far is None:
            hub = conversion.hub
            self._far = context.hub.client(self.hub_topic, hub.name, self.key.type_id, context.wake)
        if self._near is None and isinstance(self._far, HubClient) and self._far.ready:
            self._near = context.edge.serve(self.side_topic, conversion.side, self.call)


class HubToSideServices(RouteSet[RouteKey, HubToSideService]):
    """The routes of the services that the hub's servers offer."""

    direction = "out"
    kind = _SERVICE

    @override
    def candidates(self, endpoints: Sequence[Endpoint]) -> set[tuple[str, str]]:  # only the hub's graph matters
        servers = self._context.hub.graph.servers()
        return {(e.topic, e.type_name) for e in servers if may_leave(e, self._context.edge)}

    def close_departed(self) -> None:
        """Close the routes of servers that have left; see `SideToHubServices.close_departed`."""
        present = {hub_key(e, self._context.hub.versions) for e in self._context.hub.graph.servers()}
        for key in [k for k in self._routes if k not in present]:
            self._routes.pop(key).close()

    def follow(
        self, gate: ExitGate, endpoints: Sequence[Endpoint], decisions: list[RouteDecision], outcome: Outcome
    ) -> None:
        """Update the routes according to both graphs, the rules and the election; append a decision for each service.

        Call `close_departed` first. A service that already has a server in ``endpoints``, the side's graph, is refused.
        """
        groups = hub_groups(self._context.hub.graph.servers(), self._context.hub.versions)
        natives = {e.topic: e for e in endpoints if e.kind is Kind.SERVER and e.made_by is not MadeBy.MIDSPAN}
        barred = {e.topic: e.obstacle for e in endpoints if e.kind is Kind.CLIENT and e.obstacle is not None}
        taken = {route.side_topic: key for key, route in self._routes.items()}
        for key, servers in groups.items():
            decision = self._judge(key, servers, gate, outcome)
            decisions.append(decision)
            if decision.kind == "bridged":
                self._refuse_second(key, decision, natives, taken)
            if decision.kind == "bridged":
                self._keep(key, servers, decision)
                if key in self._routes:  # a server that cannot be bridged leaves the name to others
                    taken[decision.topic] = key
                if decision.topic in barred and not decision.refused:
                    entry = RouteDecision("out", decision.topic, key.topic, key.type_name, decision.policy, of=_SERVICE)
                    entry.bar(barred[decision.topic])
                    decisions.append(entry)
            elif key in self._routes:
                self._routes.pop(key).close(f"{key.topic} is no longer bridged")

    def _judge(self, key: RouteKey, servers: list[HubEndpoint], gate: ExitGate, outcome: Outcome) -> RouteDecision:
        """Return the decision on one service according to the loop guard, the election and the rules."""
        edge, name, type_name = self._context.edge, key.topic, key.type_name
        foreign = [e for e in servers if may_leave(e, edge)]
        carried = [e for e in foreign if may_carry(e, outcome)]
        if not foreign:
            return RouteDecision.unrouted("out", name, type_name, OWN_NETWORK, _SERVICE)
        if not carried:
            carrier = outcome.carriers.get(foreign[0].zid, "")
            return RouteDecision.carried_by(carrier, name, type_name, _SERVICE)
        policies = [gate.decide(_SERVICE, e.origin, name, type_name) for e in carried]
        policy = next((d for d in policies if d.allowed), policies[0])
        side_name = policy.name if policy.name != name else edge.side_name(name)
        placeless = edge.why_not(side_name, type_name) if policy.allowed else ""
        if placeless:
            return RouteDecision.unrouted("out", side_name, type_name, placeless, _SERVICE, name)
        return RouteDecision("out", side_name, name, type_name, policy, of=_SERVICE)

    def _refuse_second(
        self, key: RouteKey, decision: RouteDecision, natives: dict[str, Endpoint], taken: dict[str, RouteKey]
    ) -> None:
        """Refuse a service if its name already has another server on the side: a call goes to only one server."""
        name, holder = decision.topic, taken.get(decision.topic, key)
        cure = "rename one of them with a rule"
        if name in natives:  # doctor recognizes the last word (`navigation.map2d_server.checks`)
            decision.refuse(f"{natives[name].node} serves {name} there already", cure)
        elif holder.topic != key.topic:
            decision.refuse(f"{holder.topic} is already offered under the name {name}", cure)
        elif holder.type_name != key.type_name:
            decision.refuse(f"{name} is already offered with the type {holder.type_name}", cure)
        elif holder != key:
            versions = self._context.hub.versions
            second = second_version(versions, name, key.type_name, holder.type_id, key.type_id)
            decision.refuse(second.reason, second.cure)

    def _keep(self, key: RouteKey, servers: list[HubEndpoint], decision: RouteDecision) -> None:
        route = self._routes.get(key)
        if route is not None and route.policy != decision.policy:
            self._routes.pop(key).close(f"{key.topic} is bridged under other rules now; call again")
            route = None
        if route is None:
            conversion = decision.convert(lambda: self._context.edge.service_from_hub(key.type_name, key.type_id))
            if conversion is None:
                self._context.types.ask(key.type_name, key.type_id)
                return
            names = (key.topic, decision.topic)
            route = self._routes[key] = HubToSideService(key, names, conversion, decision.policy, self._context)
        route.servers = len(servers)
        route.attempt(route.open, decision)
