"""Hubs for tests: one router for each module, and a domain for each test."""

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
def network(shared_network: HubNetwork) -> HubNetwork:
    """A domain of the test's own on the module's router."""
    shared_network.domain = 1 + shared_network.domain % 200
    return shared_network
