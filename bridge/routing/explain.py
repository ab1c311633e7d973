"""The answer of ``midspan explain``: the decisions on a name, and names on the side with only one kind of endpoint."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import Any

from bridge.messages.actions import split
from bridge.routing.decision import RouteDecision
from bridge.routing.edge import Endpoint, Kind

_ENDS = {
    Kind.SUBSCRIPTION: ("topic", "it has no publisher; subscribed by {}"),
    Kind.CLIENT: ("service", "it has no server; clients: {}"),
}


def explain(topic: str, decisions: Iterable[RouteDecision], endpoints: Iterable[Endpoint]) -> list[dict[str, Any]]:
    """Return all decisions on a topic, service or action; on everything for ``""``.

    The name on the side and the one on the hub both match; an action's name matches its five parts. ``endpoints`` is
    the side's graph.
    """
    name = topic if topic.startswith("/") or not topic else "/" + topic

    def wanted(*names: str) -> bool:
        return not name or any(name in (candidate, split(candidate)[0]) for candidate in names)

    answer = [decision.as_dict() for decision in decisions if wanted(decision.topic, decision.hub_topic)]
    decided = {str(entry[key]) for entry in answer for key in ("topic", "hub_topic")}
    ends: dict[tuple[Kind, str], list[Endpoint]] = defaultdict(list)
    for endpoint in endpoints:
        if endpoint.kind in _ENDS and wanted(endpoint.topic) and endpoint.topic not in decided:
            ends[endpoint.kind, endpoint.topic].append(endpoint)
    for (kind, topic_name), users in ends.items():
        of, text = _ENDS[kind]
        reason = text.format(", ".join(sorted({user.node for user in users})))
        answer.append(RouteDecision.one_ended(topic_name, users[0].type, reason, of).as_dict())
    return answer
