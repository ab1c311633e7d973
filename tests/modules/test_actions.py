"""Services and actions of modules, between two nodes of a hub."""

from __future__ import annotations

import contextlib
import re
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from bridge.client.actions import CANCEL_AGAIN, ActionClient
from bridge.client.services import ServiceClient
from bridge.clock import RunClock, SystemClock
from bridge.hub.endpoints.calls import CallError
from bridge.messages.actions import CancelCode, GoalState
from bridge.messages.errors import ConversionError
from bridge.modules.action_server import Goal
from bridge.modules.host import ModuleNode
from tests.peers.hub.node import HubNode
from tests.peers.hub.quick import QuickHub
from tests.support.wait import until

BOOL, LOOKUP = "std_srvs/srv/SetBool", "tf2_msgs/action/LookupTransform"


class NodePair:
    """A server node and a client node, each with its own thread."""

    def __init__(self) -> None:
        self.hubs = QuickHub()
        self._programs = [HubNode(self.hubs.settings(name)) for name in ("server", "client")]
        self.server, self.client = (program.node for program in self._programs)

    def on(self, node: ModuleNode, action: Callable[[], Any]) -> Any:
        return node.loop.call(action, 40.0)

    def close(self) -> None:
        for program in self._programs:
            program.close()
        self.hubs.stop_router()


@pytest.fixture
def pair() -> Iterator[NodePair]:
    with contextlib.closing(NodePair()) as nodes:
        yield nodes


def ask(pair: NodePair, client: Any, request: dict[str, Any]) -> list[Any]:
    """Call a service; return the list to which its replies are appended."""
    replies: list[Any] = []
    until(lambda: client.ready, "the server is available")
    pair.on(pair.client, lambda: client.call(request, replies.append))
    return replies


def test_a_call_has_one_reply_or_one_error(pair: NodePair) -> None:
    def serve(request: dict[str, Any], answer: Any) -> None:
        if request["data"]:
            answer({"success": True, "message": "on"})
            answer({"success": False, "message": "twice"})
        else:
            raise ValueError("off")

    server = pair.server.server("/switch", BOOL, serve)
    client = pair.client.client("/switch", BOOL)
    replies = ask(pair, client, {"data": True})
    assert until(lambda: replies, "a reply arrives") == [{"success": True, "message": "on"}]
    errors = ask(pair, client, {"data": False})
    assert "ValueError: off" in str(until(lambda: errors, "an error arrives")[0])
    with pytest.raises(ConversionError, match="dta"):
        client.call({"dta": True}, replies.append)
    assert server.counters.messages == 2
    last_replies = ask(pair, client, {"data": True})
    until(lambda: last_replies, "a reply arrives")
    server.close()
    late_replies: list[Any] = []
    client.call({"data": True}, late_replies.append)
    assert isinstance(until(lambda: late_replies, "an error arrives")[0], CallError)


def test_a_malformed_reply_and_a_busy_server_are_errors(pair: NodePair, monkeypatch: pytest.MonkeyPatch) -> None:
    pending: list[Any] = []
    pair.server.server("/slow", BOOL, lambda _request, answer: pending.append(answer))
    client = pair.client.client("/slow", BOOL)
    monkeypatch.setattr("bridge.modules.services.MAX_WAITING", 2)
    first, second = ask(pair, client, {}), ask(pair, client, {})
    until(lambda: len(pending) == 2, "both requests are pending")
    third = ask(pair, client, {})
    assert "is busy" in str(until(lambda: third, "the third request is rejected")[0])
    pending[0]({"sucess": True})
    assert "malformed reply" in str(until(lambda: first, "an error arrives")[0])
    pending[1]({"success": True})
    assert until(lambda: second, "a reply arrives")[0]["success"]
    ask(pair, client, {})
    until(lambda: len(pending) == 3, "the next request is accepted")


class Served:
    """An action server whose goals name their outcome in ``target_frame``."""

    def __init__(self, pair: NodePair) -> None:
        self.goals: list[Goal] = []
        self.may_cancel = True
        pair.server.action_server("/lookup", LOOKUP, self.accept, lambda _goal: self.may_cancel)

    def accept(self, goal: Goal) -> bool:
        self.goals.append(goal)
        outcome = goal.goal["target_frame"]
        if outcome == "done":
            goal.execute()
            goal.succeed({"transform": {"child_frame_id": "here"}})
        if outcome == "broken":
            raise ValueError(outcome)
        return bool(outcome != "no")


class Sent:
    """A sent goal, with the feedback and results that its client received."""

    def __init__(self, pair: NodePair, client: Any, outcome: str) -> None:
        self.feedback: list[Any] = []
        self.ends: list[tuple[Any, ...]] = []
        self.goal = pair.on(
            pair.client,
            lambda: client.send({"target_frame": outcome}, lambda *end: self.ends.append(end), self.feedback.append),
        )

    def ended(self) -> tuple[GoalState, Any, str]:
        goal, result, reason = until(lambda: self.ends, "the goal ends")[0]
        return goal.status, result, reason


def test_goals_end_as_their_server_decides(pair: NodePair) -> None:
    served = Served(pair)
    client = pair.client.action_client("/lookup", LOOKUP)
    until(lambda: client.ready, "the action is available")
    status, result, _ = Sent(pair, client, "done").ended()
    assert status is GoalState.SUCCEEDED
    assert result["transform"]["child_frame_id"] == "here"
    assert "rejected" in Sent(pair, client, "no").ended()[2]
    assert "ValueError" in Sent(pair, client, "broken").ended()[2]
    late = Sent(pair, client, "wait")
    until(lambda: late.goal.accepted, "the goal is accepted")
    goal = served.goals[-1]
    hub = pair.server.hub
    until(lambda: hub.graph.zid_of(goal.client) == pair.client.hub.zid, "the graph lists the goal's client")
    until(lambda: pair.client.hub.zid in hub.neighbors(), "the client's session is known to be on this machine")
    pair.on(pair.server, goal.execute)
    until(lambda: (pair.on(pair.server, lambda: goal.feedback({})), late.feedback)[1], "the client receives feedback")
    assert not late.ends
    pair.on(pair.server, lambda: (goal.abort(), goal.succeed()))
    assert late.ended()[0] is GoalState.ABORTED
    assert len(late.ends) == 1
    results: list[Any] = []
    get_result = pair.client.client("/lookup/_action/get_result", f"{LOOKUP}_GetResult")
    until(lambda: get_result.ready, "the get_result service is available")
    get_result.call({"goal_id": {"uuid": list(goal.id)}}, results.append)
    assert until(lambda: results, "the cached result arrives")[0]["status"] == GoalState.ABORTED


def test_the_list_has_active_goals_however_many_have_ended(pair: NodePair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.modules.action_server.MAX_STATUSES", 3)
    served = Served(pair)
    client = pair.client.action_client("/lookup", LOOKUP)
    lists: list[list[int]] = []

    def on_list(message: dict[str, Any]) -> None:
        lists.append([entry["status"] for entry in message["status_list"]])

    pair.client.subscription("/lookup/_action/status", "action_msgs/msg/GoalStatusArray", on_list)
    until(lambda: client.ready, "the action is available")
    Sent(pair, client, "wait")
    until(lambda: served.goals, "the goal arrives")
    for _ in range(3):
        assert Sent(pair, client, "done").ended()[0] is GoalState.SUCCEEDED
    until(lambda: lists and lists[-1] == [GoalState.SUCCEEDED] * 2 + [GoalState.ACCEPTED], "the list has all")


NAVIGATE = "nav2_msgs/action/NavigateToPose"


class Faulty:
    """A planner with an error, which the goal's ``behavior_tree`` names."""

    def __init__(self, pair: NodePair) -> None:
        self.canceled: list[Goal] = []
        pair.server.action_server("/drive", NAVIGATE, self.accept, lambda goal: not self.canceled.append(goal))

    def accept(self, goal: Goal) -> Any:
        goal.execute()
        match goal.goal["behavior_tree"]:
            case "raises":
                raise ZeroDivisionError("no cells")
            case "bad feedback":
                goal.feedback({"distance": 1.0})
            case "bad result":
                goal.abort({"reason": "no path"})
            case "bad value":
                goal.abort({"error_msg": 7})


@pytest.mark.parametrize(
    ("error", "reason", "canceled"),
    [
        ("raises", "/drive failed: ZeroDivisionError: no cells", 1),
        ("bad feedback", "/drive failed: ConversionError: .*has no field", 1),
        ("bad result", "malformed reply: .*has no field .*reason", 0),
        ("bad value", "malformed reply: .*error_msg", 0),
    ],
)
def test_a_goal_whose_server_has_an_error_is_aborted_with_the_reason(
    pair: NodePair, error: str, reason: str, canceled: int
) -> None:
    faulty, ends = Faulty(pair), list[Any]()
    client = pair.client.action_client("/drive", NAVIGATE)
    until(lambda: client.ready, "the action is available")
    goal = pair.on(pair.client, lambda: client.send({"behavior_tree": error}, lambda *end: ends.append(end)))
    result = until(lambda: ends, "the goal ends")[0][1]
    assert goal.status is GoalState.ABORTED
    assert re.search(reason, result["error_msg"])
    assert len(faulty.canceled) == canceled, "what the server may have started is stopped"


def test_a_started_goal_is_accepted_even_if_the_server_does_not_return_true(pair: NodePair) -> None:
    faulty = Faulty(pair)
    client = pair.client.action_client("/drive", NAVIGATE)
    until(lambda: client.ready, "the action is available")
    goal = pair.on(pair.client, lambda: client.send({}, lambda *_end: None))
    until(lambda: goal.accepted, "the goal is accepted")
    pair.on(pair.client, goal.cancel)
    until(lambda: faulty.canceled, "the goal can be canceled")


def test_a_cancel_request_applies_to_one_goal_or_to_all(pair: NodePair) -> None:
    served = Served(pair)
    client = pair.client.action_client("/lookup", LOOKUP)
    until(lambda: client.ready, "the action is available")
    goals = [Sent(pair, client, "wait") for _ in range(3)]
    until(lambda: all(sent.goal.accepted for sent in goals), "all goals are accepted")
    served.may_cancel = False
    pair.on(pair.client, goals[0].goal.cancel)
    cancel = pair.client.client("/lookup/_action/cancel_goal", "action_msgs/srv/CancelGoal")
    until(lambda: cancel.ready, "the cancel_goal service is available")
    codes: list[Any] = []
    for uuid in (goals[0].goal.id, bytes([7] * 16)):
        cancel.call({"goal_info": {"goal_id": {"uuid": list(uuid)}}}, codes.append)
    until(lambda: len(codes) == 2, "both requests have a reply")
    assert [code["return_code"] for code in codes] == [1, 2]
    served.may_cancel = True
    pair.on(pair.client, goals[0].goal.cancel)
    goal = next(g for g in served.goals if g.id == goals[0].goal.id)
    until(lambda: goal.status is GoalState.CANCELING, "the goal is canceling")
    pair.on(pair.server, goal.canceled)
    assert goals[0].ended()[0] is GoalState.CANCELED
    pair.on(pair.client, client.cancel)
    until(lambda: all(g.cancel_wanted for g in served.goals), "the cancel request applies to all goals")
    pair.on(pair.server, lambda: [g.canceled() for g in served.goals])
    assert [sent.ended()[0] for sent in goals] == [GoalState.CANCELED] * 3


def test_a_request_to_cancel_all_goals_succeeds_without_goals_and_fails_if_all_are_refused(pair: NodePair) -> None:
    served = Served(pair)
    client = pair.client.action_client("/lookup", LOOKUP)
    cancel = pair.client.client(CANCEL_GOAL, "action_msgs/srv/CancelGoal")
    until(lambda: client.ready and cancel.ready, "the action is available")
    codes: list[Any] = []
    cancel.call({}, codes.append)
    until(lambda: codes, "the request has a reply")
    served.may_cancel = False
    sent = Sent(pair, client, "wait")
    until(lambda: sent.goal.accepted, "the goal is accepted")
    cancel.call({}, codes.append)
    until(lambda: len(codes) == 2, "the second request has a reply")
    assert [code["return_code"] for code in codes] == [CancelCode.NONE, CancelCode.REJECTED]
    pair.on(pair.server, lambda: served.goals[0].abort())


CANCEL_GOAL = "/lookup/_action/cancel_goal"


def until_canceling(pair: NodePair, client: ActionClient) -> None:
    """Wait until goals can be sent and canceled."""
    cancel = pair.client.client(CANCEL_GOAL, "action_msgs/srv/CancelGoal")
    until(lambda: client.ready and cancel.ready, "the action is available")


def record_cancel_requests(monkeypatch: pytest.MonkeyPatch, fails: Callable[[int], bool]) -> list[bytes]:
    """Record the goal ids of cancel requests; if ``fails(n)``, request ``n`` (from 1) fails like without a server."""
    requested, call = list[bytes](), ServiceClient.call

    def record_and_call(self: ServiceClient, request: dict[str, Any], replied: Callable[[Any], None]) -> Any:
        if self.topic != CANCEL_GOAL:
            return call(self, request, replied)
        requested.append(bytes(request["goal_info"]["goal_id"]["uuid"]))
        return replied(CallError("no server")) if fails(len(requested)) else call(self, request, replied)

    monkeypatch.setattr(ServiceClient, "call", record_and_call)
    return requested


def test_a_cancel_request_that_fails_is_repeated_until_the_server_responds(
    pair: NodePair, monkeypatch: pytest.MonkeyPatch
) -> None:
    served = Served(pair)
    client = pair.client.action_client("/lookup", LOOKUP)
    until_canceling(pair, client)
    sent = Sent(pair, client, "wait")
    ended = lambda: served.goals[0].status is GoalState.CANCELED  # noqa: E731
    requested = record_cancel_requests(monkeypatch, lambda count: count < 3 or ended())
    until(lambda: sent.goal.accepted, "the goal is accepted")
    pair.on(pair.client, sent.goal.cancel)
    until(lambda: served.goals[0].cancel_wanted, "the server has the cancel request")
    assert requested == [sent.goal.id] * 3
    pair.on(pair.server, served.goals[0].canceled)
    assert sent.ended()[0] is GoalState.CANCELED
    pair.on(pair.client, sent.goal.cancel)
    period_over = threading.Event()
    pair.client.loop.after(1.5 * CANCEL_AGAIN, period_over.set)
    assert period_over.wait(40)
    assert len(requested) == 4, "the request for a goal that has ended is not repeated"


def test_a_request_to_cancel_all_goals_is_repeated_until_a_goal_is_sent(
    pair: NodePair, monkeypatch: pytest.MonkeyPatch
) -> None:
    served = Served(pair)
    client = pair.client.action_client("/lookup", LOOKUP)
    until_canceling(pair, client)
    monkeypatch.setattr("bridge.client.actions.CANCEL_ALL_SECONDS", 60.0)
    requested = record_cancel_requests(monkeypatch, lambda count: count != 3)
    sent = Sent(pair, client, "wait")
    until(lambda: sent.goal.accepted, "the goal is accepted")
    pair.on(pair.client, client.cancel)
    until(lambda: served.goals[0].cancel_wanted, "the server has the cancel request")
    assert requested == [bytes(16)] * 3
    pair.on(pair.client, lambda: (client.cancel(), client.send({"target_frame": "wait"}, lambda *_end: None)))
    period_over = threading.Event()
    pair.client.loop.after(1.5 * CANCEL_AGAIN, period_over.set)
    assert period_over.wait(40)
    assert len(requested) == 4, "the new goal is not canceled"


def test_goals_abort_when_their_server_closes(pair: NodePair, monkeypatch: pytest.MonkeyPatch) -> None:
    requests, ask = list[None](), Goal.ask
    monkeypatch.setattr(Goal, "ask", lambda goal, answer: requests.append(ask(goal, answer)))
    Served(pair)
    client = pair.client.action_client("/lookup", LOOKUP)
    until(lambda: client.ready, "the action is available")
    sent = Sent(pair, client, "wait")
    until(lambda: requests, "the result is requested")
    pair.server.close()
    status, _, reason = sent.ended()
    assert status is GoalState.ABORTED
    assert "left" in reason


def test_cancel_by_time_includes_goals_accepted_before_the_clock_was_set_back(pair: NodePair) -> None:
    now = [1_790_000_000_000_000_000]
    pair.server.clock = RunClock(system=SystemClock(lambda: now[0], poll=0))
    served = Served(pair)
    client = pair.client.action_client("/lookup", LOOKUP)
    until(lambda: client.ready, "the action is available")
    early, late = Sent(pair, client, "wait"), None
    until(lambda: early.goal.accepted, "the early goal is accepted")
    now[0] -= 3_600_000_000_000
    until_ns = now[0] + 1_000_000_000
    now[0] += 2_000_000_000
    late = Sent(pair, client, "wait")
    until(lambda: late.goal.accepted, "the late goal is accepted")
    cancel = pair.client.client(CANCEL_GOAL, "action_msgs/srv/CancelGoal")
    until(lambda: cancel.ready, "the cancel_goal service is available")
    codes: list[Any] = []
    stamp = {"sec": until_ns // 10**9, "nanosec": 0}
    cancel.call({"goal_info": {"goal_id": {"uuid": [0] * 16}, "stamp": stamp}}, codes.append)
    until(lambda: codes, "the request has a reply")
    wanted = {goal.id: goal.cancel_wanted for goal in served.goals}
    assert wanted == {early.goal.id: True, late.goal.id: False}
    pair.on(pair.server, lambda: [goal.canceled() for goal in served.goals])
