"""Fixtures of the whole-daemon tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation.mix import Mix
from tests.peers.navigation.shared_mix import SharedMix
from tests.peers.ros1.network import EMBEDDED

ON_BOTH_MASTERS = {
    "test_messages_are_bridged_in_every_direction_without_the_lane", "test_parameters_are_shared_in_both_directions",
    "test_a_clean_stop_leaves_nothing_on_the_master", "test_the_goal_of_a_ros_1_client_continues_and_is_canceled",
    "test_the_goal_of_a_hub_client_continues_and_a_killed_planner_is_lost",
}  # fmt: skip
"""Tests in which the master matters; they also run on Midspan's own (`make test-embedded-master` runs all on it)."""


@pytest.hookimpl(trylast=True)  # as in tests/contract
def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run some tests on both masters."""
    if metafunc.definition.originalname in ON_BOTH_MASTERS and not EMBEDDED:
        embedded = pytest.param(True, marks=pytest.mark.thorough)
        metafunc.parametrize("embedded", [False, embedded], ids=["roscore", "embedded_master"])


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Group the tests of a file that share a mix, a daemon with planner and clients.

    pytest compares parameters by their place in ``parametrize``, not by their value, so it would not group them.
    """
    first: dict[object, int] = {}

    def place(position: int, item: pytest.Item) -> int:
        params = item.callspec.params if isinstance(item, pytest.Function) and hasattr(item, "callspec") else {}
        return first.setdefault((item.path, id(params["shared_mix"])), position) if "shared_mix" in params else position

    places = {item: place(position, item) for position, item in enumerate(items)}
    items.sort(key=places.__getitem__)


@pytest.fixture
def embedded() -> bool:
    """Return whether the deployment has Midspan's own ROS 1 master."""
    return EMBEDDED


@pytest.fixture
def deployment(tmp_path: Path, *, embedded: bool) -> Iterator[Deployment]:
    """A deployment that the test starts itself."""
    with Deployment(tmp_path, embedded=embedded) as deployment:
        yield deployment


@pytest.fixture
def running(deployment: Deployment) -> Deployment:
    """A deployment with the default rules, which both sides have joined."""
    deployment.start()
    return deployment


@pytest.fixture(scope="module")
def of_all_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployment]:
    """A running deployment that the tests of a file share."""
    with Deployment(tmp_path_factory.mktemp("shared")) as deployment:
        deployment.start()
        yield deployment


@pytest.fixture
def shared(of_all_tests: Deployment) -> Iterator[Deployment]:
    """The file's deployment. Its tests use separate topics, and programs are stopped after each test."""
    yield of_all_tests
    of_all_tests.stop_programs()


@pytest.fixture(scope="module")
def shared_mix(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedMix]:
    """The mix that tests of a file with equal options share; the options are the parameter, by default none."""
    mix = SharedMix(tmp_path_factory, **getattr(request, "param", {}))
    yield mix
    mix.close()


@pytest.fixture
def mix(shared_mix: SharedMix, request: pytest.FixtureRequest) -> Iterator[Mix]:
    """The shared mix, at rest; started by the first test that uses it."""
    failed = request.session.testsfailed
    yield shared_mix.at_rest()
    if request.session.testsfailed > failed:
        shared_mix.close()
