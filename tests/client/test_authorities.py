"""The names of publishers of transforms."""

from __future__ import annotations

from typing import Any

from bridge.client.authorities import Authorities
from bridge.hub.graph import HubEndpoint
from tests.peers.hub.endpoints import endpoint

GID = b"g" * 16


class Graph:
    """A graph that counts the searches for endpoints."""

    def __init__(self) -> None:
        self.ends: list[HubEndpoint] = []
        self.searches = 0

    def zid_of(self, gid: bytes) -> str:
        return next((end.zid for end in self.ends if end.gid == gid), "")

    def endpoint(self, gid: bytes) -> HubEndpoint | None:
        self.searches += 1
        return next((end for end in self.ends if end.gid == gid), None)


def test_a_publisher_is_searched_once_and_only_if_the_graph_lists_it() -> None:
    graph: Any = Graph()
    authorities = Authorities(graph)
    assert [authorities.name(GID), authorities.name(GID, "a side")] == ["hub", "a side"]
    assert graph.searches == 0
    graph.ends.append(endpoint("/tf", GID))
    end = graph.ends[0]
    assert [authorities.name(GID), authorities.name(GID)] == [f"{end.namespace.rstrip('/')}/{end.node}"] * 2
    assert graph.searches == 1
