"""Clients of actions on the hub; their callbacks run on one thread, such as a module's."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol

from bridge.client.services import ServiceClient
from bridge.hub.endpoints.calls import CallError, UnsentCallError
from bridge.hub.wire.qos import Qos
from bridge.messages import actions
from bridge.messages.actions import CANCEL, GoalState

FEEDBACK_DEPTH = 100
_GOAL_ID = slice(4, 20)
"""Position of the goal's id in a feedback message, after the encapsulation header."""

CANCEL_AGAIN = 0.2
"""Seconds after which a failed cancel request is repeated."""

CANCEL_ALL_SECONDS = 5.0
"""Seconds for which a request to cancel all goals is repeated, at most until a new goal is sent, which must stay."""

OnMessage = Callable[[dict[str, Any]], None]


class SentGoal:
    """One sent goal; its callbacks run on the module's thread."""

    def __init__(self, client: ActionClient, goal_id: bytes, feedback: OnMessage | None, ended: Ended) -> None:
        self.id = goal_id  # 16 bytes
        self.accepted: bool | None = None  # whether the server accepted it; None before its response
        self.status = GoalState.UNKNOWN  # last known status; a terminal one once the goal has ended
        self._client, self._ended = client, ended
        self.feedback = feedback
        self._cancel_wanted = False

    @property
    def active(self) -> bool:
        """Whether the goal has not ended, and the client still waits for its result."""
        return self._client.has(self.id)

    def cancel(self) -> None:
        """Request cancellation, from any thread, and again once the server accepts the goal.

        The goal's end shows whether it was canceled.
        """
        self._cancel_wanted = True
        if self.accepted is not False:
            self._client.cancel(self.id)

    def answered(self, reply: dict[str, Any] | CallError) -> None:
        """Handle the server's response to the goal request."""
        if isinstance(reply, UnsentCallError):
            self.accepted = False
            self.finish(GoalState.UNKNOWN, None, str(reply))
        elif isinstance(reply, CallError):
            self.finish(GoalState.ABORTED, None, str(reply))
        elif not reply["accepted"]:
            self.accepted = False
            self.finish(GoalState.UNKNOWN, None, "the server rejected the goal")
        else:
            self.accepted, self.status = True, GoalState.EXECUTING
            self._client.ask_result(self)
            if self._cancel_wanted:
                self._client.cancel(self.id)

    def resulted(self, reply: dict[str, Any] | CallError) -> None:
        """Handle the server's result response."""
        if isinstance(reply, CallError):
            self.finish(GoalState.ABORTED, None, str(reply))
        elif reply["status"] == GoalState.UNKNOWN:
            reason = str(reply["result"].get("error_msg", ""))
            if reason:  # from a bridge that cannot reach the server
                self.finish(GoalState.ABORTED, None, reason)
            else:
                self.finish(GoalState.UNKNOWN, None, "the server does not know the goal, or cannot be reached")
        else:
            self.finish(GoalState(reply["status"]), reply["result"], "")

    def finish(self, status: GoalState, result: dict[str, Any] | None, why: str) -> None:
        """Report the end of the goal, once."""
        if self._client.drop(self.id):
            self.status = status
            self._ended(self, result, why)


Ended = Callable[[SentGoal, dict[str, Any] | None, str], None]
"""``ended(goal, result, why)``: called once; on failure ``result`` is None and ``why`` gives the reason."""


class CallingNode(Protocol):
    """The part of a node that an action client needs; see `bridge.modules.host.ModuleNode`."""

    hub: Any
    loop: Any

    def client(self, name: str, type_name: str) -> ServiceClient:
        """Create a service client."""

    def subscription_cdr(self, topic: str, type_name: str, on_message: Callable[[bytes], None], qos: Qos) -> Any:
        """Receive a topic's messages as CDR."""

    def decode(self, type_name: str, cdr: bytes) -> dict[str, Any]:
        """Decode a message."""

    def release(self, end: Any) -> None:
        """Close one endpoint."""


class ActionClient:
    """A client of one action, created by `bridge.modules.host.ModuleNode.action_client`."""

    def __init__(self, node: CallingNode, name: str, type_name: str) -> None:
        self.name, self.type_name, self._node = name, type_name, node
        names, types = actions.names(name), actions.types(type_name)
        self._topics = (names.feedback, names.status)
        self._send = node.client(names.send_goal, types.send_goal)
        self._result = node.client(names.get_result, types.get_result)
        self._cancel = node.client(names.cancel_goal, CANCEL)
        self._feedback_type = types.feedback
        depth = Qos(depth=FEEDBACK_DEPTH)
        self._feedback = node.subscription_cdr(names.feedback, types.feedback, self._on_feedback, depth)
        self._goals: dict[bytes, SentGoal] = {}
        self._sent = 0

    @property
    def ready(self) -> bool:
        """Whether a server is ready: all five parts of the action are on the hub."""
        services = self._send.ready and self._result.ready and self._cancel.ready
        return services and all(map(self._node.hub.graph.publishers, self._topics))

    def send(
        self, goal: Mapping[str, Any], ended: Ended, feedback: OnMessage | None = None, goal_id: bytes = b""
    ) -> SentGoal:
        """Send a goal, under a given 16-byte id or a new one; raises `ConversionError` if it does not fit its type."""
        sent = SentGoal(self, goal_id or uuid.uuid4().bytes, feedback, ended)
        self._goals[sent.id] = sent
        self._sent += 1
        try:
            self._send.call({"goal_id": {"uuid": list(sent.id)}, "goal": goal}, sent.answered)
        except BaseException:
            del self._goals[sent.id]
            raise
        return sent

    def follow(self, goal: SentGoal) -> None:
        """After a lost connection, track a goal again that the server still executes."""
        goal.accepted, goal.status = True, GoalState.EXECUTING
        self._goals[goal.id] = goal
        self.ask_result(goal)

    def ask_result(self, goal: SentGoal) -> None:
        """Request the result, which the server sends when the goal has ended."""
        self._result.call({"goal_id": {"uuid": list(goal.id)}}, goal.resulted)

    def cancel(self, goal_id: bytes = bytes(16)) -> None:
        """Ask the server to cancel a goal; an id of zeros means all goals.

        A stop must not be lost if the server is briefly unreachable, for example while a bridge determines which daemon
        is active. The request for one of this client's goals is repeated until the server responds or the goal has
        ended; the request for all goals is repeated for `CANCEL_ALL_SECONDS`, unless a new goal is sent.
        """
        wanted = partial(self.has, goal_id) if any(goal_id) else self._cancel_all_applies()

        def answered(reply: dict[str, Any] | CallError) -> None:
            if isinstance(reply, CallError) and wanted():
                self._node.loop.after(CANCEL_AGAIN, lambda: ask() if wanted() else None)

        def ask() -> None:
            self._cancel.call({"goal_info": {"goal_id": {"uuid": list(goal_id)}}}, answered)

        ask()

    def cancel_starting(self) -> None:
        """Cancel the goals that the server has not accepted yet: they may arrive there after a stop."""
        for goal in list(self._goals.values()):
            if goal.accepted is None:
                goal.cancel()

    def _cancel_all_applies(self) -> Callable[[], bool]:
        """Return a function that returns whether the request to cancel all goals still applies."""
        sent, until = self._sent, time.monotonic() + CANCEL_ALL_SECONDS
        return lambda: self._sent == sent and time.monotonic() < until

    def close(self) -> None:
        """Close the endpoints; active goals continue on the server, without callbacks here."""
        self._goals.clear()
        self._sent += 1  # ends the repetition of cancel requests
        for end in (self._send, self._result, self._cancel, self._feedback):
            self._node.release(end)

    def has(self, goal_id: bytes) -> bool:
        """Whether this client has sent the goal and it has not ended."""
        return goal_id in self._goals

    def drop(self, goal_id: bytes) -> bool:
        """Drop an ended goal; return False if it was dropped before."""
        return self._goals.pop(goal_id, None) is not None

    def _on_feedback(self, cdr: bytes) -> None:
        goal = self._goals.get(cdr[_GOAL_ID])  # clients receive the feedback of all goals
        if goal is not None and goal.feedback is not None:
            goal.feedback(self._node.decode(self._feedback_type, cdr)["feedback"])
