"""What messages lose between this machine's version of a type and those of other releases' nodes on the hub."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from bridge.hub.endpoints.variants import REQUEST, RESPONSE, TypeVersions
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import EndpointKind
from bridge.hub.session import Hub
from bridge.routing.decision import RouteDecision

_KINDS = {
    ("topic", "in"): EndpointKind.SUBSCRIPTION,
    ("topic", "out"): EndpointKind.PUBLISHER,
    ("service", "in"): EndpointKind.CLIENT,
    ("service", "out"): EndpointKind.SERVER,
}
"""The endpoints of the hub at the far end of a route, by its kind and direction."""


def note_losses(hub: Hub, decisions: Iterable[RouteDecision]) -> None:
    """Note in the decisions on bridged names which fields are lost, once for each version."""
    versions = hub.versions
    others: dict[tuple[EndpointKind, str], dict[tuple[str, str], HubEndpoint]] = {}
    for end in hub.graph.endpoints():
        if not end.own and versions.here(end.type_name, end.type_hash) != end.type_hash:
            others.setdefault((end.kind, end.topic), {}).setdefault((end.type_name, end.type_hash), end)
    for decision in decisions if others else ():
        kind = _KINDS[decision.of, decision.direction]
        ends = others.get((kind, decision.hub_topic), {}).values() if decision.kind == "bridged" else ()
        # the side's names of types may differ
        texts = (_text(end, versions) for end in ends if decision.direction == "in" or end.type_name == decision.type)
        decision.note = "; ".join(filter(None, texts))


def _text(end: HubEndpoint, versions: TypeVersions) -> str:
    fields = list(dict.fromkeys(_lost(end, versions)))
    if not fields:
        return ""
    release, verb = versions.release(end.type_name, end.type_hash), "is" if len(fields) == 1 else "are"
    return f"{end.node} has {release}'s version of {end.type_name}: {', '.join(fields)} {verb} left out"


def _lost(end: HubEndpoint, versions: TypeVersions) -> Iterator[str]:
    name, here = end.type_name, versions.here(end.type_name, end.type_hash)
    match end.kind:
        case EndpointKind.PUBLISHER:
            yield from versions.lost(name, end.type_hash, here)
        case EndpointKind.SUBSCRIPTION:
            yield from versions.lost(name, here, end.type_hash)
        case EndpointKind.SERVER:
            yield from versions.lost(name, here, end.type_hash, REQUEST)
            yield from versions.lost(name, end.type_hash, here, RESPONSE)
        case EndpointKind.CLIENT:
            yield from versions.lost(name, end.type_hash, here, REQUEST)
            yield from versions.lost(name, here, end.type_hash, RESPONSE)
