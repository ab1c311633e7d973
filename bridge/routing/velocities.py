"""The velocities that a side's own nodes subscribe to, so that programs on the hub publish the form of the base.

A route to the side exists only once the hub has a publisher, and it subscribes on the hub with or without a subscriber
on the side. So the hub's endpoints do not show what a base expects, and each side announces it separately.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bridge.routing.edge import Edge, Endpoint, Kind, MadeBy
from bridge.routing.gates import ExitGate, ros2_name
from bridge.routing.limits import COMMAND_TYPES
from bridge.routing.rules import RuleSet


def subscribed_velocities(
    edge: Edge, endpoints: Sequence[Endpoint], gate: ExitGate, rules: RuleSet
) -> frozenset[tuple[str, str]]:
    """Return hub topic and type of each topic of velocities that reaches a native subscription on the side.

    A topic that a rule with wildcards renames is not recognized.
    """
    native = (e for e in endpoints if e.kind is Kind.SUBSCRIPTION and e.made_by is MadeBy.NATIVE)
    wanted = {(e.topic, ros2_name("topic", e.type)) for e in native}
    return frozenset(
        (hub_topic, type_name)
        for side_topic, type_name in wanted
        if type_name in COMMAND_TYPES
        for hub_topic in _hub_topics(edge, side_topic, rules)
        if _leads_to(edge, gate, hub_topic, type_name) == side_topic
    )


def _hub_topics(edge: Edge, side_topic: str, rules: RuleSet) -> Iterator[str]:
    yield edge.hub_name(side_topic)
    yield from (rule.topic for rule in rules.section.rules if rule.topic and rule.rename == side_topic)


def _leads_to(edge: Edge, gate: ExitGate, hub_topic: str, type_name: str) -> str:
    """Return the side's topic on which messages of the hub's own programs arrive, "" if they do not cross."""
    policy = gate.decide("topic", None, hub_topic, type_name)
    name = policy.name if policy.name != hub_topic else edge.side_name(hub_topic)
    return name if policy.allowed and not edge.why_not(name, type_name) else ""
