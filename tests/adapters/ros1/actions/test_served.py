"""The hub's actions are served to real actionlib clients."""

import signal
import struct

import pytest

from bridge.adapters.ros1.actions import wire
from bridge.adapters.ros1.actions.states import Ros1State
from bridge.adapters.ros1.actions.wire import ZERO
from bridge.messages.actions import GoalState
from tests.peers.ros1.adapter import edge_on
from tests.peers.ros1.hub_actions import ANY, SECONDS, HubServer, Served, body, encoded, peer_on
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.support.wait import until

pytestmark = needs_ros1


@pytest.fixture(scope="module")
def clients(master):
    """A program whose clients are named by each test."""
    with peer_on(master, "clients") as peer:
        yield peer


def test_a_client_runs_a_goal_of_the_hub(master, edge, clients):
    peer = clients
    act = Served(edge, peer, "/run")
    act.send(5)
    ((goal, data),) = act.goals(1)
    assert data == body(5)
    act.hub.accept(0)
    act.until_state(5, "PENDING")
    act.hub.states({goal: GoalState.EXECUTING})
    act.until_state(5, "ACTIVE")
    act.hub.publish("feedback", goal + body(50))
    until(
        lambda: peer.ask("outcomes", id=act.id, numbers=[5], seconds=0)["outcomes"][0]["feedback"] == [50],
        "feedback arrives",
        SECONDS,
    )
    act.hub.end(goal, GoalState.SUCCEEDED, 500)
    outcome = act.done(5)
    assert (outcome["state"], outcome["result"]) == (Ros1State.SUCCEEDED, 500)
    act.hub.close()
    until(lambda: "/run/status" not in master.state()["publishers"], "the edge's topics are unregistered", SECONDS)


def test_ros_1_clients_receive_the_outcome_of_each_goal_of_a_hub_server(master, edge, clients):
    ends = {
        1: (GoalState.SUCCEEDED, Ros1State.SUCCEEDED), 2: (GoalState.ABORTED, Ros1State.ABORTED),
        3: (GoalState.CANCELED, Ros1State.PREEMPTED), 4: (GoalState.UNKNOWN, Ros1State.ABORTED),
    }  # fmt: skip
    peer = clients
    act = Served(edge, peer, "/ends")
    act.send(1, 2, 3, 4, 5, 6)
    goals = {struct.unpack("<i", data)[0]: (at, goal) for at, (goal, data) in enumerate(act.goals(6))}
    for number in ends:
        act.hub.accept(goals[number][0])
    act.hub.accept(goals[5][0], accepted=False)
    act.hub.answer("send_goal", goals[6][0], error="no server")
    act.hub.states({goals[n][1]: GoalState.EXECUTING for n in ends})
    for number, (state, seen) in ends.items():
        act.hub.end(goals[number][1], state, number * 10)
        outcome = act.done(number)
        assert (outcome["state"], outcome["result"]) == (seen, number * 10)
    assert act.done(5)["state"] == Ros1State.REJECTED
    assert (act.done(6)["state"], act.done(6)["text"]) == (Ros1State.ABORTED, "no server")
    act.hub.close()


def test_a_ros_1_client_cancels_goals_of_a_hub_server(master, edge, clients):
    peer = clients
    act = Served(edge, peer, "/stop")
    act.send(1, 2)
    goals = {struct.unpack("<i", data)[0]: goal for goal, data in act.goals(2)}
    for at in (0, 1):
        act.hub.accept(at)
    act.hub.states(dict.fromkeys(goals.values(), GoalState.EXECUTING))
    for number in goals:
        act.until_state(number, "ACTIVE")
    peer.ask("cancel", id=act.id, number=1)
    assert [wire.read_cancel_request(r) for r in act.hub.calls("cancel_goal")] == [(goals[1], ZERO)]
    act.until_state(1, "PREEMPTING")
    act.hub.end(goals[1], GoalState.CANCELED, 0)
    assert act.done(1)["state"] == Ros1State.PREEMPTED
    peer.ask("cancel", id=act.id)
    assert wire.read_cancel_request(act.hub.calls("cancel_goal", 2)[1]) == (ANY, ZERO)
    act.until_state(2, "PREEMPTING")
    act.hub.end(goals[2], GoalState.SUCCEEDED, 0)
    assert act.done(2)["state"] == Ros1State.SUCCEEDED
    peer.ask("cancel_id", id=act.id, goal="later")
    until(
        lambda: ["later", Ros1State.RECALLING, ""] in peer.ask("status", id=act.id)["goals"],
        "the cancel request waits for its goal",
        SECONDS,
    )
    peer.ask("raw_goal", id=act.id, goal="later", number=3, stamp=[1, 0])
    until(
        lambda: ["later", Ros1State.RECALLED, ""] in peer.ask("status", id=act.id)["goals"],
        "the goal is recalled",
        SECONDS,
    )
    assert len(act.goals(2)) == 2, "the recalled goal never reached the hub"
    peer.ask("raw_goal", id=act.id, number=4)
    assert act.goals(3)[2][1] == body(4)
    until(
        lambda: any(g[0].startswith("/stop-1-") for g in peer.ask("status", id=act.id)["goals"]),
        "the goal has an id",
        SECONDS,
    )
    act.hub.close()


def test_a_thousand_concurrent_goals_of_ros_1_end_as_the_hub_reports(master, edge, clients):
    """All goals are accepted or rejected, or have failed, before the first one ends."""
    count = 1000
    hub = HubServer(edge, "/crowd")
    flood = clients.ask("flood", name="/crowd", count=count)["id"]
    goals = [wire.read_with_uuid(request) for request in hub.calls("send_goal", count)]
    numbers = [struct.unpack("<i", data)[0] for _, data in goals]
    assert numbers == list(range(count))
    ends = (GoalState.SUCCEEDED, GoalState.ABORTED, GoalState.CANCELED)
    seen = {GoalState.SUCCEEDED: Ros1State.SUCCEEDED, GoalState.ABORTED: Ros1State.ABORTED}
    wanted = {}
    for number in numbers:
        more = {"id": hub.services["send_goal"], "number": number}
        if number % 10 == 1:
            edge.ask("answer", error="no server", **more)
            wanted[number] = [Ros1State.ABORTED, 0]
        else:
            edge.ask("answer", reply=encoded(wire.goal_response(ZERO, accepted=number % 10 != 2)), **more)
            wanted[number] = [Ros1State.REJECTED, 0]
    at = {goal: index for index, goal in enumerate(hub.calls("get_result", count * 8 // 10))}
    for (goal, _), number in zip(goals, numbers, strict=True):
        if number % 10 not in (1, 2):
            state = ends[number % 3]
            reply = encoded(wire.result_response(state, body(number)))
            edge.ask("answer", id=hub.services["get_result"], number=at[goal], reply=reply)
            wanted[number] = [seen.get(state, Ros1State.RECALLED), number]
    results = clients.ask("results", id=flood, count=count)["results"]
    assert results == {f"g{number}": [end] for number, end in wanted.items()}
    hub.close()


def test_goals_end_when_their_hub_server_leaves(master, edge, clients):
    peer = clients
    act = Served(edge, peer, "/gone")
    act.send(1)
    act.hub.accept(0)
    ((goal, _),) = act.goals(1)
    act.hub.result_call(goal)
    act.hub.states({goal: GoalState.EXECUTING})
    act.until_state(1, "ACTIVE")
    abandoned = act.hub.services["get_result"]
    act.hub.close()
    outcome = act.done(1)
    assert (outcome["state"], outcome["text"]) == (Ros1State.ABORTED, "the action server left")
    until(lambda: edge.ask("calls", id=abandoned)["abandoned"] == [0], "the call is abandoned", SECONDS)
    again = HubServer(edge, "/gone")
    assert peer.ask("wait_for_server", id=act.id, seconds=SECONDS)["there"]

    def sent() -> list:
        peer.ask("send", id=act.id, numbers=[2])
        return again.edge.ask("calls", id=again.services["send_goal"])["requests"]

    until(sent, "the client is connected again", SECONDS, 0.3)
    again.close()


@pytest.mark.thorough
def test_a_killed_worker_leaves_no_client_waiting(tmp_path):
    with RosMaster() as master, peer_on(master, "left_client") as peer:
        with edge_on(master, tmp_path) as first:
            act = Served(first, peer, "/left")
            act.send(1)
            ((goal, _),) = act.goals(1)
            act.hub.accept(0)
            act.hub.states({goal: GoalState.EXECUTING})
            act.until_state(1, "ACTIVE")
            first.signal(signal.SIGKILL)
        with edge_on(master, tmp_path) as second:
            HubServer(second, "/left")
            outcome = act.done(1)
            assert outcome["state"] == Ros1State.LOST


def test_a_native_server_keeps_its_name(master, edge):
    with peer_on(master, "rival_client") as client, peer_on(master, "rival_server") as peer:
        act = Served(edge, client, "/rival")
        server = peer.ask("server", name="/rival")["id"]
        reason = "/rival: /rival_server serves this action on ROS 1 itself, so the hub's action is not offered there"
        until(lambda: reason in edge.ask("status")["warnings"], "a warning is reported", SECONDS)
        until(
            lambda: master.state()["publishers"]["/rival/status"] == ["/rival_server"],
            "the hub's action is withdrawn",
            SECONDS,
        )
        peer.ask("stop_server", id=server)
        until(
            lambda: master.state()["publishers"].get("/rival/status") == ["/midspan"],
            "the hub's action is offered again",
            SECONDS,
        )
        act.hub.close()
