"""Fixtures of the whole-daemon tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.peers.daemon.deployment import Deployment


@pytest.fixture
def deployment(tmp_path: Path) -> Iterator[Deployment]:
    """A deployment that the test starts itself."""
    with Deployment(tmp_path) as deployment:
        yield deployment


@pytest.fixture
def running(deployment: Deployment) -> Deployment:
    """A deployment with the default rules, both sides joined."""
    deployment.start()
    return deployment


@pytest.fixture(scope="module")
def of_all_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployment]:
    """A running deployment for a file."""
    with Deployment(tmp_path_factory.mktemp("shared")) as deployment:
        deployment.start()
        yield deployment


@pytest.fixture
def shared(of_all_tests: Deployment) -> Iterator[Deployment]:
    """The deployment of the file, whose tests use separate topics; programs are stopped after each test."""
    yield of_all_tests
    of_all_tests.stop_programs()
