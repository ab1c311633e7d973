"""The gates between a side and the hub: the rules at entry and exit, and the loop guard.

Messages never loop: endpoints that any Midspan worker created on a foreign network are never routed from it (each edge
detects them by marks on that network), and messages from a network are never sent back to it. An endpoint is not
bridged while its origin is unknown. If several workers could forward the same message, only one does; see
`bridge.routing.election`.

The rules treat an action as a whole, by its own name and type; a new name applies to all five of its topics and
services. The cancel service and the status topic have the same type in every action, so the action's type is derived
from the other three.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

from bridge.config.sections.routing import QosOverride
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import TAPS, EndpointKind, Origin
from bridge.messages.actions import COMMON, ENDINGS, part_name, split
from bridge.routing.edge import Edge, Endpoint, Kind
from bridge.routing.election import Outcome
from bridge.routing.rules import RoutePolicy, RuleSet


def may_leave(endpoint: HubEndpoint, edge: Edge) -> bool:
    """Return whether a hub publisher's messages may be published on the edge's network."""
    if endpoint.own or endpoint.pending or endpoint.topic.startswith(TAPS):
        return False
    return endpoint.origin is None or not edge.is_own_network(endpoint.origin)


def may_carry(endpoint: HubEndpoint, outcome: Outcome) -> bool:
    """Return whether this worker is the one that bridges a hub publisher's messages to its network."""
    return outcome.active and (endpoint.origin is None or endpoint.zid in outcome.carried)


@dataclass(frozen=True, slots=True)
class Subject:
    """A topic, service or action on which the rules decide, with its name and its ROS 2 type ("" while unknown).

    For a part of an action (``part``: ``send_goal``, ``status``, ...), name and type are those of the action.
    """

    kind: Literal["topic", "service", "action"]
    name: str
    type_name: str
    part: str = ""

    @property
    def unknown(self) -> bool:
        """Whether it is part of an action whose type is not known yet."""
        return bool(self.part) and not self.type_name

    def part_name(self, name: str) -> str:
        """Return the name of the topic or service, given the name of the subject, such as the action."""
        return part_name(name, self.part) if self.part else name


class GraphActions:
    """The actions of one graph, recognized by the names and ROS 2 types of its topics and services."""

    def __init__(self, named: Iterable[tuple[str, str]]) -> None:
        self._types: dict[str, str] = {}
        for name, type_name in named:
            action, part = split(name)
            ending = ENDINGS.get(part)
            if ending and type_name.endswith(ending):
                self._types[action] = type_name.removesuffix(ending)

    def subject(self, kind: Literal["topic", "service"], name: str, type_name: str) -> Subject:
        """Return the subject for a topic or service: itself, or the action to which it belongs."""
        action, part = split(name)
        if not part or not (COMMON.get(part) == type_name or type_name.endswith(ENDINGS.get(part, "/"))):
            return Subject(kind, name, type_name)  # this includes a topic that is only named like a part of an action
        return Subject("action", action, self._types.get(action, ""), part)


Crosses = Literal["topic", "service"]
_UNKNOWN = "the other parts of its action are missing, so its type is unknown"


class EntryGate:
    """The gate from the side into the hub."""

    def __init__(self, rules: RuleSet, side: str, endpoints: Iterable[Endpoint]) -> None:
        self._rules, self._side = rules, side
        offered = (e for e in endpoints if e.kind in (Kind.PUBLISHER, Kind.SERVER))
        self._actions = GraphActions((e.topic, ros2_name("topic", e.type)) for e in offered)

    def decide(self, kind: Crosses, name: str, type_name: str) -> RoutePolicy:
        """Return the rules' decision; ``type_name`` is spelled as on the side."""
        subject = self._actions.subject(kind, name, ros2_name(kind, type_name))
        if subject.unknown:
            return RoutePolicy(allowed=False, why=_UNKNOWN, name=name, settled=True)
        return _whole(self._rules.enter(self._side, subject.name, subject.type_name, subject.kind), subject)


class ExitGate:
    """The gate from the hub to the side; traffic from a daemon other than ``daemon`` has passed that daemon's rules."""

    def __init__(self, rules: RuleSet, side: str, daemon: str, endpoints: Iterable[HubEndpoint]) -> None:
        self._rules, self._side, self._daemon = rules, side, daemon
        offered = (e for e in endpoints if e.kind in (EndpointKind.PUBLISHER, EndpointKind.SERVER))
        self._actions = GraphActions((e.topic, e.type_name) for e in offered)

    def decide(self, kind: Crosses, origin: Origin | None, name: str, type_name: str) -> RoutePolicy:
        """Return the rules' decision on traffic from ``origin``."""
        subject = self._actions.subject(kind, name, type_name)
        if subject.unknown:
            return RoutePolicy(allowed=False, why=_UNKNOWN, name=name, settled=True)
        side, elsewhere = ("zenoh", False) if origin is None else (origin.side, origin.daemon != self._daemon)
        policy = self._rules.leave(side, self._side, subject.name, subject.type_name, subject.kind, elsewhere=elsewhere)
        return _whole(policy, subject)


class RelayGate:
    """The gate between the hub's own nodes, whose messages and calls a worker relays (`bridge.routing.relay`)."""

    def __init__(self, rules: RuleSet, endpoints: Iterable[HubEndpoint]) -> None:
        self._rules = rules
        # clients too, which may wait for the action; servers last, because their types count
        offered = sorted(endpoints, key=lambda e: e.kind in (EndpointKind.PUBLISHER, EndpointKind.SERVER))
        self._actions = GraphActions((e.topic, e.type_name) for e in offered)

    def decide(self, kind: Crosses, name: str, type_name: str) -> RoutePolicy:
        """Return the rules' decision; the name does not change."""
        subject = self._actions.subject(kind, name, type_name)
        return _whole(self._rules.relay(subject.name, subject.type_name, subject.kind), subject)


def _whole(policy: RoutePolicy, subject: Subject) -> RoutePolicy:
    """Return the policy for a topic, service or part of an action; the latter two have no rate, priority or QoS."""
    if subject.kind == "topic":
        return policy
    name = subject.part_name(policy.name)
    return replace(policy, name=name, rate=None, priority="", depth=None, timeout=0.5, qos=QosOverride())


def ros2_name(kind: Crosses, type_name: str) -> str:
    """Return the ROS 2 spelling of a type's name, for the rules' ``type`` globs."""
    package, _, name = type_name.partition("/")
    middle = "srv" if kind == "service" else "msg"
    return type_name if "/" in name or not name else f"{package}/{middle}/{name}"
