"""Fixtures of the tests with a running map server."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.navigation.map2d_server.served import Served


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with Served(tmp_path_factory.mktemp("served")) as served:
        yield served


@pytest.fixture
def served(running: Served) -> Served:
    running.fresh()
    return running
