"""Programs on Midspan's own ROS 1 node use a real roscore and real actionlib servers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest

from bridge.adapters.ros1.actions import discovery, wire
from bridge.adapters.ros1.actions.states import Ros1State
from bridge.adapters.ros1.program import Message, Ros1Program
from bridge.adapters.ros1_peers import UnreachableError
from bridge.messages.actions import GoalState
from tests.peers.peer import Peer
from tests.peers.ros1.hub_actions import PEER
from tests.peers.ros1.network import ROS1_PYTHON, RosMaster
from tests.support.ports import free_port
from tests.support.wait import until

TEST = "actionlib/Test"


@pytest.fixture
def program(master: RosMaster, monkeypatch: pytest.MonkeyPatch) -> Iterator[Ros1Program]:
    monkeypatch.setenv("ROS_MASTER_URI", master.uri)
    with Ros1Program("program") as program:
        yield program


@pytest.fixture
def server(master: RosMaster, request: pytest.FixtureRequest) -> Iterator[Peer]:
    """A rospy program with one action server, whose action has the test's name."""
    peer = Peer(PEER, ROS1_PYTHON, master.env, f"{action_of(request)[1:]}_server")
    try:
        yield peer
    finally:
        peer.stop()


def action_of(request: pytest.FixtureRequest) -> str:
    return f"/{request.function.__name__}"


def test_goals_end_with_state_text_result_and_feedback(
    program: Ros1Program, server: Peer, request: pytest.FixtureRequest
) -> None:
    action = server.ask("server", name=action_of(request))["id"]
    client = program.action_client(action_of(request), TEST)
    assert client.wait_for_server(40)
    feedback: list[Message] = []

    def on_feedback(message: Message) -> None:
        feedback.append(message)
        server.ask("finish_all", id=action)  # only now, because a result may overtake feedback

    done = client.send_goal({"goal": 5}, on_feedback)
    assert (done.state, done.result, done.succeeded) == (GoalState.SUCCEEDED, {"result": 5}, True)
    assert feedback == [{"feedback": 5}]
    aborted = client.send_goal({"goal": 11})
    assert (aborted.state, aborted.text, aborted.succeeded) == (GoalState.ABORTED, "abort", False)
    rejected = client.send_goal({"goal": 12})
    assert (rejected.text, rejected.succeeded) == ("the server rejected the goal", False)


def test_a_goal_ends_when_its_server_dies(program: Ros1Program, server: Peer, request: pytest.FixtureRequest) -> None:
    server.ask("server", name=action_of(request))
    client = program.action_client(action_of(request), TEST)
    assert client.wait_for_server(40)
    done = client.send_goal({"goal": 5}, lambda _: server.stop(0))
    assert not done.succeeded
    assert done.text.endswith(f"its action server {action_of(request)}_server left")


@pytest.mark.parametrize("when", ["while waiting", "during feedback", "as the goal is sent"])
def test_an_interrupt_cancels_the_goal(
    program: Ros1Program, server: Peer, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    """An interrupt ends a ``with`` block, even while another thread runs the program's callback."""
    name = action_of(request)
    server.ask("server", name=name)
    client = program.action_client(name, TEST)
    assert client.wait_for_server(40)
    accepted: list[Message] = []
    go_on = threading.Event()
    wait, publish = program.wait, client.publish

    def interrupted(ready: Callable[[], bool], seconds: float) -> bool:
        if accepted:
            raise KeyboardInterrupt
        return wait(ready, seconds)

    def interrupted_after(part: str, payload: bytes) -> None:
        publish(part, payload)
        if part == discovery.GOAL:
            raise KeyboardInterrupt

    def on_feedback(message: Message) -> None:
        accepted.append(message)
        if when == "during feedback":
            go_on.wait(40)

    states: list[int] = []
    with Ros1Program("watcher") as watcher:
        result = watcher.registry.ros1(f"{TEST}ActionResult")
        watcher.subscribe(
            f"{name}/result", result, lambda data, _: states.append(wire.read_action_outcome(data)[0].state)
        )
        until(lambda: watcher.publishers(f"{name}/result"), "the watcher is connected")
        monkeypatch.setattr(program, "wait", interrupted)
        if when == "as the goal is sent":
            monkeypatch.setattr(client, "publish", interrupted_after)
        try:
            with pytest.raises(KeyboardInterrupt), program:
                client.send_goal({"goal": 5}, on_feedback)
            until(lambda: states, "the goal has ended")
        finally:
            go_on.set()
    assert states[0] in (Ros1State.PREEMPTED, Ros1State.RECALLED)


def test_a_program_without_server_publisher_or_master_gets_an_answer(
    program: Ros1Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not program.action_client("/nobody", TEST).wait_for_server(0.2)
    assert program.wait_for_message("/silent", "std_msgs/String", 0.2) is None
    port = free_port()
    monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{port}/")
    with Ros1Program("lost") as lost, pytest.raises(UnreachableError, match=str(port)):
        lost.wait_for_message("/silent", "std_msgs/String", 1.0)


def test_a_closed_program_leaves_the_graph(master: RosMaster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", master.uri)
    with Ros1Program("brief") as program:
        program.action_client("/brief_action", TEST)
        assert program.name in master.nodes()
    assert program.name not in master.nodes()


def test_messages_of_a_rospy_publisher_arrive(master: RosMaster, program: Ros1Program) -> None:
    talker = master.peer("talker")
    try:
        talker.publish(talker.advertise("/latched", "std_msgs/String", latched=True), {"data": "here"})
        for _ in range(2):  # the first subscription has ended
            assert program.wait_for_message("/latched", "std_msgs/String", 40) == {"data": "here"}
    finally:
        talker.stop()
