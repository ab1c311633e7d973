"""The owner of a hub endpoint, as far as it is known on the hub."""

from __future__ import annotations

from bridge.hub.graph.endpoints import HubEndpoint
from bridge.sides import label


def owner(endpoint: HubEndpoint) -> str:
    """Return the node of a native endpoint, or the side of an endpoint that a Midspan worker bridges.

    A bridged endpoint announces the worker's node; the nodes on the side are not known on the hub.
    """
    if endpoint.origin is not None:
        return f"a node on {label(endpoint.origin.side) or endpoint.origin.side}"
    return f"{endpoint.namespace.rstrip('/')}/{endpoint.node}"
