"""The participants of the hub: nodes, endpoints and origins, from the liveliness tokens of all sessions."""

from bridge.hub.graph.view import HubEndpoint, HubGraph, HubNode, origin_side

__all__ = ["HubEndpoint", "HubGraph", "HubNode", "origin_side"]
