"""The gates between a side and the hub: the rules where something enters or leaves, and the loop guard.

No transit: what any Midspan made on a foreign network is never taken up from it again (each edge tells by marks on that
network), and what came from a network is never put onto it again. While it is unknown who made an endpoint, nothing
crosses. Of several workers that could bring the same message to a network one does; see `bridge.routing.election`.

The rules see an action whole: by its own name, by its own type, and a new name moves all five of its topics and
services. Its cancel service and its status topic have the same type in every action, so that the action's type is
taken from the other three.
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
    """Whether a hub publisher's messages may be published on the edge's network."""
    if endpoint.own or endpoint.pending or endpoint.topic.startswith(TAPS):
        return False
    return endpoint.origin is None or not edge.is_own_network(endpoint.origin)


def may_carry(endpoint: HubEndpoint, outcome: Outcome) -> bool:
    """Whether it is this worker that puts a hub publisher's messages on its network, and not another one there."""
    return outcome.active and (endpoint.origin is None or endpoint.zid in outcome.carried)


@dataclass(frozen=True, slots=True)
class Subject:
    """A topic, service or action that the rules decide on: its name, and its type as ROS 2 spells it, "" while unknown.

    Of a part of an action both are the action's; ``part`` is which: ``send_goal``, ``status`` ...
    """

    kind: Literal["topic", "service", "action"]
    name: str
    type_name: str
    part: str = ""

    @property
    def unknown(self) -> bool:
        """Whether it belongs to an action whose type is not known yet."""
        return bool(self.part) and not self.type_name

    def part_name(self, name: str) -> str:
        """The topic's or service's name where the whole is called ``name``."""
        return part_name(name, self.part) if self.part else name


class GraphActions:
    """The actions of one graph, by the name and ROS 2 type of each topic and service on it."""

    def __init__(self, named: Iterable[tuple[str, str]]) -> None:
        self._types: dict[str, str] = {}
        for name, type_name in named:
            action, part = split(name)
            ending = ENDINGS.get(part)
            if ending and type_name.endswith(ending):
                self._types[action] = type_name.removesuffix(ending)

    def subject(self, kind: Literal["topic", "service"], name: str, type_name: str) -> Subject:
        """The subject that a topic or a service is, or belongs to."""
        action, part = split(name)
        if not part or not (COMMON.get(part) == type_name or type_name.endswith(ENDINGS.get(part, "/"))):
            return Subject(kind, name, type_name)  # also what is only called like a part of an action
        return Subject("action", action, self._types.get(action, ""), part)


Crosses = Literal["topic", "service"]
_UNKNOWN = "the other parts of its action are not seen, so its type is not known"


class EntryGate:
    """From the side into the hub."""

    def __init__(self, rules: RuleSet, side: str, endpoints: Iterable[Endpoint]) -> None:
        self._rules, self._side = rules, side
        offered = (e for e in endpoints if e.kind in (Kind.PUBLISHER, Kind.SERVER))
        self._actions = GraphActions((e.topic, _ros2_name("topic", e.type)) for e in offered)

    def decide(self, kind: Crosses, name: str, type_name: str) -> RoutePolicy:
        """The policy of the rules; ``type_name`` as the side spells it."""
        subject = self._actions.subject(kind, name, _ros2_name(kind, type_name))
        if subject.unknown:
            return RoutePolicy(allowed=False, why=_UNKNOWN, name=name, settled=True)
        return _whole(self._rules.enter(self._side, subject.name, subject.type_name, subject.kind), subject)


class ExitGate:
    """From the hub to the side; what comes by another daemon than ``daemon`` was let in by that one's rules."""

    def __init__(self, rules: RuleSet, side: str, daemon: str, endpoints: Iterable[HubEndpoint]) -> None:
        self._rules, self._side, self._daemon = rules, side, daemon
        offered = (e for e in endpoints if e.kind in (EndpointKind.PUBLISHER, EndpointKind.SERVER))
        self._actions = GraphActions((e.topic, e.type_name) for e in offered)

    def decide(self, kind: Crosses, origin: Origin | None, name: str, type_name: str) -> RoutePolicy:
        """The policy of the rules for what came from ``origin``."""
        subject = self._actions.subject(kind, name, type_name)
        if subject.unknown:
            return RoutePolicy(allowed=False, why=_UNKNOWN, name=name, settled=True)
        side, elsewhere = ("zenoh", False) if origin is None else (origin.side, origin.daemon != self._daemon)
        policy = self._rules.leave(side, self._side, subject.name, subject.type_name, subject.kind, elsewhere=elsewhere)
        return _whole(policy, subject)


def _whole(policy: RoutePolicy, subject: Subject) -> RoutePolicy:
    """The policy for a part of an action: of a rule only the new name applies."""
    if subject.kind == "topic":
        return policy
    name = subject.part_name(policy.name)
    return replace(policy, name=name, rate=None, priority="", depth=None, timeout=0.5, qos=QosOverride())


def _ros2_name(kind: Crosses, type_name: str) -> str:
    """A type's ROS 2 spelling as far as the name alone tells, for the rules' ``type`` globs."""
    package, _, name = type_name.partition("/")
    middle = "srv" if kind == "service" else "msg"
    return type_name if "/" in name or not name else f"{package}/{middle}/{name}"
