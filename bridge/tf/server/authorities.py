"""Who says where a frame is: the names of publishers on the hub."""

from __future__ import annotations

from bridge.hub.graph import HubGraph

_MOST = 4096
"""Publishers that are remembered; then it begins anew."""


class Authorities:
    """Names publishers by the nodes that they belong to, or the side that a bridge worker speaks for.

    Args:
        graph: of the hub.
    """

    def __init__(self, graph: HubGraph) -> None:
        self._graph = graph
        self._known: dict[bytes, str] = {}

    def name(self, gid: bytes) -> str:
        """Who has this GID; ``hub`` for one that the graph does not know yet."""
        known = self._known.get(gid)
        if known is not None:
            return known
        endpoint = self._graph.endpoint(gid)
        if endpoint is None:
            return "hub"
        origin = endpoint.origin
        node = f"{endpoint.namespace.rstrip('/')}/{endpoint.node}"
        if len(self._known) >= _MOST:
            self._known.clear()
        known = self._known[gid] = node if origin is None else f"{origin.side} by {origin.daemon}"
        return known
