"""The owner of a hub endpoint, as far as the hub knows it."""

from __future__ import annotations

from bridge.hub.graph.endpoints import HubEndpoint
from bridge.sides import label


def owner(endpoint: HubEndpoint) -> str:
    """Return the node of a native endpoint, and the side of one that a worker of Midspan bridges.

    A bridged endpoint carries the node of the worker; the hub does not know the nodes on the side.
    """
    if endpoint.origin is not None:
        return f"a node on {label(endpoint.origin.side) or endpoint.origin.side}"
    return f"{endpoint.namespace.rstrip('/')}/{endpoint.node}"
