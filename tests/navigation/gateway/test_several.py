"""Goals of several poses: sent as one goal to a planner with NavigateThroughPoses, otherwise one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from bridge.config.sections.navigation import THROUGH_POSES
from navigation.gateway import drive
from navigation.messages import THROUGH
from navigation.status import State
from tests.peers.navigation.gateway import SECONDS, ClientGoal, Planner, Rig, patient, pose
from tests.support.wait import until
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.inavigation2d import INavigation2DMsgs
from yarp_compat.dev.locations import Map2DLocation, Map2DPath

SOME = [pose(1.0), pose(2.0), pose(3.0)]
PASSING = {"name": "passing"}


class PassingPlanner(Planner):
    """A planner with both actions, which rejects a goal while a goal of the other action is active, as Nav2 does."""

    def __init__(self, settings: Any, name: str) -> None:
        self.rejected = 0
        super().__init__(settings, name)
        action = f"/planner/{name}/navigate_through_poses"
        self.several = self.on(
            lambda: self.node.action_server(action, THROUGH, self._accept, lambda goal: self.cancels(goal))
        )

    def _accept(self, goal: Any) -> bool:
        if any(("poses" in other.goal) != ("poses" in goal.goal) for other in self.goals if other.active):
            self.rejected += 1
            return False
        return super()._accept(goal)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with patient(), Rig(tmp_path_factory.mktemp("several"), planners=[PASSING]) as started:
        started.planners["passing"] = PassingPlanner(started.hubs.settings("passing"), "passing")
        yield started


@pytest.fixture
def rig(running: Rig) -> Rig:
    running.fresh()
    return running


@pytest.fixture
def passing(rig: Rig) -> Iterator[PassingPlanner]:
    until(lambda: rig.ask("choose_planner", name="passing")["success"], "the planner is chosen", SECONDS)
    until(lambda: rig.gateway.planner == "passing" and rig.gateway.link.passes, "the planner is reachable", SECONDS)
    yield rig.planners["passing"]
    rig.fresh()
    until(lambda: rig.ask("choose_planner", name="robot_goto")["success"], "the planner is chosen", SECONDS)


def send(rig: Rig, poses: list[Any] = SOME) -> ClientGoal:
    return ClientGoal(rig.client, poses, THROUGH_POSES, kind=THROUGH, field="poses")


def xs(goal: Any) -> list[float]:
    poses = goal.goal["poses"] if "poses" in goal.goal else [goal.goal["pose"]]
    return [place["pose"]["position"]["x"] for place in poses]


def test_a_planner_without_the_action_gets_one_pose_after_the_other(rig: Rig) -> None:
    client_goal = send(rig)
    for number in (1, 2, 3):
        goal = rig.planner.until(number)
        assert xs(goal) == [number]
        rig.planner.on(lambda goal=goal: goal.feedback({"distance_remaining": 1.0}))
        left = 4 - number
        until(
            lambda left=left: [f for f in client_goal.feedback if f["number_of_poses_remaining"] == left],
            f"the client knows that {left} are left",
            SECONDS,
        )
        rig.planner.reach(goal)
    assert client_goal.end() == ("SUCCEEDED", "")


def test_a_goal_without_poses_is_aborted_with_its_reason(rig: Rig) -> None:
    status, reason = send(rig, []).end()
    assert (status, "the goal has 0 poses" in reason) == ("ABORTED", True)


def test_a_planner_with_the_action_gets_all_poses_in_one_goal(rig: Rig, passing: PassingPlanner) -> None:
    client_goal = send(rig)
    goal = passing.until(1)
    assert xs(goal) == [1.0, 2.0, 3.0]
    assert rig.state(State.MOVING)["goal"]["pose"]["position"]["x"] == 1.0
    passing.on(lambda: goal.feedback({"distance_remaining": 1.5, "number_of_poses_remaining": 2}))
    until(lambda: client_goal.feedback, "the feedback arrives", SECONDS)
    assert client_goal.feedback[-1]["number_of_poses_remaining"] == 2
    until(lambda: rig.statuses[-1]["goal"]["pose"]["position"]["x"] == 2.0, "the status has the next pose", SECONDS)

    assert rig.ask("pause")["success"]
    rig.state(State.PAUSED)
    assert rig.ask("resume")["success"]
    goal = passing.until(2)
    assert xs(goal) == [2.0, 3.0], "the pose that was passed is not sent again"
    passing.reach(goal)
    assert client_goal.end() == ("SUCCEEDED", "")


def test_the_last_pose_of_a_goal_of_several_poses_is_sent_again_to_the_same_action(
    rig: Rig, passing: PassingPlanner
) -> None:
    client_goal = send(rig)
    goal = passing.until(1)
    passing.on(lambda: goal.feedback({"number_of_poses_remaining": 1}))
    until(lambda: len(rig.gateway.drive.left) == 1, "one pose is left", SECONDS)
    rig.worker.running("gateway").host.loop.call(rig.gateway.execution.recompute)
    goal = passing.until(2)
    assert xs(goal) == [3.0]
    passing.reach(goal)
    assert client_goal.end() == ("SUCCEEDED", "")


def test_a_stop_ends_the_planners_goal_of_several_poses(rig: Rig, passing: PassingPlanner) -> None:
    client_goal = send(rig)
    goal = passing.until(1)
    assert rig.ask("stop")["success"]
    assert not goal.active
    assert client_goal.end()[0] == "CANCELED"


def test_a_goal_of_the_other_action_is_sent_when_the_previous_goal_has_ended(rig: Rig, passing: PassingPlanner) -> None:
    first = send(rig)
    passing.until(1)
    second = ClientGoal(rig.client, pose(9.0))
    assert first.end()[0] == "CANCELED"
    assert xs(passing.until(2)) == [9.0]
    listed = lambda: rig.gateway.drive.sent and rig.gateway.link.lists(rig.gateway.drive.sent)  # noqa: E731
    until(listed, "the gateway has the list with the goal", SECONDS)
    third = send(rig)
    assert second.end()[0] == "CANCELED"
    passing.reach(passing.until(3))
    assert third.end() == ("SUCCEEDED", "")
    assert passing.rejected == 0


def test_a_goal_of_the_other_action_waits_for_a_goal_that_is_not_in_the_list_yet(
    rig: Rig, passing: PassingPlanner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drive, "LIST_SECONDS", 60.0)
    monkeypatch.setattr(passing.server, "publish_status", lambda: None)
    first = ClientGoal(rig.client, pose(9.0))
    passing.until(1)
    second = send(rig)
    assert first.end()[0] == "CANCELED"
    passing.reach(passing.until(2))
    assert second.end() == ("SUCCEEDED", "")
    assert passing.rejected == 0


def test_followpath_of_yarp_drives_without_stops(rig: Rig, passing: PassingPlanner) -> None:
    with ServiceClient(INavigation2DMsgs, "/navigationServer/rpc", naming=rig.names, timeout=SECONDS) as client:
        path = Map2DPath([Map2DLocation("map", x, 0.0, 0.0) for x in (1.0, 2.0)])
        assert client.remote.follow_path_RPC(path)
    goal = passing.until(1)
    assert xs(goal) == [1.0, 2.0]
    passing.reach(goal)
    rig.state(State.REACHED)
