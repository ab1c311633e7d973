"""What messages lose between this machine's version of a type and those of other releases' nodes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from bridge.hub.endpoints.variants import REQUEST, RESPONSE, TypeVersions
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import EndpointKind
from bridge.hub.session import Hub
from bridge.routing.decision import RouteDecision
from bridge.routing.edge import Edge

_KINDS = {
    ("topic", "in"): EndpointKind.SUBSCRIPTION,
    ("topic", "out"): EndpointKind.PUBLISHER,
    ("service", "in"): EndpointKind.CLIENT,
    ("service", "out"): EndpointKind.SERVER,
}
"""The endpoints of the hub at the far end of a route, by its kind and direction."""


def note_losses(hub: Hub, edge: Edge, decisions: Iterable[RouteDecision]) -> None:
    """Note in the decisions on bridged names which fields are lost, once for each version."""
    versions, of_side = hub.versions, dict(edge.version_notes())
    others: dict[tuple[EndpointKind, str], dict[tuple[str, str], HubEndpoint]] = {}
    for end in hub.graph.endpoints():
        if not end.own and versions.here(end.type_name, end.type_hash) != end.type_hash:
            others.setdefault((end.kind, end.topic), {}).setdefault((end.type_name, end.type_hash), end)
    for decision in decisions if others or of_side else ():
        if decision.kind != "bridged":
            continue
        ends = others.get((_KINDS[decision.of, decision.direction], decision.hub_topic), {}).values()
        # the side's names of types may differ
        texts = [_text(end, versions) for end in ends if decision.direction == "in" or end.type_name == decision.type]
        texts += of_side.pop((decision.of, decision.direction, decision.topic), ())
        decision.note = "; ".join(filter(None, texts))


def _text(end: HubEndpoint, versions: TypeVersions) -> str:
    here = versions.here(end.type_name, end.type_hash)
    fields = lost_fields(versions, end.kind, end.type_name, end.type_hash, here)
    return loss_text(end.node, versions.release(end.type_name, end.type_hash), end.type_name, fields)


def loss_text(node: str, release: str, type_name: str, lost: Iterable[str]) -> str:
    """Return which fields of a node's type are lost, "" if none is."""
    fields = list(dict.fromkeys(lost))
    if not fields:
        return ""
    verb = "is" if len(fields) == 1 else "are"
    return f"{node} has {release}'s version of {type_name}: {', '.join(fields)} {verb} left out"


def lost_fields(versions: TypeVersions, kind: EndpointKind, name: str, theirs: str, here: str) -> Iterator[str]:
    """Yield the fields that messages between an endpoint of another version and this machine lose."""
    match kind:
        case EndpointKind.PUBLISHER:
            yield from versions.lost(name, theirs, here)
        case EndpointKind.SUBSCRIPTION:
            yield from versions.lost(name, here, theirs)
        case EndpointKind.SERVER:
            yield from versions.lost(name, here, theirs, REQUEST)
            yield from versions.lost(name, theirs, here, RESPONSE)
        case EndpointKind.CLIENT:
            yield from versions.lost(name, theirs, here, REQUEST)
            yield from versions.lost(name, here, theirs, RESPONSE)
