"""One roscore and one edge per module, for tests that do not stop them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.peers.ros1.adapter import EdgeUnderTest, edge_on
from tests.peers.ros1.network import RosMaster


@pytest.fixture(scope="module")
def master() -> Iterator[RosMaster]:
    """A roscore for the whole module; tests use unique topic and node names."""
    with RosMaster() as master:
        yield master


@pytest.fixture(scope="module")
def edge(master: RosMaster, tmp_path_factory: pytest.TempPathFactory) -> Iterator[EdgeUnderTest]:
    """An edge on that master, in a separate process."""
    with edge_on(master, tmp_path_factory.mktemp("state")) as edge:
        yield edge
