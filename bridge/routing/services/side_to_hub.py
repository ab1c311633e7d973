"""Services whose servers are on the side, offered on the hub."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from typing_extensions import override

from bridge.hub.endpoints.calls import Abandon, Call, CallError, Done, UnsentCallError
from bridge.messages.actions import ENDINGS, GET_RESULT, SEND_GOAL, split
from bridge.messages.registry import Registry
from bridge.messages.services import refusal, unknown_result
from bridge.routing.decision import RouteDecision, RouteKey, native_groups
from bridge.routing.edge import Endpoint, Kind, MadeBy, Obstacle
from bridge.routing.gates import EntryGate
from bridge.routing.route import EngineContext, RouteSet
from bridge.routing.rules import RoutePolicy
from bridge.routing.services.orphans import OrphanCancels
from bridge.routing.services.route import ServiceRoute
from bridge.routing.versions import second_version

_SERVICE: Final = "service"

PLANNERS = "/planner/"
"""Prefix of the planners' actions on the hub, to which only the gateway sends goals."""


class SideToHubService(ServiceRoute):
    """A service whose server is on the side, and whose clients are on the hub.

    Clients of rmw_zenoh cannot receive errors. So a failed call to a service of an action gets a reply of its type,
    which says that the goal is rejected, that its end is unknown (it may still be executing, so no client gets
    *aborted*), or that the cancel request is rejected. If the call was refused before a server received it, or asked
    for a result, the error with its reason precedes this reply, and Midspan's own clients use the error. So a goal
    whose server has left ends in one state, whether the report of the side or that of the hub arrives first.
    """

    direction = "in"
    _refusal: Callable[[str], bytes] | None = None
    orphaned: Callable[[bytes], None] | None = None
    """Called, on a thread of zenoh, with the request of a call whose client left before the reply."""

    @override
    def open(self) -> None:
        conversion, context = self.conversion, self._context
        self.request, self.reply = conversion.request_to_side, conversion.response_to_hub
        if self._far is None:
            self._far = context.edge.caller(self.side_topic, conversion.side)
        if self._near is None:
            hub = conversion.hub
            if context.registry is not None:
                self._refusal = _refusal(context.registry, hub.name, hub.type_id)
            self._near = context.hub.server(self.hub_topic, hub.name, hub.type_id, self.call)

    @override
    def call(self, request: bytes, done: Done) -> Abandon:
        refuse = self._refusal
        if refuse is None:
            return self._call(request, done)
        gets_result = split(self.hub_topic)[1] == GET_RESULT

        def ended(result: bytes | CallError) -> None:
            if isinstance(result, CallError):
                reply = refuse(str(result))
                if gets_result or isinstance(result, UnsentCallError):
                    error = type(result)(str(result))  # several calls may end with the same error
                    error.reply, result = reply, error
                else:
                    result = reply
            done(result)

        return self._call(request, ended)

    def _call(self, request: bytes, done: Done) -> Abandon:
        orphaned = self.orphaned
        if orphaned is None:
            return super().call(request, done)
        has_ended = False

        def ended(result: bytes | CallError) -> None:
            nonlocal has_ended
            has_ended = True
            done(result)

        leave = super().call(request, ended)

        def left() -> None:
            leave()
            if not has_ended:
                orphaned(request)

        return left


def _uncalled(servers: list[Endpoint]) -> Obstacle | None:
    """Return why these servers get no calls although others of the same name do; None if these servers get calls."""
    return next((server.uncalled for server in servers if server.uncalled is not None), None)


def _refusal(registry: Registry, type_name: str, type_hash: str) -> Callable[[str], bytes] | None:
    if type_name.endswith(ENDINGS[GET_RESULT]):
        return unknown_result(registry, type_name, type_hash)
    refuse = refusal(registry, type_name, type_hash)
    return None if refuse is None else lambda _why: refuse()


class SideToHubServices(RouteSet[RouteKey, SideToHubService]):
    """The routes of the services that the side's servers offer."""

    direction = "in"
    kind = _SERVICE

    def __init__(self, context: EngineContext) -> None:
        super().__init__(context)
        self._orphans = OrphanCancels(context.later, self._find)

    @override
    def candidates(self, endpoints: Sequence[Endpoint]) -> set[tuple[str, str]]:
        return {(e.topic, e.type) for e in endpoints if e.kind is Kind.SERVER}

    def close_departed(self, endpoints: Sequence[Endpoint]) -> None:
        """Close the routes of servers that have left.

        Call this before an action's topic routes are closed, so that they still publish its last messages.
        """
        servers = [e for e in endpoints if e.kind is Kind.SERVER and e.made_by is MadeBy.NATIVE]
        present = {(e.topic, e.type, e.type_id) for e in servers}
        for key in [k for k in self._routes if (k.topic, k.type_name, k.type_id) not in present]:
            self._routes.pop(key).close()

    def follow(self, gate: EntryGate, endpoints: Sequence[Endpoint], decisions: list[RouteDecision]) -> None:
        """Update the routes according to the side's graph and the rules; append a decision for each service.

        Call `close_departed` first.
        """
        wanted = native_groups(endpoints, Kind.SERVER, decisions)
        taken = {route.hub_topic: key for key, route in self._routes.items()}
        for key, servers in sorted(wanted.items(), key=lambda item: not _uncalled(item[1])):  # they leave their name
            self._follow(key, servers, gate, taken, decisions)

    def _follow(
        self, key: RouteKey, servers: list[Endpoint], gate: EntryGate, taken: dict[str, RouteKey],
        decisions: list[RouteDecision],
    ) -> None:  # fmt: skip
        policy = gate.decide(_SERVICE, key.topic, key.type_name)
        hub_name = self._context.edge.hub_name(policy.name)
        decision = RouteDecision("in", key.topic, hub_name, key.type_name, policy, of=_SERVICE)
        decisions.append(decision)
        route = self._routes.get(key)
        trouble = (_uncalled(servers) or self._trouble(key, hub_name, taken)) if policy.allowed else None
        if route is not None and (not policy.allowed or trouble is not None or route.policy != policy):
            self._routes.pop(key).close(f"{key.topic} is no longer bridged")
            taken.pop(hub_name, None)
            route = None
        if trouble is not None:
            decision.refuse(trouble.reason, trouble.cure)
        if not policy.allowed or trouble is not None:
            return
        if route is None:
            route = self._make(key, hub_name, servers[0], policy, decision)
            if route is None:
                return
            taken[hub_name] = key
        route.servers = len(servers)
        route.attempt(route.open, decision)
        obstacle = next((server.obstacle for server in servers if server.obstacle is not None), None)
        if obstacle is not None and not decision.refused:
            decision.bar(obstacle)

    def _trouble(self, key: RouteKey, hub_name: str, taken: dict[str, RouteKey]) -> Obstacle | None:
        """Return why a service cannot be offered on the hub, None if it can: each name has only one server."""
        holder = taken.get(hub_name, key)
        cure = "rename one of them with a rule"
        if holder.topic != key.topic:
            return Obstacle(f"{holder.topic} is already offered under the name {hub_name}", cure)
        if holder.type_name != key.type_name:
            return Obstacle(f"{holder.topic} is already offered with the type {holder.type_name}", cure)
        if holder != key:
            versions = self._context.hub.versions
            return second_version(versions, key.topic, key.type_name, holder.type_id, key.type_id)
        open_here = key in self._routes and self._routes[key].offered
        for other in self._context.hub.graph.servers(hub_name):
            # two bridges that start at the same time agree on which of them withdraws
            if not other.own and not (open_here and other.origin and self._context.hub.zid < other.zid):
                return Obstacle(f"{other.node} serves {hub_name} on the hub already", cure)
        return None

    def _make(
        self, key: RouteKey, hub_name: str, server: Endpoint, policy: RoutePolicy, decision: RouteDecision
    ) -> SideToHubService | None:
        conversion = decision.convert(lambda: self._context.edge.service_to_hub(server))
        if conversion is None:
            return None
        self._context.types.offer(conversion.hub)
        route = SideToHubService(key, (hub_name, key.topic), conversion, policy, self._context)
        action, part = split(hub_name)
        if part in (SEND_GOAL, GET_RESULT) and action.startswith(PLANNERS):
            route.orphaned = partial(self._orphans.cancel, action)
        self._routes[key] = route
        return route

    def _find(self, hub_name: str) -> Call | None:
        route = next((route for route in self.routes() if route.hub_topic == hub_name), None)
        return None if route is None else route.call
