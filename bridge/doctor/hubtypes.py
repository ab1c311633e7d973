"""Endpoints of one topic on the hub that cannot hear each other, because their types or hashes differ."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from bridge.hub.graph import HubEndpoint
from bridge.hub.liveliness import UNKNOWN_HASH, EndpointKind

CURE = (
    "install the same version of the message package on both machines, or give its .msg folder to Midspan as"
    " types.folders"
)


@dataclass(frozen=True, slots=True)
class Conflict:
    """What differs on one topic; ``text`` says it, ``cure`` how to mend it."""

    topic: str
    text: str
    cure: str


def conflicts(endpoints: Iterable[HubEndpoint]) -> list[Conflict]:
    """Topics of the hub with several types, or with several hashes of one type."""
    topics: dict[str, dict[str, dict[str, list[HubEndpoint]]]] = {}
    for endpoint in endpoints:
        if endpoint.kind in (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION):
            hashes = topics.setdefault(endpoint.topic, {}).setdefault(endpoint.type_name, {})
            if endpoint.type_hash != UNKNOWN_HASH:
                hashes.setdefault(endpoint.type_hash, []).append(endpoint)
    found: list[Conflict] = []
    for topic, types in sorted(topics.items()):
        if len(types) > 1:
            text = (
                f"{topic} has {len(types)} types on the hub ({', '.join(sorted(types))}); they do not hear each other"
            )
            found.append(Conflict(topic, text, "give one of them another name, or rename it by a rule"))
        for type_name, hashes in sorted(types.items()):
            if len(hashes) > 1:
                who = "; ".join(f"{nodes(e)} {h[:17]}..." for h, e in sorted(hashes.items()))
                text = f"{topic}: the definitions of {type_name} differ ({who}); they do not hear each other"
                found.append(Conflict(topic, text, CURE))
    return found


def nodes(endpoints: Iterable[HubEndpoint]) -> str:
    """The nodes of some endpoints, for people."""
    return ", ".join(sorted({f"{e.namespace.rstrip('/')}/{e.node}" for e in endpoints}))
