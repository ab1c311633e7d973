"""Actions of the ros2dds dialect, in the plugin's five parts."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from bridge.messages.actions import GoalState
from tests.adapters.zenoh.conftest import Place, until_linked
from tests.peers.zenoh.actions import ACTION, CANCELED, SUCCEEDED, ActionClient, ActionServer
from tests.support.wait import until

SIDE = "zenoh_ros2dds"
ID = {"goal_id": {"uuid": list(range(16))}}


class Sent:
    """A goal of the hub's node, and the goal's result."""

    def __init__(self, place: Place) -> None:
        self.place = place
        self.feedback: list[Any] = []
        self.ends: list[tuple[Any, ...]] = []
        client = place.node.action_client("/lookup", ACTION)
        until(lambda: client.ready, "the action is on the hub", 30)
        self.goal = place.on_node(
            lambda: client.send({"target_frame": "map"}, lambda *end: self.ends.append(end), self.feedback.append)
        )

    def ended(self) -> tuple[GoalState, Any]:
        goal, result, _reason = until(lambda: self.ends, "the goal ends", 30)[0]
        assert len(self.ends) == 1
        return goal.status, result


def test_goals_of_the_hub_reach_a_server_behind_a_bridge(place: Place) -> None:
    bridge = place.ros2dds()
    server = ActionServer(bridge, "/lookup")
    place.bridge({"dialect": "ros2dds"})
    until_linked(bridge)
    sent = Sent(place)
    token = until(lambda: bridge.tokens("/lookup", "AC"), "Midspan's token arrives")[0]
    assert token == f"@/{token.split('/')[1]}/@ros2_lv/AC/lookup/tf2_msgs§action§LookupTransform"
    goal = server.goal()
    assert (goal["goal_id"]["uuid"], goal["goal"]["target_frame"]) == (list(sent.goal.id), "map")
    until(lambda: (server.report(2), sent.feedback)[1], "feedback arrives", every=0.1)
    assert not sent.ends
    server.get_result.requests()
    server.end(SUCCEEDED, "laser")
    status, result = sent.ended()
    assert (status, result["transform"]["child_frame_id"]) == (GoalState.SUCCEEDED, "laser")
    names = {row["topic"].rpartition("/")[2]: row["kind"] for row in place.answer(SIDE)["routes"]}
    assert names == {
        "send_goal": "service", "cancel_goal": "service", "get_result": "service", "feedback": "topic",
        "status": "topic",
    }  # fmt: skip
    # no part has a separate token
    assert not [t for t in bridge.all_tokens() if "_action" in t]


def test_a_goal_is_canceled_at_a_server_behind_a_bridge(place: Place) -> None:
    bridge = place.ros2dds()
    server = ActionServer(bridge, "/lookup")
    place.bridge({"dialect": "ros2dds"})
    until_linked(bridge)
    sent = Sent(place)
    goal_info = {"goal_id": server.goal()["goal_id"]}
    server.cancel_goal.reply = {"goals_canceling": [goal_info]}
    server.get_result.requests()
    place.on_node(sent.goal.cancel)
    assert server.cancel_goal.requests()[0]["goal_info"]["goal_id"] == goal_info["goal_id"]
    server.end(CANCELED, "")
    assert sent.ended()[0] is GoalState.CANCELED


@pytest.mark.parametrize("end", ["its node", "its bridge"])
def test_a_server_that_leaves_ends_its_goals(place: Place, end: str, caplog: pytest.LogCaptureFixture) -> None:
    """The plugin keeps the queries of a node that has left. The bridge and the hub both report that, in any order."""
    caplog.set_level(logging.INFO, "bridge.routing")
    bridge = place.ros2dds()
    server = ActionServer(bridge, "/lookup")
    place.bridge({"dialect": "ros2dds"})
    until_linked(bridge)
    sent = Sent(place)
    assert server.get_result.requests(), "the goal has arrived"
    server.close()
    if end == "its bridge":
        bridge.stop()
    state, _ = sent.ended()
    assert state is GoalState.ABORTED
    assert sent.ends[0][2].startswith("the server of /lookup/_action/get_result left before it answered")
    assert "in /lookup/_action/get_result: " in caplog.text
    assert "suspended or is on standby" not in caplog.text


def test_goals_of_a_client_behind_a_bridge_reach_a_server_of_the_hub(place: Place) -> None:
    bridge = place.ros2dds()
    place.bridge({"dialect": "ros2dds"})
    goals: list[Any] = []

    def on_goal(goal: Any) -> bool:
        goals.append(goal)
        return bool(goal.goal["target_frame"] != "no")

    place.node.action_server("/lookup", ACTION, on_goal, lambda _goal: True)
    token = until(lambda: bridge.tokens("/lookup", "AS"), "Midspan's token arrives", 30)[0]
    assert token == f"@/{token.split('/')[1]}/@ros2_lv/AS/lookup/tf2_msgs§action§LookupTransform"
    client = ActionClient(bridge, "/lookup")
    for part in ("send_goal", "cancel_goal", "get_result"):
        place.until_route(SIDE, f"/lookup/_action/{part}", "out")

    def answered(part: str, request: dict[str, Any]) -> Any:
        return until(lambda: client.ask(part, request).result()["reply"], f"a reply of {part}")

    assert not answered("send_goal", {"goal": {"target_frame": "no"}, "goal_id": {"uuid": [1] * 16}})["accepted"]
    assert answered("send_goal", {**ID, "goal": {"target_frame": "map"}})["accepted"]
    goal = goals[-1]
    place.on_node(goal.execute)
    until(lambda: (place.on_node(lambda: goal.feedback({})), client.feedback)[1], "feedback arrives", every=0.1)
    assert client.feedback[0]["goal_id"] == ID["goal_id"]
    result = client.ask("get_result", ID)
    canceled = answered("cancel_goal", {"goal_info": ID})
    assert [info["goal_id"] for info in canceled["goals_canceling"]] == [ID["goal_id"]]
    assert not result.ended.wait(0.2)
    place.on_node(lambda: goal.canceled({"transform": {"child_frame_id": "half way"}}))
    reply = result.result()["reply"]
    assert (reply["status"], reply["result"]["transform"]["child_frame_id"]) == (CANCELED, "half way")
    until(
        lambda: client.statuses and client.statuses[-1]["status_list"][-1]["status"] == CANCELED, "the status arrives"
    )
    client.close()
    late = ActionClient(bridge, "/lookup")
    until(lambda: late.statuses and late.statuses[-1]["status_list"][-1]["status"] == CANCELED, "the status is cached")
    late.close()


def test_a_server_of_the_hub_that_leaves(place: Place) -> None:
    """DDS clients receive no errors, so the goal's state is unknown."""
    bridge = place.ros2dds()
    place.bridge({"dialect": "ros2dds"})
    place.node.action_server("/lookup", ACTION, lambda _goal: True)
    client = ActionClient(bridge, "/lookup")
    until(lambda: bridge.tokens("/lookup", "AS"), "Midspan's token arrives", 30)
    for part in ("send_goal", "get_result"):
        place.until_route(SIDE, f"/lookup/_action/{part}", "out")
    until(lambda: client.ask("send_goal", ID).result()["reply"], "the goal is accepted")
    result = client.ask("get_result", ID)
    until(
        lambda: place.route(SIDE, "/lookup/_action/get_result", "out")["pending"] == 1,
        "the result call is pending",
        every=0.1,
    )
    place.close_node()
    assert result.result(30)["reply"]["status"] == GoalState.UNKNOWN
    until(lambda: not bridge.tokens("/lookup", "AS"), "Midspan's token is withdrawn")
    client.close()
