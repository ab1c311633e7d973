"""The answer to ``midspan explain``: the decisions on a name, and names on the side without a publisher or server."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bridge.messages.actions import split
from bridge.routing.decision import RouteDecision
from bridge.routing.edge import Endpoint, Kind
from bridge.text import listed

_ENDS = {
    Kind.SUBSCRIPTION: ("topic", "it has no publisher; subscribed by {}"),
    Kind.CLIENT: ("service", "it has no server; clients: {}"),
}
_USERS = {
    ("topic", "in"): (Kind.PUBLISHER, "published by"),
    ("topic", "out"): (Kind.SUBSCRIPTION, "subscribed by"),
    ("service", "in"): (Kind.SERVER, "served by"),
    ("service", "out"): (Kind.CLIENT, "called by"),
}
"""The kind of a decision's endpoints on the side, and a verb for them, by the decision's kind and direction."""


def explain(
    topic: str, decisions: Iterable[RouteDecision], endpoints: Sequence[Endpoint], programs: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Return all decisions on a topic, service or action; on everything for ``""``.

    ``topic`` is compared with the names on the side and on the hub; an action's name matches its five parts. The
    ``users`` of an entry list the side's nodes, and the middleware and the release of their programs.

    Args:
        topic: the name of the topic, service or action.
        decisions: all decisions of the side.
        endpoints: the side's graph.
        programs: as `Edge.programs` returns them.
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
    return _with_users(answer, endpoints, programs)


def _with_users(
    answer: list[dict[str, Any]], endpoints: Iterable[Endpoint], programs: Mapping[str, str]
) -> list[dict[str, Any]]:
    nodes: dict[tuple[Kind, str], dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for endpoint in endpoints:
        program = programs.get(endpoint.id)
        if program is not None:
            nodes[endpoint.kind, endpoint.topic][program].add(endpoint.node or "a node with an unknown name")
    for entry in answer:
        kind, verb = _USERS[entry["kind"], entry["direction"]]
        users = sorted(nodes[kind, entry["topic"]].items()) if (kind, entry["topic"]) in nodes else ()
        entry["users"] = [f"{verb} {listed(sorted(names))} on {program}" for program, names in users]
    return answer
