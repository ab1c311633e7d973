"""A hub with nodes of several ROS 2 releases, and workers that may relay between them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from bridge.config.sections.routing import RoutingSection
from bridge.hub.node import Hub
from bridge.routing.hold import Hold
from bridge.routing.relay.relay import HubRelay
from bridge.routing.rules import RuleSet
from bridge.routing.stall import StallDetector
from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.release_actions import REGISTRY
from tests.peers.zenoh.releases import Nodes, Release, ReleaseNode


class Relay:
    """A worker's hub node with its relay, which holds ``/cmd_vel`` back if a gateway requests it."""

    def __init__(self, network: HubNetwork, name: str, rules: list[dict[str, Any]]) -> None:
        settings = network.settings(name)
        self.hub = Hub.open(settings)
        self.hub.versions = REGISTRY.releases
        self._stall = StallDetector()
        self.failures: list[str] = []
        section = RoutingSection.model_validate({"rules": rules})
        self.hold = Hold(self.hub, (), {"/cmd_vel"})
        self.relay = HubRelay(self.hub, settings, RuleSet(section), self._stall, self.hold, self.failures.append)
        self._stall.start()
        self.relay.start()

    def close(self) -> None:
        """Stop the relay, and leave the hub."""
        self.relay.stop()
        self.hold.close()
        self._stall.stop()
        self.hub.close()
        assert not self.failures


Relays = Callable[..., Relay]
"""Starts a worker with these rules."""


@pytest.fixture(scope="module")
def shared_network() -> Iterator[HubNetwork]:
    with HubNetwork() as network:
        yield network


@pytest.fixture
def network(shared_network: HubNetwork) -> HubNetwork:
    shared_network.domain = 1 + shared_network.domain % 200
    return shared_network


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def relay(network: HubNetwork, stack: ExitStack) -> Relays:
    def started(*rules: dict[str, Any]) -> Relay:
        relay = Relay(network, f"worker_{len(relays)}", list(rules))
        relays.append(relay)
        stack.callback(relay.close)
        return relay

    relays: list[Relay] = []
    return started


@pytest.fixture
def node(network: HubNetwork, stack: ExitStack) -> Nodes:
    def opened(release: Release) -> ReleaseNode:
        nodes.append(ReleaseNode(network.endpoint, network.domain, f"{release.name}_{len(nodes)}", release))
        stack.callback(nodes[-1].close)
        return nodes[-1]

    nodes: list[ReleaseNode] = []
    return opened
