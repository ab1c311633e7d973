"""All routes of one side: topics and services, in both directions."""

from __future__ import annotations

from bridge.routing.decision import RouteDecision
from bridge.routing.election import Outcome
from bridge.routing.gates import EntryGate, ExitGate
from bridge.routing.hub_to_side import HubToSideTopics
from bridge.routing.route import EngineContext, Route
from bridge.routing.rules import RuleSet
from bridge.routing.services.hub_to_side import HubToSideServices
from bridge.routing.services.side_to_hub import SideToHubServices
from bridge.routing.side_to_hub import SideToHubTopics
from bridge.routing.velocities import subscribed_velocities
from bridge.routing.versions import note_losses


class EngineRoutes:
    """The routes of one side, and the rules that apply to them. Only the engine's loop changes the routes.

    Attributes:
        rules: the rules of the configuration; any thread may replace them, and they apply from the next check on.
        topics_to_hub: the routes of the side's topics.
        velocities: hub topic and type of the velocities that the side's own nodes subscribe to, at the last check.
    """

    def __init__(self, context: EngineContext, daemon: str, rules: RuleSet) -> None:
        self.rules = rules
        self.velocities = frozenset[tuple[str, str]]()
        self._edge, self._hub, self._graph, self._daemon = context.edge, context.hub, context.hub.graph, daemon
        self.topics_to_hub, self._topics_to_side = SideToHubTopics(context), HubToSideTopics(context)
        self._services_to_hub, self._services_to_side = SideToHubServices(context), HubToSideServices(context)
        self._sets = (self._services_to_hub, self._services_to_side, self.topics_to_hub, self._topics_to_side)

    def all(self) -> list[Route]:
        """Return the routes of topics and services in both directions."""
        return [route for routes in self._sets for route in routes.routes()]

    def follow(self, outcome: Outcome, *, joined: bool) -> list[RouteDecision]:
        """Update the routes according to both graphs, the rules and the election; return the decision on each name.

        ``joined`` is whether the side's network is available.
        """
        rules, decisions, endpoints = self.rules, list[RouteDecision](), self._edge.endpoints()
        self._services_to_hub.close_departed(endpoints)
        self._services_to_side.close_departed()
        if joined:
            entry = EntryGate(rules, self._edge.side, endpoints)
            self.topics_to_hub.follow(entry, endpoints, decisions)
            if self._edge.services:
                self._services_to_hub.follow(entry, endpoints, decisions)
        leaving = ExitGate(rules, self._edge.side, self._daemon, self._graph.endpoints())
        self._topics_to_side.follow(leaving, endpoints, decisions, outcome)
        if self._edge.services:
            self._services_to_side.follow(leaving, endpoints, decisions, outcome)
        self.velocities = subscribed_velocities(self._edge, endpoints, leaving, rules) if joined else frozenset()
        note_losses(self._hub, self._edge, decisions)
        return decisions

    def stand_by(self, why: str) -> list[RouteDecision]:
        """Close all routes; return a decision on each name that could have one."""
        decisions, endpoints = list[RouteDecision](), self._edge.endpoints()
        self.velocities = frozenset()
        for routes in self._sets:
            if self._edge.services or routes.kind == "topic":
                routes.stand_by(endpoints, decisions, why)
        return decisions

    def leave_network(self) -> None:
        """Close the routes to the hub, because their network is unavailable or was replaced by another one."""
        self._services_to_hub.close(f"the {self._edge.side} network of the server is unavailable")
        self.topics_to_hub.close()

    def close(self) -> None:
        for routes in self._sets:
            routes.close()

    def warnings(self) -> list[str]:
        """Return warnings about fields that are missing in this machine's version of a type."""
        return sorted({
            f"{route.side_topic}: {', '.join(route.conversion.left_out)} is not bridged: this machine's"
            f" {route.hub_type} has no such field (the publisher's md5 is {route.conversion.source.type_id})"
            for route in self.topics_to_hub.routes()
            if route.conversion.left_out
        })  # fmt: skip
