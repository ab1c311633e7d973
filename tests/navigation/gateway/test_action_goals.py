"""The goals of one action that have to end, with a server whose replies to cancel requests the tests choose."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.hub.endpoints.calls import CallError
from bridge.messages.actions import CancelCode, GoalState
from navigation.gateway import action_goals
from navigation.gateway.action_goals import ActionGoals

ALL, LATE, OWN = bytes(16), bytes([1] * 16), bytes([2] * 16)
DONE, REJECTED = ({"return_code": code, "goals_canceling": []} for code in (CancelCode.NONE, CancelCode.REJECTED))
LOST = CallError("the server left before it answered")


class Server:
    """A server that is present, and whose list is valid; it records the requests to cancel goals."""

    def __init__(self) -> None:
        self.ready, self.sender = True, b"server"
        self.requests: list[tuple[bytes, Callable[[Any], None]]] = []
        node = SimpleNamespace(
            client=lambda _name, _type: self,
            subscription=self._subscribe,
            hub=SimpleNamespace(graph=SimpleNamespace(publishers=lambda _topic: [SimpleNamespace(gid=self.sender)])),
        )
        self.goals = ActionGoals(cast("Any", SimpleNamespace(node=node)), "/act", always=True, changed=lambda _: None)
        self.publish_list()

    def _subscribe(self, _topic: str, _type: str, receive: Callable[[Any], None], _qos: object) -> Server:
        self._receive = receive
        return self

    def call(self, request: dict[str, Any], replied: Callable[[Any], None]) -> None:
        self.requests.append((bytes(request["goal_info"]["goal_id"]["uuid"]), replied))

    def publish_list(self, *goals: bytes) -> None:
        """Publish a list of executing goals."""
        entries = [{"goal_info": {"goal_id": {"uuid": list(goal)}}, "status": GoalState.EXECUTING} for goal in goals]
        self._receive({"status_list": entries})

    @property
    def asked(self) -> list[bytes]:
        """The goals that the server was asked to cancel."""
        return [goal for goal, _ in self.requests]


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Server:
    monkeypatch.setattr(action_goals, "_CANCEL_PERIOD", 0.0)
    return Server()


@pytest.mark.parametrize("failure", [LOST, REJECTED])
def test_a_failed_request_to_cancel_all_goals_is_repeated(server: Server, failure: object) -> None:
    """The server may have a goal that its list does not show yet; the bridge to it may be on standby for a moment."""
    server.goals.end_all()
    assert server.asked == [ALL]
    assert server.goals.released
    server.requests[0][1](failure)
    assert not server.goals.released
    server.goals.refresh()
    assert server.asked == [ALL, ALL]
    assert not server.goals.released, "an empty list does not replace the reply"
    server.requests[1][1](failure)
    server.publish_list(LATE)
    assert server.asked[2:] == [ALL, LATE]
    server.requests[2][1](DONE)
    server.publish_list()
    assert server.goals.released
    assert len(server.requests) == 4


def test_a_request_to_cancel_all_goals_is_sent_to_a_server_that_returns(server: Server) -> None:
    server.ready = False
    server.goals.end_all()
    server.goals.refresh()
    assert server.asked == []
    assert not server.goals.released
    server.ready = True
    server.goals.refresh()
    assert server.asked == [ALL]
    assert not server.goals.released
    server.requests[0][1](DONE)
    assert server.goals.released


@pytest.mark.parametrize("replied_before", [True, False])
def test_goals_that_are_sent_after_the_stop_are_not_canceled(server: Server, *, replied_before: bool) -> None:
    server.goals.end_all()
    steps = [lambda: server.requests[0][1](LOST), lambda: server.goals.spare(OWN)]
    for step in steps if replied_before else reversed(steps):
        step()
    server.publish_list(OWN)
    assert server.asked == [ALL]
    assert server.goals.released
