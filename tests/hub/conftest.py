"""Hubs for tests: one router for each module, and a domain that is derived from the test's name."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.peers.hub.network import HubNetwork


@pytest.fixture(scope="module")
def shared_network() -> Iterator[HubNetwork]:
    """One router for the tests of a module."""
    with HubNetwork() as network:
        yield network


@pytest.fixture
def network(shared_network: HubNetwork, request: pytest.FixtureRequest) -> HubNetwork:
    """A domain on the module's router; it is derived from the test's name, so that tests rarely share one."""
    shared_network.domain = 1 + sum(request.node.name.encode()) * 7 % 200
    return shared_network
