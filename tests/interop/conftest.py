"""Fixtures of the whole-daemon tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.ros1.network import EMBEDDED

ON_BOTH_MASTERS = {
    "test_every_direction_without_the_lane", "test_parameters_are_shared_in_both_directions",
    "test_a_clean_stop_leaves_nothing_on_the_master", "test_the_goal_of_a_ros_1_client_continues_and_is_canceled",
    "test_the_goal_of_a_hub_client_continues_and_a_killed_planner_is_lost",
}  # fmt: skip
"""Tests in which the master has a part, also run on Midspan's own; `make test-embedded-master` runs all on it."""


@pytest.hookimpl(trylast=True)  # as in tests/contract
def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run some tests on both masters."""
    if metafunc.definition.originalname in ON_BOTH_MASTERS and not EMBEDDED:
        embedded = pytest.param(True, marks=pytest.mark.thorough)
        metafunc.parametrize("embedded", [False, embedded], ids=["roscore", "embedded_master"])


@pytest.fixture
def embedded() -> bool:
    """Whether the deployment has Midspan's own ROS 1 master."""
    return EMBEDDED


@pytest.fixture
def deployment(tmp_path: Path, *, embedded: bool) -> Iterator[Deployment]:
    """A deployment that the test starts itself."""
    with Deployment(tmp_path, embedded=embedded) as deployment:
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
