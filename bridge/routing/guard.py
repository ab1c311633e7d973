"""The loop guard: what may leave the hub to a side, by who made it, never by a name that a user chose.

No transit: what any Midspan made on a foreign network is never taken up from it again (each edge tells by marks on that
network), and what came from a network is never put onto it again. While it is unknown who made an endpoint, nothing
crosses. Of several workers that could bring the same message to a network one does; see `bridge.routing.election`.
"""

from __future__ import annotations

from bridge.adapters.base import Edge
from bridge.hub.graph import HubEndpoint
from bridge.routing.election import Outcome

TAPS = "/_midspan/"
"""Hub names under which workers show what does not cross to those who ask for it; nothing of it leaves the hub."""


def may_leave(endpoint: HubEndpoint, edge: Edge) -> bool:
    """Whether a hub publisher's messages may be published on the edge's network."""
    if endpoint.own or endpoint.pending or endpoint.topic.startswith(TAPS):
        return False
    return endpoint.origin is None or not edge.is_own_network(endpoint.origin)


def may_carry(endpoint: HubEndpoint, outcome: Outcome) -> bool:
    """Whether it is this worker that puts a hub publisher's messages on its network, and not another one there."""
    return outcome.active and (endpoint.origin is None or endpoint.zid in outcome.carried)


def origin_side(endpoint: HubEndpoint) -> str:
    """The side that a hub publisher's messages come from, ``zenoh`` for a native participant of the hub."""
    return "zenoh" if endpoint.origin is None else endpoint.origin.side
