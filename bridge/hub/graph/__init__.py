"""The participants on the hub: nodes, endpoints and origins, from the liveliness tokens of all sessions."""

from bridge.hub.graph.endpoints import HubEndpoint, HubNode, origin_side
from bridge.hub.graph.view import HubGraph

__all__ = ["HubEndpoint", "HubGraph", "HubNode", "origin_side"]
