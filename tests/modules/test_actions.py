"""Services and actions of modules, between two nodes of a hub."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from bridge.clock import SYSTEM
from bridge.hub.endpoints.calls import CallError
from bridge.hub.session import Hub
from bridge.messages.actions import GoalState
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.modules.action_server import Goal
from bridge.modules.clients import CANCEL_AGAIN, ActionClient, ModuleClient
from bridge.modules.host import ModuleNode
from bridge.modules.loop import EventLoop
from tests.support.quick_hub import QuickHub
from tests.support.wait import until

BOOL, LOOKUP = "std_srvs/srv/SetBool", "tf2_msgs/action/LookupTransform"
REGISTRY = Registry()


class Two:
    """Two nodes, each with a thread of its own."""

    def __init__(self) -> None:
        self.hubs = QuickHub()
        self.nodes: list[ModuleNode] = []
        for name in ("server", "client"):
            loop = EventLoop(name)
            loop.start()
            self.nodes.append(ModuleNode(Hub.open(self.hubs.settings(name)), REGISTRY, loop, SYSTEM))
        self.server, self.client = self.nodes

    def on(self, node: ModuleNode, action: Callable[[], Any]) -> Any:
        return node.loop.call(action)

    def close(self) -> None:
        for node in self.nodes:
            node.close()
            node.loop.close()
            node.hub.close()
        self.hubs.stop_router()


@pytest.fixture
def two() -> Iterator[Two]:
    made = Two()
    try:
        yield made
    finally:
        made.close()


def ask(two: Two, client: Any, request: dict[str, Any]) -> list[Any]:
    """The replies of one call: they come later."""
    replies: list[Any] = []
    until(lambda: client.ready, "there is a server")
    two.on(two.client, lambda: client.call(request, replies.append))
    return replies


def test_a_call_has_one_reply_or_one_error(two: Two) -> None:
    def serve(request: dict[str, Any], answer: Any) -> None:
        if request["data"]:
            answer({"success": True, "message": "on"})
            answer({"success": False, "message": "twice"})
        else:
            raise ValueError("off")

    server = two.server.server("/switch", BOOL, serve)
    client = two.client.client("/switch", BOOL)
    replies = ask(two, client, {"data": True})
    assert until(lambda: replies, "a reply") == [{"success": True, "message": "on"}]
    errors = ask(two, client, {"data": False})
    assert "ValueError: off" in str(until(lambda: errors, "an error")[0])
    with pytest.raises(ConversionError, match="dta"):
        client.call({"dta": True}, replies.append)
    assert server.counters.messages == 2
    held = ask(two, client, {"data": True})
    until(lambda: held, "a reply")
    server.close()
    gone: list[Any] = []
    client.call({"data": True}, gone.append)
    assert isinstance(until(lambda: gone, "an error")[0], CallError)


def test_a_reply_that_is_none_and_a_busy_server_are_told(two: Two, monkeypatch: pytest.MonkeyPatch) -> None:
    waiting: list[Any] = []
    two.server.server("/slow", BOOL, lambda _request, answer: waiting.append(answer))
    client = two.client.client("/slow", BOOL)
    monkeypatch.setattr("bridge.modules.services.MAX_WAITING", 2)
    first, second = ask(two, client, {}), ask(two, client, {})
    until(lambda: len(waiting) == 2, "both came")
    third = ask(two, client, {})
    assert "is busy" in str(until(lambda: third, "it is refused")[0])
    waiting[0]({"sucess": True})
    assert "malformed reply" in str(until(lambda: first, "an error")[0])
    waiting[1]({"success": True})
    assert until(lambda: second, "a reply")[0]["success"]
    ask(two, client, {})
    until(lambda: len(waiting) == 3, "there is room again")


class Served:
    """An action whose goals do what their frame's name says."""

    def __init__(self, two: Two) -> None:
        self.goals: list[Goal] = []
        self.may_cancel = True
        two.server.action_server("/lookup", LOOKUP, self.take, lambda _goal: self.may_cancel)

    def take(self, goal: Goal) -> bool:
        self.goals.append(goal)
        word = goal.goal["target_frame"]
        if word == "done":
            goal.execute()
            goal.succeed({"transform": {"child_frame_id": "here"}})
        if word == "broken":
            raise ValueError(word)
        return bool(word != "no")


class Sent:
    """One goal, and what its client heard."""

    def __init__(self, two: Two, client: Any, word: str) -> None:
        self.feedback: list[Any] = []
        self.ends: list[tuple[Any, ...]] = []
        self.goal = two.on(
            two.client,
            lambda: client.send({"target_frame": word}, lambda *end: self.ends.append(end), self.feedback.append),
        )

    def ended(self) -> tuple[GoalState, Any, str]:
        goal, result, why = until(lambda: self.ends, "the goal ends")[0]
        return goal.status, result, why


def test_goals_end_as_their_server_says(two: Two) -> None:
    served = Served(two)
    client = two.client.action_client("/lookup", LOOKUP)
    until(lambda: client.ready, "there is a server")
    status, result, _ = Sent(two, client, "done").ended()
    assert status is GoalState.SUCCEEDED
    assert result["transform"]["child_frame_id"] == "here"
    assert "rejected" in Sent(two, client, "no").ended()[2]
    assert "ValueError" in Sent(two, client, "broken").ended()[2]
    late = Sent(two, client, "wait")
    until(lambda: late.goal.accepted, "it is accepted")
    goal = served.goals[-1]
    hub = two.server.hub
    until(lambda: hub.graph.zid_of(goal.client) == two.client.hub.zid, "it is known whose it is")
    until(lambda: two.client.hub.zid in hub.neighbours(), "which is of this machine")
    two.on(two.server, goal.execute)
    until(lambda: (two.on(two.server, lambda: goal.feedback({})), late.feedback)[1], "feedback comes")
    assert not late.ends
    two.on(two.server, lambda: (goal.abort(), goal.succeed()))
    assert late.ended()[0] is GoalState.ABORTED
    assert len(late.ends) == 1
    again: list[Any] = []
    asks = two.client.client("/lookup/_action/get_result", f"{LOOKUP}_GetResult")
    until(lambda: asks.ready, "it can be asked")
    asks.call({"goal_id": {"uuid": list(goal.id)}}, again.append)
    assert until(lambda: again, "the result is kept")[0]["status"] == GoalState.ABORTED


def test_one_goal_or_all_are_cancelled(two: Two) -> None:
    served = Served(two)
    client = two.client.action_client("/lookup", LOOKUP)
    until(lambda: client.ready, "there is a server")
    goals = [Sent(two, client, "wait") for _ in range(3)]
    until(lambda: all(sent.goal.accepted for sent in goals), "all are accepted")
    served.may_cancel = False
    two.on(two.client, goals[0].goal.cancel)
    cancel = two.client.client("/lookup/_action/cancel_goal", "action_msgs/srv/CancelGoal")
    until(lambda: cancel.ready, "it can be asked")
    codes: list[Any] = []
    for uuid in (goals[0].goal.id, bytes([7] * 16)):
        cancel.call({"goal_info": {"goal_id": {"uuid": list(uuid)}}}, codes.append)
    until(lambda: len(codes) == 2, "both are answered")
    assert [code["return_code"] for code in codes] == [1, 2]
    served.may_cancel = True
    two.on(two.client, goals[0].goal.cancel)
    goal = next(g for g in served.goals if g.id == goals[0].goal.id)
    until(lambda: goal.status is GoalState.CANCELING, "the server heard it")
    two.on(two.server, goal.canceled)
    assert goals[0].ended()[0] is GoalState.CANCELED
    two.on(two.client, client.cancel)
    until(lambda: all(g.cancel_wanted for g in served.goals), "all are to end")
    two.on(two.server, lambda: [g.canceled() for g in served.goals])
    assert [sent.ended()[0] for sent in goals] == [GoalState.CANCELED] * 3


CANCEL_GOAL = "/lookup/_action/cancel_goal"


def until_cancelling(two: Two, client: ActionClient) -> None:
    """Wait until goals can be sent, and cancelled."""
    cancelling = two.client.client(CANCEL_GOAL, "action_msgs/srv/CancelGoal")
    until(lambda: client.ready and cancelling.ready, "there is a server")


def cancellations(monkeypatch: pytest.MonkeyPatch, fails: Callable[[int], bool]) -> list[bytes]:
    """The goals whose cancellation was asked for; the so manieth call may find no server."""
    asked, call = list[bytes](), ModuleClient.call

    def calling(self: ModuleClient, request: dict[str, Any], replied: Callable[[Any], None]) -> Any:
        if self.topic != CANCEL_GOAL:
            return call(self, request, replied)
        asked.append(bytes(request["goal_info"]["goal_id"]["uuid"]))
        return replied(CallError("no server")) if fails(len(asked)) else call(self, request, replied)

    monkeypatch.setattr(ModuleClient, "call", calling)
    return asked


def test_a_cancel_that_cannot_be_asked_for_is_asked_for_again(two: Two, monkeypatch: pytest.MonkeyPatch) -> None:
    served = Served(two)
    client = two.client.action_client("/lookup", LOOKUP)
    until_cancelling(two, client)
    sent = Sent(two, client, "wait")
    asked = cancellations(monkeypatch, lambda count: count < 3 or served.goals[0].status is GoalState.CANCELED)
    until(lambda: sent.goal.accepted, "it is accepted")
    two.on(two.client, sent.goal.cancel)
    until(lambda: served.goals[0].cancel_wanted, "the server heard it")
    assert asked == [sent.goal.id] * 3
    two.on(two.server, served.goals[0].canceled)
    assert sent.ended()[0] is GoalState.CANCELED
    two.on(two.client, sent.goal.cancel)
    again = threading.Event()
    two.client.loop.after(1.5 * CANCEL_AGAIN, again.set)
    assert again.wait(40)
    assert len(asked) == 4, "a goal that has ended is asked for no more"


def test_a_cancellation_of_all_goals_is_asked_for_again_until_one_is_sent(
    two: Two, monkeypatch: pytest.MonkeyPatch
) -> None:
    served = Served(two)
    client = two.client.action_client("/lookup", LOOKUP)
    until_cancelling(two, client)
    monkeypatch.setattr("bridge.modules.clients.CANCEL_ALL_SECONDS", 60.0)
    asked = cancellations(monkeypatch, lambda count: count != 3)
    sent = Sent(two, client, "wait")
    until(lambda: sent.goal.accepted, "it is accepted")
    two.on(two.client, client.cancel)
    until(lambda: served.goals[0].cancel_wanted, "the server heard it")
    assert asked == [bytes(16)] * 3
    two.on(two.client, lambda: (client.cancel(), client.send({"target_frame": "wait"}, lambda *_end: None)))
    again = threading.Event()
    two.client.loop.after(1.5 * CANCEL_AGAIN, again.set)
    assert again.wait(40)
    assert len(asked) == 4, "the goal that was sent since is not cancelled"


def test_a_server_that_leaves_ends_its_goals(two: Two, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, ask = list[None](), Goal.ask
    monkeypatch.setattr(Goal, "ask", lambda goal, answer: asked.append(ask(goal, answer)))
    Served(two)
    client = two.client.action_client("/lookup", LOOKUP)
    until(lambda: client.ready, "there is a server")
    sent = Sent(two, client, "wait")
    until(lambda: asked, "its result is asked for")
    two.server.close()
    status, _, why = sent.ended()
    assert status is GoalState.ABORTED
    assert "left" in why
