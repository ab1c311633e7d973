"""The gateway withdraws its action while another node serves the same name: only one node executes a goal."""

from __future__ import annotations

import contextlib
import io
import logging
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from bridge.cli.inspection.status import show
from bridge.config.sections.navigation import ACTION
from bridge.doctor.check import Result
from bridge.doctor.checks.daemon import check_workers
from bridge.messages.actions import GoalState, names
from bridge.modules.action_server import Goal
from bridge.modules.worker import ModulesWorker
from bridge.status import read_status
from navigation.gateway.entry import STOP_SERVICE, NavigateAction
from navigation.status import State
from tests.doctor.parts import around, every, hub
from tests.peers.hub.endpoints import endpoint
from tests.peers.navigation.gateway import ClientGoal, Rig, pose
from tests.peers.zenoh.rmw_action_server import RmwActionServer
from tests.support.wait import until

NODE = "/bt_navigator"
PARTS = names(ACTION)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with Rig(tmp_path_factory.mktemp("entry")) as started:
        yield started


@pytest.fixture
def rig(running: Rig) -> Iterator[Rig]:
    until(lambda: parts(running) == set(PARTS), "the gateway serves its action")
    yield running
    for planner in running.planners.values():
        for goal in planner.goals:
            planner.on(goal.canceled)
    until(lambda: not running.gateway.driving, "nothing drives")
    running.planner.goals.clear()


def nav2(rig: Rig) -> RmwActionServer:
    """Start an rmw_zenoh node that serves the gateway's name."""
    return RmwActionServer(rig.hubs.endpoint, rig.hubs.domain, NODE[1:], ACTION)


@pytest.fixture
def other(rig: Rig) -> Iterator[RmwActionServer]:
    """An rmw_zenoh node that serves the gateway's name, started while the gateway runs."""
    with contextlib.closing(nav2(rig)) as started:
        until(lambda: rig.module.status().served_by == NODE, "the gateway finds the node")
        yield started


def parts(rig: Rig, worker: ModulesWorker | None = None) -> set[str]:
    """Return the parts of the action that a gateway serves, as another session sees them."""
    return parts_of(rig, (worker or rig.worker).running("gateway").host.node.hub.zid)


def parts_of(rig: Rig, zid: str) -> set[str]:
    """Return the parts of the action that a session on the hub serves."""
    endpoints = rig.client.node.hub.graph.endpoints()
    return {end.topic for end in endpoints if end.zid == zid and end.kind in ("server", "publisher")} & set(PARTS)


def restart(rig: Rig) -> None:
    rig.worker.running("gateway").stop()
    rig.worker.running("gateway").start()


def test_the_gateway_withdraws_all_parts_while_another_node_serves_the_name(rig: Rig, other: RmwActionServer) -> None:
    until(lambda: not parts(rig), "all five parts are withdrawn")
    client_goal = ClientGoal(rig.client, pose(1.0))
    until(lambda: other.goals == [client_goal.sent.id], "the goal is at that node")
    assert not rig.planner.goals
    assert rig.gateway.drive is None
    other.end(GoalState.SUCCEEDED)
    assert client_goal.end() == ("SUCCEEDED", "")
    other.close()
    until(lambda: parts(rig) == set(PARTS), "the gateway has its name again")
    assert rig.module.status().served_by == ""
    client_goal = ClientGoal(rig.client, pose(2.0))
    rig.planner.reach(rig.planner.until(1))
    assert client_goal.end() == ("SUCCEEDED", "")
    assert len(other.goals) == 1


def test_a_node_that_was_there_before_the_gateway_keeps_the_name(rig: Rig) -> None:
    graph, hub = rig.client.node.hub.graph, rig.worker.running("gateway").host.node.hub
    zid = hub.zid
    rig.worker.running("gateway").stop()
    until(lambda: not parts_of(rig, zid), "the gateway has left the hub")
    other, seen = nav2(rig), set[str]()
    try:
        until(lambda: graph.servers(PARTS.send_goal), "the node's action is on the hub")
        until(lambda: hub.graph.servers(PARTS.send_goal), "the gateway's worker sees it")
        unwatch = graph.watch(lambda: seen.update(parts_of(rig, zid)))
        rig.worker.running("gateway").start()
        until(lambda: rig.module.status().served_by == NODE, "the gateway finds the node")
        until(lambda: not parts(rig), "the gateway has no part of the action")
        client_goal = ClientGoal(rig.client, pose(1.0))
        until(lambda: other.goals == [client_goal.sent.id], "the goal has reached that node")
        assert not rig.planner.goals
        assert rig.gateway.drive is None
        unwatch()
        assert not seen, "the gateway never served a part of the action"
    finally:
        other.close()
    until(lambda: parts(rig) == set(PARTS), "the gateway serves the name once the node has left")


def drive(rig: Rig) -> tuple[ClientGoal, Goal]:
    """Send a goal; return it once the client has requested its result of the only server that has the action."""
    client_goal = ClientGoal(rig.client, pose(1.0))
    goal = rig.planner.until(1)
    until(lambda: client_goal.sent.accepted, "the client knows that its goal is accepted")
    return client_goal, goal


def test_an_active_goal_of_the_gateway_continues_to_its_end(rig: Rig) -> None:
    client_goal, goal = drive(rig)
    with contextlib.closing(nav2(rig)):
        until(lambda: PARTS.send_goal not in parts(rig), "the gateway no longer accepts goals")
        assert parts(rig) == set(PARTS) - {PARTS.send_goal}, "the gateway's client still needs the other parts"
        rig.planner.on(lambda: goal.feedback({"distance_remaining": 0.5}))
        until(lambda: client_goal.feedback, "feedback still arrives")
        assert not client_goal.ended
        rig.planner.reach(goal)
        assert client_goal.end() == ("SUCCEEDED", "")
        until(lambda: not parts(rig), "the other parts are withdrawn")


def test_an_active_goal_of_the_gateway_can_be_canceled(rig: Rig) -> None:
    client_goal, goal = drive(rig)
    with contextlib.closing(nav2(rig)):
        until(lambda: PARTS.send_goal not in parts(rig), "the gateway no longer accepts goals")
        client_goal.cancel()
        until(lambda: not goal.active, "the planner ends the goal")
        assert client_goal.end()[0] == "CANCELED"
        until(lambda: not parts(rig), "all parts are withdrawn")


def test_goals_at_both_servers_have_their_own_results(rig: Rig) -> None:
    """While the gateway finishes its goal, two servers have parts of one action."""
    held, goal = drive(rig)
    with contextlib.closing(nav2(rig)) as other:
        until(lambda: PARTS.send_goal not in parts(rig), "the gateway no longer accepts goals")
        for number, status in enumerate((GoalState.SUCCEEDED, GoalState.CANCELED), 1):
            client_goal = ClientGoal(rig.client, pose(2.0))
            until(lambda: len(other.goals) == number, "a new goal has reached that node")  # noqa: B023
            if status is GoalState.CANCELED:
                client_goal.cancel()
            else:
                other.end(status)
            assert client_goal.end()[0] == status.name
        assert goal.active
        assert not held.ended
        rig.planner.reach(goal)
        assert held.end() == ("SUCCEEDED", "")


def test_an_active_goal_of_the_gateway_outlives_a_node_that_leaves_soon(rig: Rig) -> None:
    """The node leaves before the goal has ended; the gateway keeps serving the goal until it ends."""
    client_goal, goal = drive(rig)
    other = nav2(rig)
    until(lambda: PARTS.send_goal not in parts(rig), "the gateway no longer accepts goals")
    other.close()
    until(lambda: rig.module.status().served_by == "", "the gateway notices that the node has left")
    rig.planner.reach(goal)
    assert client_goal.end() == ("SUCCEEDED", "")
    until(lambda: parts(rig) == set(PARTS), "the gateway serves the name again")
    again = ClientGoal(rig.client, pose(2.0))
    rig.planner.reach(rig.planner.until(2))
    assert again.end() == ("SUCCEEDED", "")


@pytest.mark.usefixtures("other")
def test_other_entry_points_continue(rig: Rig) -> None:
    out = rig.far.advertise("/goal_pose", "geometry_msgs/PoseStamped")

    def once() -> bool:
        rig.far.publish(out, pose(7.0))
        return bool(rig.planner.goals)

    until(once, "the planner has the published goal")
    rig.state(State.MOVING)
    until(lambda: rig.ask("stop")["success"], "a stop cancels the last published goal")


@pytest.mark.usefixtures("other")
def test_status_and_doctor_name_the_node_that_serves_the_action(rig: Rig) -> None:
    until(lambda: rig.module.health().state == "running", "the stop of an earlier test is confirmed")
    health = rig.module.health()
    assert f"{ACTION} is served by {NODE}" in health.text
    warning = f"{ACTION} is served by {NODE}: its clients on the hub and on ROS 2 reach that node directly"
    document = rig.answer("gateway")
    assert document["served_by"] == NODE
    assert any(text.startswith(warning) for text in document["warnings"])
    printed = io.StringIO()
    show(Console(file=printed, width=1000), [read_status(document, "here", "gateway")])
    assert f"warning: {warning}" in printed.getvalue()
    findings = every(check_workers(around({"name": "here"}, hub=hub(document))))
    (matching,) = [finding for finding in findings if warning in finding.seen]
    assert matching.result is Result.WARN


def test_status_and_doctor_have_no_warning_after_the_node_has_left(rig: Rig) -> None:
    document = rig.answer("gateway")
    assert (document["served_by"], document["warnings"]) == ("", [])
    assert ACTION not in rig.module.health().text


def test_another_gateway_may_become_known_in_two_steps(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its action appears first, and then the service by which gateways are recognized."""
    action: Any = rig.module._action

    def poll_twice() -> list[bool]:
        serving = []
        for server in (endpoint(names(ACTION).send_goal, b"gid"), None):
            monkeypatch.setattr(action, "_other_server", lambda server=server: server)
            action.poll()
            serving.append(action._server.accepting)
        return serving

    with monkeypatch.context() as monkeypatch:
        assert rig.worker.running("gateway").host.loop.call(poll_twice) == [True, True]
    assert rig.module.status().served_by == ""


def test_a_starting_gateway_names_another_server_once_that_is_known_not_to_be_a_gateway(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    host: Any = SimpleNamespace(loop=SimpleNamespace(every=lambda *_arguments: None), log=logging.getLogger("test"))
    other = endpoint(names(ACTION).send_goal, b"gid")
    monkeypatch.setattr(NavigateAction, "_other_server", lambda _action: other)
    action = NavigateAction(host, lambda: False, lambda _goal: True, lambda _goal: True, lambda _goal, _reason: None)
    assert action.served_by == ""
    action.poll()
    assert action.served_by == f"{other.namespace.rstrip('/')}/{other.node.lstrip('/')}"


def test_two_gateways_on_one_hub_both_serve_the_name(rig: Rig, tmp_path: Path) -> None:
    """Two daemons on one hub each run a gateway; gateways do not withdraw because of each other."""
    worker = ModulesWorker()
    config: Any = rig.configured()
    second = config.model_copy(update={"name": "there", "state": tmp_path})
    worker.start(second.model_copy(update={"yarp": second.yarp.model_copy(update={"enabled": False})}))
    try:
        until(lambda: parts(rig, worker) == set(PARTS), "the second gateway serves the name")
        gateways = [worker.running("gateway"), rig.worker.running("gateway")]
        for running in gateways:
            until(lambda running=running: sees(running, gateways), "each gateway sees the other")  # type: ignore[misc]
            entry: Any = running.module
            running.host.loop.call(entry._action.poll)
        assert parts(rig) == parts(rig, worker) == set(PARTS)
        assert [running.module.status().served_by for running in gateways] == ["", ""]
        with contextlib.closing(nav2(rig)):
            until(lambda: not parts(rig) and not parts(rig, worker), "both gateways withdraw the action")
        until(lambda: parts(rig) == parts(rig, worker) == set(PARTS), "both gateways serve the name again")
    finally:
        worker.stop()


def sees(running: Any, gateways: list[Any]) -> bool:
    """Return whether a gateway knows the actions of all, and the services by which gateways are recognized."""
    graph, zids = running.host.node.hub.graph, {other.host.node.hub.zid for other in gateways}
    return all({server.zid for server in graph.servers(name)} >= zids for name in (PARTS.send_goal, STOP_SERVICE))
