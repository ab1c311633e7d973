"""Nav2's lifecycle nodes, docking, waypoints and patrols, with real rclpy servers and a base."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from tests.cli.conftest import Midspan
from tests.peers.browser.page import TestPage
from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation.mix_truth import PEERS, Base
from tests.peers.ros2.network import ros2_environment, ros2_python
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

SECONDS = 40.0
SERVERS = ("bt_navigator", "waypoint_follower", "docking_server")
MANAGER = "/lifecycle_manager_navigation"


class Nav2Rig:
    """The daemon with Nav2 as planner, Nav2's servers and a base."""

    def __init__(self, deployment: Deployment) -> None:
        self.deployment = deployment
        self.web = free_port()
        web = {"enabled": True, "listen": f"127.0.0.1:{self.web}"}
        deployment.start(navigation={"planner": "nav2"}, store={"enabled": True}, web=web)
        self.base = deployment.keep(Base.ros2())
        program = PEERS / "ros2" / "nav2_managed.py"
        self.nav2 = deployment.keep(Process([ros2_python(), program], ros2_environment()))
        until(lambda: "ready" in self.nav2.output(), "Nav2 is up", SECONDS)

    def inactive(self) -> dict[str, str]:
        """Return the states of the nodes that are not active, as reported by the gateway."""
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
    until(lambda: midspan("nav", "startup").code == 0, "the lifecycle manager is on the hub", SECONDS)
    started.until_inactive()
    return started


def test_nodes_are_started_and_reported_without_a_drive(rig: Nav2Rig, midspan: Midspan) -> None:
    until(lambda: not rig.base.moves, "the base stands", SECONDS)
    before = rig.goals(), rig.base.changes()
    assert midspan("nav", "reset").out == f"{MANAGER}: all its nodes are unconfigured\n"
    rig.until_inactive(**dict.fromkeys(SERVERS, "unconfigured"))
    status = midspan("nav", "status").out
    assert "bt_navigator (unconfigured)" in status
    assert "cure: midspan nav startup" in status

    startup = midspan("nav", "startup")
    assert (startup.code, startup.out) == (0, f"{MANAGER}: all its nodes are active\n"), startup
    rig.until_inactive()
    assert "not active" not in midspan("nav", "status").out
    assert "already active" in midspan("nav", "startup").out

    assert midspan("nav", "deactivate").code == 0
    rig.until_inactive(**dict.fromkeys(SERVERS, "inactive"))
    assert "cure: midspan nav activate" in midspan("nav", "status").out
    failed = midspan("nav", "deactivate")
    assert (failed.code, "deactivate failed" in failed.err) == (1, True), failed
    assert midspan("nav", "activate").code == 0
    assert midspan("nav", "reset").code == 0
    rig.until_inactive(**dict.fromkeys(SERVERS, "unconfigured"))
    assert (rig.goals(), rig.base.changes()) == before, "nothing drives by itself"


def add(midspan: Midspan, name: str, x: float, *options: str) -> None:
    outcome = midspan("location", "add", name, str(x), "0", "90", "--map", "map", "--replace", *options)
    assert outcome.code == 0, outcome


def test_the_robot_docks_at_stored_docks_and_at_nav2s_docks(rig: Nav2Rig, midspan: Midspan) -> None:
    add(midspan, "kitchen", 1.0)
    assert "which dock? none is stored" in midspan("dock").err
    assert "the location kitchen is not a dock" in midspan("dock", "kitchen").err
    add(midspan, "charger", 5.0, "--dock", "contacts")
    before = len(rig.goals("dock_robot")), len(rig.goals("undock_robot"))
    docked = midspan("dock")
    assert (docked.code, docked.out.splitlines()) == (0, ["to the dock charger", "approaching", "docked"]), docked
    assert midspan("undock").out == "undocked\n"
    docked = midspan("dock", "home", "--type", "magnet", "--json")
    assert [line.get("status") for line in docked.lines()][-1:] == ["succeeded"], docked
    gone = midspan("dock", "gone")
    assert (gone.code, "aborted: the dock is not in the database" in gone.err) == (1, True), gone
    stored, own, _ = rig.goals("dock_robot")[before[0] :]
    assert stored == {"id": None, "type": "contacts", "x": 5.0, "frame": "map", "stages": True}
    assert (own["id"], own["type"], rig.goals("undock_robot")[before[1] :]) == ("home", "magnet", [{"type": ""}])
    until(lambda: not rig.base.moves, "the base stands", SECONDS)


def test_waypoints_that_are_missed_are_named(rig: Nav2Rig, midspan: Midspan) -> None:
    for name, x in (("a", 1.0), ("hole", -1.0), ("b", 2.0)):
        add(midspan, name, x)
    arrived = midspan("waypoints", "a", "b")
    assert (arrived.code, arrived.out.splitlines()) == (0, ["to a (1 of 2)", "to b (2 of 2)", "arrived"]), arrived
    missed = midspan("waypoints", "a", "hole", "b")
    assert (missed.code, missed.err) == (1, "midspan: succeeded: not reached: hole\n"), missed
    assert rig.goals("follow_waypoints")[-2:] == [{"x": [1.0, 2.0]}, {"x": [1.0, -1.0, 2.0]}]


@pytest.mark.parametrize("words", [("dock", "far"), ("waypoints", "far")], ids=" ".join)
def test_a_stop_ends_docking_and_waypoints(rig: Nav2Rig, midspan: Midspan, words: tuple[str, ...]) -> None:
    add(midspan, "far", 950.0, "--dock")
    program = rig.deployment.keep(rig.deployment.midspan(*words))
    # the base may receive its first velocity before the gateway receives the list with the goal
    moving = lambda: rig.base.moves and midspan("nav", "status").out.startswith("moving")  # noqa: E731
    until(moving, "the base moves, and the gateway reports it", SECONDS)
    refused = midspan("undock")
    assert (refused.code, "the robot is not idle (moving: " in refused.err) == (1, True), refused
    assert "the robot may be moving: stop it first" in midspan("nav", "reset").err
    # a stop that a busy machine does not confirm within 2.5 s fails, and continues
    until(lambda: midspan("nav", "stop").code == 0, "the stop is confirmed", SECONDS)
    assert not rig.base.moves, "the stop was confirmed"
    until(lambda: program.popen.poll() is not None, "the program has ended", SECONDS)
    assert (program.popen.returncode, "midspan: canceled" in program.output()) == (1, True), program.output()
    until(lambda: midspan("nav", "status").out.startswith("idle"), "the gateway reports the end", SECONDS)
    assert midspan("location", "remove", "far").code == 0


def test_a_patrol_passes_its_places_without_stops_until_it_is_stopped(rig: Nav2Rig, midspan: Midspan) -> None:
    for name, x in (("a", 1.0), ("b", 2.0), ("far", 950.0)):
        add(midspan, name, x)
    with TestPage(rig.web) as page:
        page.watch("patrol", "driving")
        page.value("driving", lambda value: value and value["state"] in ("idle", "goal_reached"))
        before = len(rig.goals("navigate_through_poses"))
        assert page.call("patrol", places=["a", "b"], wait=0)["ok"]
        page.value("patrol", lambda value: value["state"] == "drives" and value["round"] >= 2)
        assert rig.goals("navigate_through_poses")[before] == {"x": [1.0, 2.0] * 10}
        until(lambda: rig.base.moves, "the base moves", SECONDS)
        until(lambda: page.call("stop")["ok"], "the stop is confirmed", SECONDS)
        assert not rig.base.moves, "the stop was confirmed"
        assert "stopped" in page.value("patrol", lambda value: value["state"] == "ended")["why"]
        assert page.call("patrol", places=["a", "far"], wait=0)["ok"]
        page.value("patrol", lambda value: (value["round"], value["at"]) == (1, 1))
        until(lambda: page.call("stop")["ok"], "the stop is confirmed", SECONDS)
        assert not rig.base.moves
        assert [goal for goal in rig.goals("navigate_through_poses") if 950.0 in goal["x"]] == [
            {"x": [1.0, 950.0] * 10}
        ]
    assert midspan("location", "remove", "far").code == 0
