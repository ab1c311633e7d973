"""Nav2's lifecycle nodes, docking and waypoints from the command line, with real rclpy servers and a base."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from tests.cli.conftest import Midspan
from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation.mix_truth import PEERS, Base
from tests.peers.ros2.network import ros2_environment, ros2_python
from tests.support.process import Process
from tests.support.wait import until

SECONDS = 40.0
SERVERS = ("bt_navigator", "waypoint_follower", "docking_server")
MANAGER = "/lifecycle_manager_navigation"


class Nav2Rig:
    """The daemon with Nav2 as planner, Nav2's servers and a base."""

    def __init__(self, deployment: Deployment) -> None:
        self.deployment = deployment
        deployment.start(navigation={"planner": "nav2"}, store={"enabled": True})
        self.base = deployment.keep(Base.ros2())
        program = PEERS / "ros2" / "nav2_managed.py"
        self.nav2 = deployment.keep(Process([ros2_python(), program], ros2_environment()))
        until(lambda: "ready" in self.nav2.output(), "Nav2 is up", SECONDS)

    def inactive(self) -> dict[str, str]:
        """Return the states of the nodes that are not active, as the gateway reports them."""
        gateway = next((d for d in self.deployment.status() if d.get("worker") == "gateway"), {})
        return {name.lstrip("/"): state for name, state in gateway.get("inactive_nodes", {}).items()}

    def until_inactive(self, **states: str) -> None:
        until(lambda: self.inactive() == states, f"the states of the nodes are {states}", SECONDS, 0.2)

    def goals(self, action: str = "") -> list[dict[str, Any]]:
        """Return the goals that Nav2's servers have received."""
        rows = [line.split(" ", 2) for line in self.nav2.output().splitlines() if line.startswith("goal ")]
        return [json.loads(row[2]) for row in rows if action in ("", row[1])]


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nav2Rig]:
    with Deployment(tmp_path_factory.mktemp("nav2_servers"), embedded=True) as deployment:
        yield Nav2Rig(deployment)


@pytest.fixture
def midspan(started: Nav2Rig, capsys: pytest.CaptureFixture[str]) -> Midspan:
    return Midspan(started.deployment.file, capsys)


@pytest.fixture
def rig(started: Nav2Rig, midspan: Midspan) -> Nav2Rig:
    """The rig with active nodes, and a base that stands."""
    if started.inactive():
        assert midspan("nav", "startup").code == 0
    started.until_inactive()
    return started


def test_nodes_are_started_and_reported_without_a_drive(started: Nav2Rig, midspan: Midspan) -> None:
    started.until_inactive(**dict.fromkeys(SERVERS, "unconfigured"))
    status = midspan("nav", "status").out
    assert "bt_navigator (unconfigured)" in status
    assert "cure: midspan nav startup" in status

    startup = midspan("nav", "startup")
    assert (startup.code, startup.out) == (0, f"{MANAGER}: all its nodes are active\n"), startup
    started.until_inactive()
    assert "not active" not in midspan("nav", "status").out
    assert "active already" in midspan("nav", "startup").out

    assert midspan("nav", "deactivate").code == 0
    started.until_inactive(**dict.fromkeys(SERVERS, "inactive"))
    assert "cure: midspan nav activate" in midspan("nav", "status").out
    failed = midspan("nav", "deactivate")
    assert (failed.code, "deactivate failed" in failed.err) == (1, True), failed
    assert midspan("nav", "activate").code == 0
    assert midspan("nav", "reset").code == 0
    started.until_inactive(**dict.fromkeys(SERVERS, "unconfigured"))
    assert (started.goals(), started.base.changes()) == ([], []), "nothing drives by itself"
