"""The goals of one action on the hub, and which of them have to end."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from bridge.client.services import Replied
from bridge.hub.endpoints.calls import CallError
from bridge.hub.wire.qos import LATCHED
from bridge.messages.actions import CANCEL, STATUSES, CancelCode, GoalState, names
from bridge.modules.host import Host
from navigation.gateway.goal_list import GoalList
from navigation.messages import Message

_MAX_CANCELED = 1000  # goals that have to end; the oldest are dropped
_CANCEL_PERIOD = 1.0  # seconds between two requests to cancel a goal


class ActionGoals:
    """The goals of one action; those that have to end are canceled until the server's list shows their end."""

    def __init__(self, host: Host, action: str, *, always: bool, changed: Callable[[bool], None]) -> None:
        self._host, self._changed = host, changed  # called with whether the list differs from the previous one
        self.action, parts = action, names(action)
        self._status = parts.status
        self.list = GoalList(always=always)
        self._to_end: dict[bytes, None] = {}
        self._asked: dict[bytes, float] = {}
        self._end_next = False  # goals have to end that a valid list may show only later
        self._ask_all_at = 0.0  # when to request that (monotonic), as soon as the list is valid
        self._all_request = object()  # the last request to cancel all goals, whose failure counts
        self._client = host.node.client(parts.cancel_goal, CANCEL)
        self._subscription = host.node.subscription(self._status, STATUSES, self._on_list, LATCHED)

    @property
    def is_present(self) -> bool:
        """Whether the action has a server that can be asked to cancel."""
        return self._client.ready

    @property
    def left(self) -> tuple[bytes, ...]:
        """The goals that have to end, and are still in the newest list."""
        return tuple(goal for goal in self.list.active if goal in self._to_end)

    @property
    def released(self) -> bool:
        """Whether a valid list shows that all goals that have to end have ended."""
        return self.list.known and not self.left and not self._end_next

    def end(self, goal: bytes) -> None:
        """Cancel a goal as soon as the server is available, and again until its list shows the end."""
        self._to_end[goal] = None
        while len(self._to_end) > _MAX_CANCELED:
            del self._to_end[next(iter(self._to_end))]

    def end_all(self) -> None:
        """Cancel all goals of the server; if they are unknown or this fails, again once its list is valid."""
        for goal in self.list.active:
            self.end(goal)
        self._end_next, self._ask_all_at = not (self.is_present and self.list.known), 0.0
        self._ask_all()

    def end_no_more(self) -> None:
        """End the stop: goals that appear from now on may continue."""
        self._end_next, self._all_request = False, object()

    def spare(self, goal: bytes) -> None:
        """Let a goal that was sent after the stop continue."""
        self.end_no_more()
        self._to_end.pop(goal, None)

    def refresh(self) -> None:
        """Check which servers are available, and cancel again the goals that have to end."""
        self.list.refresh([publisher.gid for publisher in self._host.node.hub.graph.publishers(self._status)])
        if not self.is_present:
            self._asked.clear()
            return
        now = time.monotonic()
        if self._end_next and self.list.known:
            for goal in self.list.active:
                self.end(goal)
            if now >= self._ask_all_at:
                self._ask_all_at = now + _CANCEL_PERIOD
                self._ask_all()
        left = self.left
        self._asked = {goal: due for goal, due in self._asked.items() if goal in left}
        for goal in left:
            if now >= self._asked.get(goal, 0.0):
                self._asked[goal] = now + _CANCEL_PERIOD
                self._ask(goal)

    def close(self) -> None:
        for endpoint in (self._client, self._subscription):
            self._host.node.release(endpoint)

    def _ask(self, goal: bytes, replied: Replied = lambda _reply: None) -> None:
        if self.is_present:
            self._client.call({"goal_info": {"goal_id": {"uuid": list(goal)}}}, replied)

    def _ask_all(self) -> None:
        """Request to cancel all goals; if that fails, goals may continue that the list does not show yet.

        After a failure, and for a server that was absent, its reply is awaited: an empty list does not replace it.
        """
        request = self._all_request = object()
        known = self.list.known  # otherwise goals of the next valid list have to end, whatever the reply

        def replied(reply: Any) -> None:
            if self._all_request is not request:
                return
            if isinstance(reply, CallError) or reply["return_code"] == CancelCode.REJECTED:
                self._end_next, self._ask_all_at = True, time.monotonic() + _CANCEL_PERIOD
            elif known:
                self._end_next = False

        self._ask(bytes(16), replied)

    def _on_list(self, message: Message) -> None:
        statuses = {
            bytes(entry["goal_info"]["goal_id"]["uuid"]): GoalState.parse(entry["status"])
            for entry in message["status_list"]
        }
        differs = self.list.receive(self._subscription.sender, statuses)
        self.refresh()  # a goal that has to end is canceled before anything else happens
        self._changed(differs)
