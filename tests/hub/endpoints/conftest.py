"""Nodes of other ROS 2 releases on the hub."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.releases import Nodes, Release, ReleaseNode


@pytest.fixture
def node(network: HubNetwork) -> Iterator[Nodes]:
    """Yield a function that opens a node of a ROS 2 release."""
    nodes: list[ReleaseNode] = []

    def opened(release: Release) -> ReleaseNode:
        nodes.append(ReleaseNode(network.endpoint, network.domain, f"{release.name}_{len(nodes)}", release))
        return nodes[-1]

    yield opened
    for node in nodes:
        node.close()
