"""A planner that serves the gateway's own action on the hub, as Nav2 on rmw_zenoh does (``nav2_zenoh``)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest

from bridge.config.sections.navigation import ACTION, GOAL_POSE, THROUGH_POSES
from bridge.messages.actions import GoalState, names
from navigation.gateway.telemetry import POSE
from navigation.messages import THROUGH
from navigation.status import State
from tests.peers.navigation.gateway import ClientGoal, Rig, patient, pose
from tests.peers.zenoh.rmw_action_server import RmwActionServer
from tests.support.wait import until

PARTS = names(ACTION)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with patient(), Rig(tmp_path_factory.mktemp("hub_planner"), planner="nav2_zenoh") as started:
        yield started


@pytest.fixture
def nav2(running: Rig) -> Iterator[RmwActionServer]:
    """An rmw_zenoh node, started while the gateway waits for it."""
    hubs = running.hubs
    with contextlib.closing(RmwActionServer(hubs.endpoint, hubs.domain, "bt_navigator", ACTION)) as node:
        until(lambda: running.gateway.link.reachable, "the gateway finds the planner")
        yield node
        if running.gateway.link.reachable:  # without a planner, the stop would end the first goals of the next one
            running.ask("stop")
        until(lambda: not running.gateway.driving, "nothing drives")
    # otherwise the next test's goals would be sent to this node
    servers = running.client.node.hub.graph.servers
    until(lambda: not servers(PARTS.send_goal) and not running.gateway.link.reachable, "the planner has left")


@pytest.fixture
def rig(running: Rig, nav2: RmwActionServer) -> Rig:
    return running


def own_parts(rig: Rig) -> set[str]:
    """Return the parts of the action that the gateway serves, as another session sees them."""
    zid = rig.worker.running("gateway").host.node.hub.zid
    endpoints = rig.client.node.hub.graph.endpoints()
    return {end.topic for end in endpoints if end.zid == zid and end.kind in ("server", "publisher")} & set(PARTS)


def test_the_gateway_sends_its_goals_to_the_planner(rig: Rig, nav2: RmwActionServer) -> None:
    assert not own_parts(rig)
    goal = ClientGoal(rig.client, [pose(1.0)], THROUGH_POSES, kind=THROUGH, field="poses")
    until(lambda: len(nav2.goals) == 1, "the goal is at the planner")
    rig.state(State.MOVING)
    nav2.end(GoalState.SUCCEEDED)
    assert goal.end() == ("SUCCEEDED", "")
    assert rig.module.status().served_by == ""
    assert not list(rig.module.warnings())


def test_clients_of_the_action_reach_the_planner_and_are_stopped(rig: Rig, nav2: RmwActionServer) -> None:
    goal = ClientGoal(rig.client, pose(2.0))
    until(lambda: nav2.goals == [goal.sent.id], "the goal is at the planner")
    rig.state(State.MOVING, "its own client")
    assert rig.gateway.drive is None
    assert rig.ask("stop")["success"]
    assert goal.end()[0] == "CANCELED"


def test_a_goal_on_the_topic_is_executed_once(rig: Rig, nav2: RmwActionServer) -> None:
    """Nav2 subscribes to the topic, too."""
    out = rig.far.advertise(GOAL_POSE, "geometry_msgs/PoseStamped")

    def once() -> bool:
        rig.far.publish(out, pose(3.0))
        return bool(nav2.goals)

    until(once, "the gateway sends the goal to a planner without a subscription")
    rig.fresh()
    nav2.announce_subscription(GOAL_POSE, POSE)
    graph = rig.worker.running("gateway").host.node.hub.graph
    until(lambda: any(not end.own for end in graph.subscriptions(GOAL_POSE)), "the gateway sees the subscription")
    begun = len(nav2.goals)
    rig.far.publish(out, pose(4.0))
    later = ClientGoal(rig.client, [pose(5.0)], THROUGH_POSES, kind=THROUGH, field="poses")
    until(lambda: len(nav2.goals) > begun, "a later goal is at the planner")
    nav2.end(GoalState.SUCCEEDED)
    assert later.end()[0] == "SUCCEEDED"
    assert len(nav2.goals) == begun + 1


def test_the_gateway_serves_its_action_for_other_planners(rig: Rig, nav2: RmwActionServer) -> None:
    rig.worker.reload(rig.configured(planner="robot_goto", planners=[{"name": "far", "action": ACTION}]))
    until(lambda: rig.gateway.planner == "robot_goto", "the other planner is in use")
    until(lambda: rig.module.status().served_by == "/bt_navigator", "the gateway names the node")
    nav2.close()
    until(lambda: own_parts(rig) == set(PARTS), "the gateway serves its action")
    rig.ask("choose_planner", name="far")
    until(lambda: not own_parts(rig), "the gateway leaves the name to the chosen planner")
    until(lambda: rig.gateway.planner == "far", "the planner is in use")
    assert not rig.gateway.link.reachable
    rig.worker.reload(rig.configured(planner="nav2_zenoh", planners=[]))
    until(lambda: rig.gateway.planner == "nav2_zenoh", "the first planner is in use again")
