"""The two gates that all topics and services pass: what the rules say where one enters the hub, and where it leaves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Literal

from bridge.adapters.base import Endpoint, Kind
from bridge.config.sections.routing import QosOverride
from bridge.hub.graph import HubEndpoint
from bridge.hub.liveliness import EndpointKind
from bridge.hub.origin import Origin
from bridge.routing.rules import Decision, RuleSet
from bridge.routing.subject import Actions, Subject

Crosses = Literal["topic", "service"]
_UNKNOWN = "the other parts of its action are not seen, so its type is not known"


class EntryGate:
    """From the side into the hub.

    Args:
        rules: the configuration's.
        side: the edge's.
        endpoints: the side's graph.
    """

    def __init__(self, rules: RuleSet, side: str, endpoints: Iterable[Endpoint]) -> None:
        self._rules, self._side = rules, side
        offered = (e for e in endpoints if e.kind in (Kind.PUBLISHER, Kind.SERVER))
        self._actions = Actions((e.topic, _ros2_name("topic", e.type)) for e in offered)

    def decide(self, kind: Crosses, name: str, type_name: str) -> Decision:
        """What the rules say; ``type_name`` as the side spells it."""
        subject = self._actions.subject(kind, name, _ros2_name(kind, type_name))
        if subject.unknown:
            return Decision(allowed=False, why=_UNKNOWN, name=name, settled=True)
        return _whole(self._rules.enter(self._side, subject.name, subject.type_name, subject.kind), subject)


class ExitGate:
    """From the hub to the side.

    Args:
        rules: the configuration's.
        side: the edge's.
        daemon: this daemon's name: the rules of another one let in what comes by it.
        endpoints: the hub's graph.
    """

    def __init__(self, rules: RuleSet, side: str, daemon: str, endpoints: Iterable[HubEndpoint]) -> None:
        self._rules, self._side, self._daemon = rules, side, daemon
        offered = (e for e in endpoints if e.kind in (EndpointKind.PUBLISHER, EndpointKind.SERVER))
        self._actions = Actions((e.topic, e.type_name) for e in offered)

    def decide(self, kind: Crosses, origin: Origin | None, name: str, type_name: str) -> Decision:
        """What the rules say of what came from ``origin``."""
        subject = self._actions.subject(kind, name, type_name)
        if subject.unknown:
            return Decision(allowed=False, why=_UNKNOWN, name=name, settled=True)
        side, elsewhere = ("zenoh", False) if origin is None else (origin.side, origin.daemon != self._daemon)
        decision = self._rules.leave(
            side, self._side, subject.name, subject.type_name, subject.kind, elsewhere=elsewhere
        )
        return _whole(decision, subject)


def _whole(decision: Decision, subject: Subject) -> Decision:
    """The decision for a part of an action: the name is moved, and nothing else of a rule holds."""
    if subject.kind == "topic":
        return decision
    name = subject.part_name(decision.name)
    return replace(decision, name=name, rate=None, priority="", depth=None, timeout=0.5, qos=QosOverride())


def _ros2_name(kind: Crosses, type_name: str) -> str:
    """A type's ROS 2 spelling as far as the name alone tells, for the rules' ``type`` globs."""
    package, _, name = type_name.partition("/")
    middle = "srv" if kind == "service" else "msg"
    return type_name if "/" in name or not name else f"{package}/{middle}/{name}"
