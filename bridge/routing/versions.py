"""What ``explain`` reports on versions of types: the fields that are lost, and servers of a second version."""

from __future__ import annotations

from collections.abc import Iterable

from bridge.hub.endpoints.variants import REQUEST, RESPONSE, TypeVersions
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import EndpointKind
from bridge.hub.node import Hub
from bridge.routing.decision import RouteDecision
from bridge.routing.edge import Edge, Obstacle

_KINDS = {
    ("topic", "in"): EndpointKind.SUBSCRIPTION,
    ("topic", "out"): EndpointKind.PUBLISHER,
    ("service", "in"): EndpointKind.CLIENT,
    ("service", "out"): EndpointKind.SERVER,
}
"""The kind of the hub endpoints at the far end of a route, by the route's kind and direction."""


def note_losses(hub: Hub, edge: Edge, decisions: Iterable[RouteDecision]) -> None:
    """Add to the decisions on bridged names which fields are lost, once for each version of a type."""
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
    release = versions.release(end.type_name, end.type_hash)
    return loss_text(versions, end.kind, end.type_name, end.type_hash, f"{end.node} has {release}'s version")


def loss_text(versions: TypeVersions, kind: EndpointKind, type_name: str, type_hash: str, whose: str) -> str:
    """Return which fields are lost between an endpoint of another version and this machine, "" if none.

    Args:
        versions: the known versions.
        kind: kind of the endpoint.
        type_name: type of the endpoint.
        type_hash: hash of the endpoint's version of the type.
        whose: beginning of the text, which names the node and its version.
    """
    left_out: dict[str, None] = {}
    changed: dict[str, None] = {}
    for source, target, part in _crossings(kind, type_hash, versions.here(type_name, type_hash)):
        lost, other = versions.losses(type_name, source, target, part)
        left_out.update(dict.fromkeys(lost))
        changed.update(dict.fromkeys(other))
    verb = "is" if len(left_out) == 1 else "are"
    texts = [f"{', '.join(left_out)} {verb} left out"] if left_out else []
    texts += changed
    return f"{whose} of {type_name}: {'; '.join(texts)}" if texts else ""


def _crossings(kind: EndpointKind, theirs: str, here: str) -> tuple[tuple[str, str, str], ...]:
    """Return the conversions of an endpoint's messages: source version, target version, and part of a service."""
    match kind:
        case EndpointKind.PUBLISHER:
            return ((theirs, here, ""),)
        case EndpointKind.SUBSCRIPTION:
            return ((here, theirs, ""),)
        case EndpointKind.SERVER:
            return (here, theirs, REQUEST), (theirs, here, RESPONSE)
        case EndpointKind.CLIENT:
            return (theirs, here, REQUEST), (here, theirs, RESPONSE)


def second_version(versions: TypeVersions, name: str, type_name: str, offered: str, other: str) -> Obstacle:
    """Return why a server is not offered in addition to one with another version of the type, and how to fix that.

    Args:
        versions: the known versions.
        name: name of the service.
        type_name: type of both servers.
        offered: hash of the version that is offered.
        other: hash of the version that is not offered.
    """
    first, second = (_label(versions, type_name, version) for version in (offered, other))
    cure = "stop one of the servers, give one another name, or install the same version of the package for both"
    if not all(versions.release(type_name, version) for version in (offered, other)):
        cure += "; to use an unknown version, name the folder of its files in types.folders"
    return Obstacle(f"{name} is already offered with {first} of {type_name}; this server has {second}", cure)


def _label(versions: TypeVersions, type_name: str, version: str) -> str:
    release = versions.release(type_name, version)
    return f"{release}'s version" if release else f"version {version}"
