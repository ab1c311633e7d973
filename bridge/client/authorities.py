"""Names of the publishers of transforms."""

from __future__ import annotations

from collections.abc import Callable

from bridge.hub.graph import HubGraph

_MOST = 4096  # cached publishers; a full cache is cleared


class Authorities:
    """Maps each publisher to the name of its node, or to the side for which a bridge worker publishes.

    Args:
        graph: the hub's graph.
        side_name: formats the name of a side for people.
    """

    def __init__(self, graph: HubGraph, side_name: Callable[[str], str] = str) -> None:
        self._graph, self._side_name = graph, side_name
        self._known: dict[bytes, str] = {}

    def name(self, gid: bytes, unlisted: str = "hub") -> str:
        """Return the name of the publisher with a GID; ``unlisted`` while the graph does not list it."""
        known = self._known.get(gid)
        if known is not None:
            return known
        # a publisher that the graph never lists is searched for each message, so check first whether it is listed
        endpoint = self._graph.endpoint(gid) if self._graph.zid_of(gid) else None
        if endpoint is None:
            return unlisted
        origin = endpoint.origin
        node = f"{endpoint.namespace.rstrip('/')}/{endpoint.node}"
        if len(self._known) >= _MOST:
            self._known.clear()
        known = self._known[gid] = node if origin is None else f"{self._side_name(origin.side)} by {origin.daemon}"
        return known
