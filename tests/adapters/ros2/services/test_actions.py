"""A real ActionClient and a real ActionServer connected only through the edge, as three services and two topics."""

from __future__ import annotations

import signal
from collections.abc import Callable
from itertools import pairwise

import pytest

from bridge.hub.wire.qos import Durability, Qos
from bridge.routing.edge import Kind
from tests.adapters.ros2.conftest import RunningEdge
from tests.peers.peer import Peer

TYPE = "nav2_msgs/NavigateToPose"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
GOAL = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}}}}
SERVICES = {
    "send_goal": "nav2_msgs/action/NavigateToPose_SendGoal",
    "get_result": "nav2_msgs/action/NavigateToPose_GetResult",
    "cancel_goal": "action_msgs/srv/CancelGoal",
}
TOPICS = {
    "feedback": ("nav2_msgs/action/NavigateToPose_FeedbackMessage", Qos(depth=100)),
    "status": ("action_msgs/msg/GoalStatusArray", Qos(depth=1, durability=Durability.TRANSIENT_LOCAL)),
}


def relay(running: RunningEdge, real: str, shown: str) -> None:
    """Offer the native action ``real`` under another name, as two engines do between two domains."""
    edge, registry = running.edge, running.registry
    for part, name in SERVICES.items():
        running.until_seen(f"{real}/_action/{part}", Kind.SERVER)
        conversion = edge.service_from_hub(name, registry.service_ros2(name).type_id)
        edge.serve(
            f"{shown}/_action/{part}", conversion.side, edge.caller(f"{real}/_action/{part}", conversion.side).call
        )
    for part, (name, qos) in TOPICS.items():
        running.until_seen(f"{real}/_action/{part}", Kind.PUBLISHER)
        publisher = edge.advertise(f"{shown}/_action/{part}", registry.ros2(name), qos)
        edge.subscribe(
            f"{real}/_action/{part}",
            registry.ros2(name),
            qos,
            lambda payload, source, _time, publisher=publisher: publisher.send(payload, source),
        )


@pytest.fixture
def server(peer: Callable[..., Peer]) -> Peer:
    return peer("server")


@pytest.fixture
def client(peer: Callable[..., Peer]) -> Peer:
    return peer("client")


def act(server: Peer, running: RunningEdge, **more: object) -> int:
    created = int(server.ask("act", action="/real", type=TYPE, **more)["id"])
    relay(running, "/real", "/shown")
    return created


def send(client: Peer, count: int = 1) -> list[int]:
    return [int(client.ask("send_goal", action="/shown", type=TYPE, goal=GOAL)["id"]) for _ in range(count)]


def test_a_goal_gets_its_feedback_and_its_result(edge: RunningEdge, server: Peer, client: Peer) -> None:
    feedback = [{"distance_remaining": float(n)} for n in (3, 2, 1)]
    # the first may precede the match of the client's reader, whose history of 100 must suffice if the client stalls
    repeated = {"times": 100, "period": 0.5}
    acting = act(server, edge, held=True, feedback=feedback, result={"error_msg": "none"}, **repeated)
    (goal,) = send(client)
    state = client.ask("goal", id=goal, until={"accepted": True, "feedback": 4})
    assert state["accepted"]
    assert server.ask("goals", id=acting)["goals"][0]["pose"]["pose"]["position"]["x"] == 1.5
    server.ask("release", id=acting)
    state = client.ask("goal", id=goal, until={"status": SUCCEEDED})
    assert (state["status"], state["result"]["error_msg"]) == (SUCCEEDED, "none")
    remaining = [f["distance_remaining"] for f in state["feedback"]]
    assert len(remaining) >= 4
    assert set(pairwise(remaining)) == {(3.0, 2.0), (2.0, 1.0), (1.0, 3.0)}


def test_a_rejected_goal_is_reported_as_not_accepted(edge: RunningEdge, server: Peer, client: Peer) -> None:
    act(server, edge, outcome="reject")
    (goal,) = send(client)
    assert client.ask("goal", id=goal, until={"accepted": False})["accepted"] is False


def test_an_aborted_goal_has_its_result(edge: RunningEdge, server: Peer, client: Peer) -> None:
    act(server, edge, outcome="abort", result={"error_code": 7})
    (goal,) = send(client)
    state = client.ask("goal", id=goal, until={"status": ABORTED})
    assert (state["status"], state["result"]["error_code"]) == (ABORTED, 7)


def test_only_the_canceled_goal_among_others_ends(edge: RunningEdge, server: Peer, client: Peer) -> None:
    acting = act(server, edge, held=True)
    goals = send(client, 3)
    for goal in goals:
        client.ask("goal", id=goal, until={"accepted": True})
    client.ask("cancel", id=goals[1])
    state = client.ask("goal", id=goals[1], until={"status": CANCELED, "cancel": [0, 1]})
    assert (state["status"], state["cancel"]) == (CANCELED, [0, 1])
    server.ask("release", id=acting)
    for goal in (goals[0], goals[2]):
        assert client.ask("goal", id=goal, until={"status": SUCCEEDED})["status"] == SUCCEEDED


def test_a_goal_succeeds_after_a_rejected_cancel_request(edge: RunningEdge, server: Peer, client: Peer) -> None:
    acting = act(server, edge, held=True, keeps=True)
    (goal,) = send(client)
    client.ask("goal", id=goal, until={"accepted": True})
    client.ask("cancel", id=goal)
    assert client.ask("goal", id=goal, until={"cancel": [0, 0]})["cancel"] == [0, 0]  # like rclpy's rejection
    server.ask("release", id=acting)
    assert client.ask("goal", id=goal, until={"status": SUCCEEDED})["status"] == SUCCEEDED


def test_killed_server_aborts_its_goals(edge: RunningEdge, server: Peer, client: Peer) -> None:
    act(server, edge, held=True)
    goals = send(client, 2)
    for goal in goals:
        client.ask("goal", id=goal, until={"accepted": True})
    server.signal(signal.SIGKILL)
    server.popen.wait()
    for goal in goals:
        assert client.ask("goal", id=goal, until={"status": ABORTED}, seconds=15)["status"] == ABORTED
    client.ask("cancel", id=goals[0])
    assert client.ask("goal", id=goals[0], until={"cancel": [1, 0]})["cancel"] == [1, 0]
    (late,) = send(client)
    assert client.ask("goal", id=late, until={"accepted": False})["accepted"] is False
