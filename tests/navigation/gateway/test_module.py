"""The gateway with planners on the hub: the results that clients receive, and the goals that planners receive."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.stores.kinds import AREA, LOCATION, MAP
from navigation.gateway import choice, execution
from navigation.status import Fault, State
from tests.peers.navigation.gateway import ClientGoal, Rig, patient, pose
from tests.support.faults import FaultProxy
from tests.support.wait import until
from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.vec2d import Vec2D

MINE = {"name": "mine", "side": "zenoh", "action": "/planner/mine/navigate_to_pose"}


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with patient(), Rig(tmp_path_factory.mktemp("gateway"), planners=[MINE]) as started:
        yield started


@pytest.fixture
def rig(running: Rig) -> Rig:
    running.fresh()
    return running


def target(goal: Any) -> tuple[str, float, float]:
    """Return the frame and position of a planner's goal."""
    place = goal.goal["pose"]["pose"]["position"]
    return goal.goal["pose"]["header"]["frame_id"], place["x"], place["y"]


def test_a_goal_and_its_feedback_and_its_end_are_passed_on(rig: Rig) -> None:
    client_goal = ClientGoal(rig.client, pose(3.0, 1.0, frame="/map"))
    goal = rig.planner.until(1)
    assert target(goal) == ("map", 3.0, 1.0)
    assert rig.state(State.MOVING)["goal_id"].tobytes() == client_goal.sent.id
    rig.planner.publish_status(goal, State.WAITING, "a chair", 20008)
    assert rig.state(State.WAITING, "a chair")["error_code"] == 20008
    rig.planner.on(lambda: goal.feedback({"distance_remaining": 2.5, "current_pose": pose(0.5)}))
    until(lambda: client_goal.feedback, "the feedback arrived", 20)
    assert client_goal.feedback[0]["distance_remaining"] == 2.5
    assert client_goal.feedback[0]["current_pose"]["pose"]["position"]["x"] == 0.5
    rig.planner.reach(goal)
    assert client_goal.end() == ("SUCCEEDED", "")
    rig.state(State.REACHED)


def test_an_abort_comes_with_its_reason(rig: Rig) -> None:
    client_goal = ClientGoal(rig.client, pose(3.0))
    rig.planner.give_up(rig.planner.until(1), "no path to the goal", 20006)
    assert client_goal.end() == ("ABORTED", "no path to the goal")
    assert client_goal.result is not None
    assert client_goal.result["error_code"] == 20006
    assert rig.state(State.ABORTED, "no path to the goal")["error_code"] == 20006


def test_a_reachable_planner_ends_a_goal_with_a_reason_without_a_code(rig: Rig) -> None:
    """Neither move_base nor a bridge that has lost its planner gives a code; but a lost planner is unreachable."""
    client_goal = ClientGoal(rig.client, pose(3.0))
    rig.planner.give_up(rig.planner.until(1), "Failed to find a valid plan.", 0)
    assert client_goal.end() == ("ABORTED", "Failed to find a valid plan.")
    rig.state(State.ABORTED, "Failed to find a valid plan.")


def test_an_invalid_goal_is_aborted_with_a_reason(rig: Rig) -> None:
    bad = {
        "frame is empty": pose(1.0, frame=""),
        "is not finite": pose(math.nan),
        "is not a rotation": {**pose(1.0), "pose": {"orientation": {"w": 0.0}}},
    }
    for reason, message in bad.items():
        status, text = ClientGoal(rig.client, message).end()
        assert status == "ABORTED"
        assert reason in text
    assert not rig.planner.goals


def test_a_cancellation_is_reported_when_the_planner_has_released_the_goal(rig: Rig) -> None:
    client_goal = ClientGoal(rig.client, pose(3.0))
    goal = rig.planner.until(1)
    client_goal.cancel()
    assert client_goal.end()[0] == "CANCELED"
    assert goal.status.name == "CANCELED"
    rig.state(State.IDLE)


def test_another_clients_goal_replaces_the_first_and_the_first_client_is_informed(rig: Rig) -> None:
    first = ClientGoal(rig.client, pose(1.0))
    rig.planner.until(1)
    second = ClientGoal(rig.client, pose(2.0))
    status, reason = first.end()
    assert status == "CANCELED"
    assert "replaced it" in reason
    goal = rig.planner.until(2)
    assert target(goal)[1] == 2.0
    rig.planner.reach(goal)
    assert second.end() == ("SUCCEEDED", "")


@pytest.mark.parametrize("rejects", [True, False], ids=["rejected", "aborted"])
def test_the_replaced_goal_is_canceled_if_the_planner_does_not_execute_the_new_one(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, *, rejects: bool
) -> None:
    monkeypatch.setattr(execution, "REPLACED_SECONDS", 1000.0)
    rig.gateway.link.presence.unreachable_at = 0.0
    ClientGoal(rig.client, pose(3.0))
    first = rig.planner.until(1)
    rig.state(State.MOVING)

    def refuse(goal: Any) -> bool:
        if not rejects:
            goal.abort({"error_code": 20004, "error_msg": "a wall"})
        return not rejects

    monkeypatch.setattr(rig.planner, "admits", refuse)
    assert ClientGoal(rig.client, pose(500.0)).end()[0] == "ABORTED"
    until(lambda: not first.active, "the planner no longer drives to the first goal", 20)
    rig.state(State.ABORTED)


def test_the_earlier_goal_is_canceled_if_the_planner_rejects_the_goal_that_a_client_has_sent_again(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(execution, "REPLACED_SECONDS", 1000.0)
    rig.gateway.link.presence.unreachable_at = 0.0
    client_goal = ClientGoal(rig.client, pose(3.0))
    first = rig.planner.until(1)
    rig.state(State.MOVING)
    monkeypatch.setattr(rig.planner, "admits", lambda _goal: False)
    rig.worker.running("gateway").host.loop.call(rig.gateway.execution.recompute)
    assert client_goal.end()[0] == "ABORTED"
    until(lambda: not first.active, "the planner no longer drives to the first goal", 20)


def test_a_paused_goal_stays_active_and_continues_with_a_new_id(rig: Rig) -> None:
    client_goal = ClientGoal(rig.client, {**pose(4.0), "header": {"frame_id": "map", "stamp": {"sec": 77}}})
    first = rig.planner.until(1)
    assert rig.ask("pause")["success"]
    rig.state(State.PAUSED)
    until(lambda: not first.active, "the planner stopped", 20)
    assert not client_goal.ended
    assert rig.ask("resume")["success"]
    second = rig.planner.until(2)
    assert second.id != first.id
    assert target(second) == target(first)
    assert second.goal["pose"]["header"]["stamp"] == {"sec": 0, "nanosec": 0}
    rig.state(State.MOVING)
    rig.planner.reach(second)
    assert client_goal.end() == ("SUCCEEDED", "")
    for name in ("pause", "resume"):
        assert not rig.ask(name)["success"]


def test_a_paused_goal_can_be_canceled(rig: Rig) -> None:
    client_goal = ClientGoal(rig.client, pose(4.0))
    rig.planner.until(1)
    rig.ask("pause")
    rig.state(State.PAUSED)
    client_goal.cancel()
    assert client_goal.end()[0] == "CANCELED"
    rig.state(State.IDLE)
    assert not rig.ask("resume")["success"]


def test_a_goal_waits_for_a_killed_planner_and_continues(rig: Rig) -> None:
    client_goal = ClientGoal(rig.client, pose(5.0))
    rig.planner.until(1)
    rig.planners.pop("robot_goto").close()
    rig.state(State.MOVING, "robot_goto is not available; waiting for it")
    rig.planner = rig.have("robot_goto")
    goal = rig.planner.until(1)
    assert target(goal)[1] == 5.0
    rig.planner.reach(goal)
    assert client_goal.end() == ("SUCCEEDED", "")


def test_a_goal_before_the_planner_is_reachable_is_prepared_and_then_sent(rig: Rig) -> None:
    rig.planners.pop("robot_goto").close()
    try:
        until(lambda: not rig.gateway.link.reachable, "the planner is unreachable", 20)
        first = ClientGoal(rig.client, pose(5.0))
        rig.state(State.PREPARING, "robot_goto is not available; waiting for it")
        first.cancel()
        assert first.end()[0] == "CANCELED"
        client_goal = ClientGoal(rig.client, pose(6.0))
        rig.state(State.PREPARING, "robot_goto is not available; waiting for it")
    finally:
        rig.planner = rig.have("robot_goto")
    assert target(rig.planner.until(1)) == ("map", 6.0, 0.0), "not the canceled goal"
    rig.planner.reach(rig.planner.until(1))
    assert client_goal.end() == ("SUCCEEDED", "")


def test_a_planner_that_stays_unreachable_ends_the_goal_with_the_reason(rig: Rig) -> None:
    rig.worker.reload(rig.configured(patience=0.3))
    client_goal = ClientGoal(rig.client, pose(5.0))
    rig.planner.until(1)
    rig.planners.pop("robot_goto").close()
    try:
        assert client_goal.end() == ("ABORTED", "the planner robot_goto was not available for 0.3 s")
        end, reason = ClientGoal(rig.client, pose(6.0)).end()
        assert end == "ABORTED"
        assert "send the goal again when it is" in reason
    finally:
        rig.worker.reload(rig.configured(patience=60.0))
        rig.planner = rig.have("robot_goto")


def test_a_rejection_ends_the_goal_if_the_planner_has_been_reachable_for_a_while(rig: Rig) -> None:
    rig.planner.rejects = 1
    rig.gateway.link.presence.unreachable_at = math.inf  # as if it had just appeared, unknown to its own bridge
    client_goal = ClientGoal(rig.client, pose(1.0))
    rig.planner.reach(rig.planner.until(1))
    assert client_goal.end() == ("SUCCEEDED", "")
    rig.planner.rejects = 1
    rig.gateway.link.presence.unreachable_at = 0.0
    assert ClientGoal(rig.client, pose(1.0)).end() == ("ABORTED", "robot_goto rejected the goal")


def test_a_planner_that_continues_behind_a_cut_link_is_stopped_when_the_link_is_back(rig: Rig) -> None:
    rig.planners.pop("robot_goto").close()
    until(lambda: not rig.gateway.link.reachable, "the first planner has left", 20)
    with FaultProxy(rig.hubs.port) as link:
        far = {"router": f"tcp/127.0.0.1:{link.port}", "zenoh": {"mode": "client"}, "shared_memory": False}
        planner = rig.have("robot_goto", rig.hubs.settings("robot_goto", **far))
        try:
            # the planner is back in time: the client's goal continues
            client_goal = ClientGoal(rig.client, pose(5.0))
            planner.until(1)
            link.freeze()
            rig.state(State.MOVING, "robot_goto is not available; waiting for it")
            link.thaw()
            link.cut()
            rig.state(State.MOVING, "")
            until(lambda: rig.statuses[-1]["reason"] == "", "the planner still has the goal", 30)
            assert len(planner.goals) == 1, "the goal is not sent again"
            planner.reach(planner.goals[0])
            assert client_goal.end() == ("SUCCEEDED", "")
            # the planner is back too late: the goal is aborted, and the planner is stopped when the link is back
            rig.worker.reload(rig.configured(patience=0.3))
            client_goal = ClientGoal(rig.client, pose(6.0))
            goal = planner.until(2)
            link.freeze()
            assert client_goal.end() == ("ABORTED", "the planner robot_goto was not available for 0.3 s")
            assert goal.active
            link.thaw()
            link.cut()
            until(lambda: not goal.active, "the planner was stopped", 30)
            assert goal.status.name == "CANCELED"
        finally:
            rig.worker.reload(rig.configured(patience=60.0))
            rig.planners.pop("robot_goto").close()
            rig.planner = rig.have("robot_goto")


def test_goals_of_the_planners_own_clients_are_reported_and_can_be_stopped(rig: Rig) -> None:
    direct = ClientGoal(rig.client, pose(1.0), "/planner/robot_goto/navigate_to_pose")
    goal = rig.planner.until(1)
    rig.state(State.MOVING, "its own client")
    assert "can be stopped, but not paused" in rig.ask("pause")["message"]
    assert "is driving" in rig.ask("choose_planner", name="mine")["message"]
    rig.planner.reach(goal)
    assert direct.end()[0] == "SUCCEEDED"
    rig.state(State.REACHED, "its own client")
    direct = ClientGoal(rig.client, pose(1.0), "/planner/robot_goto/navigate_to_pose")
    rig.planner.until(2)
    rig.state(State.MOVING, "its own client")
    assert rig.ask("stop")["success"]
    assert direct.end()[0] == "CANCELED"
    rig.state(State.IDLE)


def test_a_planner_that_exits_with_a_goal_of_its_own_client_is_not_a_success(rig: Rig) -> None:
    client_goal = ClientGoal(rig.client, pose(1.0))
    rig.planner.reach(rig.planner.until(1))
    assert client_goal.end()[0] == "SUCCEEDED"
    ClientGoal(rig.client, pose(2.0), "/planner/robot_goto/navigate_to_pose")
    rig.state(State.MOVING, "its own client")
    rig.planners.pop("robot_goto").close()
    status = rig.state(State.MOVING, "the planner robot_goto is not available; the robot may still be moving")
    assert status["error_code"] == Fault.MAY_MOVE
    rig.planner = rig.have("robot_goto")  # a new process, which has none of the goals
    rig.state(State.ABORTED, "robot_goto has disappeared")
    until(lambda: not rig.gateway.driving, "nothing drives", 20)
    assert rig.ask("choose_planner", name="mine")["success"]
    assert rig.ask("choose_planner", name="robot_goto")["success"]
    until(lambda: rig.gateway.link.reachable, "the planner is found", 20)


def test_a_goal_of_the_planners_own_client_cancels_our_clients_goal(rig: Rig) -> None:
    client_goal = ClientGoal(rig.client, pose(1.0))
    rig.planner.until(1)
    ClientGoal(rig.client, pose(2.0), "/planner/robot_goto/navigate_to_pose")
    assert client_goal.end() == ("CANCELED", "another goal replaced it")
    rig.state(State.MOVING, "its own client")


def test_the_planner_is_changed_at_rest_and_not_during_a_drive(rig: Rig) -> None:
    mine = rig.have("mine")
    client_goal = ClientGoal(rig.client, pose(1.0))
    goal = rig.planner.until(1)
    assert "robot_goto is driving" in rig.ask("choose_planner", name="mine")["message"]
    assert "unknown planner 'yours'" in rig.ask("choose_planner", name="yours")["message"]
    rig.worker.reload(rig.configured(planner="mine"))
    assert rig.gateway.pending == "mine"
    rig.planner.reach(goal)
    assert client_goal.end()[0] == "SUCCEEDED"
    until(lambda: rig.gateway.planner == "mine" and rig.gateway.link.reachable, "the planner mine is in use", 20)
    client_goal = ClientGoal(rig.client, pose(2.0), tree="midspan: through=true")
    goal = mine.until(1)
    assert goal.goal["behavior_tree"] == ""  # Midspan's options are only for its own planners
    mine.reach(goal)
    assert client_goal.end()[0] == "SUCCEEDED"
    assert rig.ask("choose_planner", name="robot_goto")["success"]
    rig.worker.reload(rig.configured(patience=61.0))
    assert (rig.gateway.planner, rig.gateway.pending) == ("robot_goto", ""), "the configured planner is unchanged"
    rig.worker.reload(rig.configured(patience=60.0, planner="robot_goto"))
    until(
        lambda: rig.gateway.planner == "robot_goto" and rig.gateway.link.reachable,
        "the first planner is in use again",
        20,
    )
    assert rig.ask("choose_planner", name="mine")["success"]
    rig.worker.reload(rig.configured(planner="robot_path_planner"))
    assert rig.gateway.planner == "robot_path_planner", "the configured planner has changed"
    rig.worker.reload(rig.configured(planner="robot_goto"))
    until(
        lambda: rig.gateway.planner == "robot_goto" and rig.gateway.link.reachable,
        "the first planner is in use again",
        20,
    )


def test_another_planner_waits_for_the_release_of_a_goal(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "GIVE_UP_SECONDS", 0.1)
    monkeypatch.setattr(rig.planner, "cancels", lambda _goal: True)  # accepts a cancel request, but continues
    for releases in (True, False):
        client_goal = ClientGoal(rig.client, pose(1.0))
        goal = rig.planner.until(1 if releases else 2)
        until(lambda: rig.gateway.link.goals, "the gateway has the list with the goal", 20)
        client_goal.cancel()
        assert "robot_goto has not released its goal" in client_goal.end()[1]
        rig.worker.reload(rig.configured(planner="mine"))
        loop = rig.worker.running("gateway").host.loop
        loop.call(rig.gateway.poll)
        assert (rig.gateway.planner, rig.gateway.pending) == ("robot_goto", "mine")
        if releases:
            rig.planner.on(goal.canceled)
        else:
            monkeypatch.setattr(choice, "RELEASE_SECONDS", 0.0)
        until(lambda: rig.gateway.planner == "mine", "the other planner is in use", 20)
        rig.worker.reload(rig.configured(planner="robot_goto"))
        until(
            lambda: rig.gateway.planner == "robot_goto" and rig.gateway.link.reachable,
            "the first planner is in use again",
            20,
        )
    rig.planner.on(goal.canceled)


def test_places_are_returned_by_name_and_a_published_goal_is_sent(rig: Rig) -> None:
    store = rig.worker.store
    store.put(MAP, "house", MapGrid2D.of([[0] * 4] * 4, name="house"))
    store.use_map("house")
    store.put(LOCATION, "kitchen", Map2DLocation("house", 2.0, 3.0, 90.0))
    store.put(LOCATION, "cellar", Map2DLocation("below", 2.0, 3.0, 90.0))
    corners = [Vec2D(0.0, 0.0), Vec2D(2.0, 0.0), Vec2D(2.0, 2.0), Vec2D(0.0, 2.0)]
    store.put(AREA, "hall", Map2DArea("house", corners))
    location = rig.ask("get_location", name="kitchen")
    assert location["success"]
    assert location["pose"]["pose"]["orientation"]["z"] == pytest.approx(math.sin(math.pi / 4))
    assert rig.ask("go_to", name="kitchen")["success"]
    assert target(rig.planner.until(1)) == ("map", 2.0, 3.0)
    rig.ask("go_to", name="hall")
    goal = rig.planner.until(2)
    assert target(goal) == ("map", 1.0, 1.0)
    assert goal.goal["behavior_tree"] == "midspan: heading=false"
    assert "on map 'below', which is not stored" in rig.ask("go_to", name="cellar")["message"]
    store.put(MAP, "below", MapGrid2D.of([[0] * 4] * 4, name="below"))
    assert "on the map below" in rig.ask("go_to", name="cellar")["message"]
    assert rig.ask("get_location", name="cellar")["pose"]["header"]["frame_id"] == "below"
    missing = rig.ask("go_to", name="attic")
    assert not missing["success"]
    assert "kitchen" in missing["message"]
    out = rig.far.advertise("/goal_pose", "geometry_msgs/PoseStamped")

    def once() -> bool:
        rig.far.publish(out, pose(7.0))
        return target(rig.planner.goals[-1])[1] == 7.0

    until(once, "the planner has the published goal", 20)
