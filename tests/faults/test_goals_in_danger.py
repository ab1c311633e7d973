"""A goal ends exactly once if its server, client, bridge worker or ROS master is killed meanwhile.

`benchmarks/goals_in_danger.py` repeats this many times.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.goals_in_danger import DANGERS, STATES, WAYS, Scene
from tests.peers.daemon.deployment import Deployment

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

FREE = {"client killed", "master killed"}
"""Faults that the goal may survive, so that its server decides how it ends."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    """A daemon and real programs on both sides."""
    folder: Path = tmp_path_factory.mktemp("danger")
    with Deployment(folder) as deployment:
        deployment.start()
        yield Scene(deployment)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("danger", DANGERS)
def test_a_goal_ends_exactly_once_after_a_fault(scene: Scene, danger: str, way: str) -> None:
    end = DANGERS[danger](scene, *WAYS[way])
    assert end.good, f"{end}"
    asked_again = danger == "ros2 worker killed" and way.startswith("ROS 2 client")
    assert STATES[end.status] == ("SUCCEEDED" if asked_again or danger in FREE else "ABORTED")
