"""The ROS 2 releases of the hub's native nodes, as far as their tokens show them.

The forms of tokens differ between the releases of rmw_zenoh: see `bridge.hub.graph.hashes` for Humble and
`bridge.hub.wire.buffers` for Lyrical. rmw_zenoh was not released for Iron.
"""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass

from typing_extensions import override

from bridge.hub.graph.endpoints import HubEndpoint
from bridge.hub.graph.owners import owner
from bridge.hub.graph.tokens import UNKNOWN_HASH, EndpointKind
from bridge.hub.wire.buffers import BUFFER_TYPES
from bridge.messages import releases
from bridge.messages.releases import Release, Releases, release_text

_RMW_ZENOH = releases.ALL - {Release.IRON}
_TOPIC_ENDS = (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION)
_WITH_BUFFERS = frozenset({Release.LYRICAL})


@dataclass(frozen=True, slots=True)
class NativeNodes:
    """Nodes that may belong to the same releases; ``hashless``: they announce no type hashes."""

    release: str
    hashless: bool
    nodes: tuple[str, ...]

    @override
    def __str__(self) -> str:
        return f"rmw_zenoh ({self.release or 'unknown release'})"


def endpoint_releases(endpoint: HubEndpoint) -> Releases:
    """Return the releases whose rmw_zenoh may have announced a native endpoint."""
    if endpoint.hashless:
        return releases.WITHOUT_HASHES
    if endpoint.buffers:
        return _WITH_BUFFERS
    if endpoint.type_hash == UNKNOWN_HASH:  # the subscription accepts any hash
        return releases.ALL
    admitted = releases.by_hash(endpoint.type_name, endpoint.type_hash) & _RMW_ZENOH
    plain = endpoint.type_name in BUFFER_TYPES and endpoint.kind in _TOPIC_ENDS and not endpoint.qos.latched
    return admitted - _WITH_BUFFERS if plain else admitted


def native_nodes(endpoints: Iterable[HubEndpoint], midspan: Container[str] = ()) -> list[NativeNodes]:
    """Return the hub's native nodes by release; ``midspan`` contains the sessions (zid) of Midspan programs."""
    of_node: dict[tuple[str, str], list[HubEndpoint]] = {}
    for end in endpoints:
        if end.origin is None and not end.pending and not end.own and end.zid not in midspan:
            of_node.setdefault((owner(end), end.zid), []).append(end)
    groups: dict[tuple[str, bool], set[str]] = {}
    for (name, _), ends in of_node.items():
        release = release_text(releases.common(map(endpoint_releases, ends)))
        groups.setdefault((release, all(end.hashless for end in ends)), set()).add(name)
    return [NativeNodes(*key, tuple(sorted(names))) for key, names in sorted(groups.items())]
