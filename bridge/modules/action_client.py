"""Goals that a module sends to an action on the hub."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from bridge.hub.call import CallError
from bridge.hub.qos import Qos
from bridge.modules.goal import CANCEL, Status, parts

if TYPE_CHECKING:
    from bridge.modules.node import Node

FEEDBACK_DEPTH = 100

CANCEL_AGAIN = 0.2
"""Seconds after which a cancel whose call failed is asked for again."""

CANCEL_ALL_SECONDS = 5.0
"""For so long the cancellation of all goals is: whoever gives one later means it."""

Heard = Callable[[dict[str, Any]], None]


class SentGoal:
    """One goal; what it calls runs on the module's thread.

    Attributes:
        id: its 16 bytes.
        accepted: whether the server took it; None until it has said so.
        status: what is known of it; a terminal one once it has ended.
    """

    def __init__(self, client: ActionClient, goal_id: bytes, feedback: Heard | None, ended: Ended) -> None:
        self.id = goal_id
        self.accepted: bool | None = None
        self.status = Status.UNKNOWN
        self._client, self._ended = client, ended
        self.feedback = feedback
        self._cancel_wanted = False

    @property
    def active(self) -> bool:
        """Whether it has not ended, and its end would be heard of."""
        return self._client.has(self.id)

    def cancel(self) -> None:
        """Ask the server to cancel it; the end tells whether it did. On any thread.

        Before its acceptance is known here, which may wait for the module's thread, it is asked once more after that.
        """
        self._cancel_wanted = True
        if self.accepted is not False:
            self._client.cancel(self.id)

    def answered(self, reply: dict[str, Any] | CallError) -> None:
        """The server said whether it takes the goal."""
        if isinstance(reply, CallError):
            self.finish(Status.ABORTED, None, str(reply))
        elif not reply["accepted"]:
            self.accepted = False
            self.finish(Status.UNKNOWN, None, "the server rejected the goal")
        else:
            self.accepted, self.status = True, Status.EXECUTING
            self._client.ask_result(self)
            if self._cancel_wanted:
                self._client.cancel(self.id)

    def resulted(self, reply: dict[str, Any] | CallError) -> None:
        """The goal ended."""
        if isinstance(reply, CallError):
            self.finish(Status.ABORTED, None, str(reply))
        else:
            self.finish(Status(reply["status"]), reply["result"], "")

    def finish(self, status: Status, result: dict[str, Any] | None, why: str) -> None:
        """Tell of the end, once."""
        if self._client.forget(self.id):
            self.status = status
            self._ended(self, result, why)


Ended = Callable[[SentGoal, dict[str, Any] | None, str], None]
"""``ended(goal, result, why)``: once; without a result where ``why`` says what went wrong."""


class ActionClient:
    """Sends goals to one action; made by `bridge.modules.node.Node.action_client`."""

    def __init__(self, node: Node, name: str, type_name: str) -> None:
        self.name, self.type_name, self._node = name, type_name, node
        names, types = parts(name), parts(type_name, sep="_")
        self._send = node.client(names.send_goal, types.send_goal)
        self._result = node.client(names.get_result, types.get_result)
        self._cancel = node.client(names.cancel_goal, CANCEL)
        self._feedback = node.subscription(names.feedback, types.feedback, self._heard, Qos(depth=FEEDBACK_DEPTH))
        self._goals: dict[bytes, SentGoal] = {}
        self._sent = 0

    @property
    def ready(self) -> bool:
        """Whether there is a server."""
        return self._send.ready and self._result.ready

    def send(self, goal: Mapping[str, Any], ended: Ended, feedback: Heard | None = None) -> SentGoal:
        """Send a goal, under a new id.

        Raises:
            ConversionError: the goal has an unknown field, or a value that does not fit.
        """
        sent = SentGoal(self, uuid.uuid4().bytes, feedback, ended)
        self._goals[sent.id] = sent
        self._sent += 1
        try:
            self._send.call({"goal_id": {"uuid": list(sent.id)}, "goal": goal}, sent.answered)
        except BaseException:
            del self._goals[sent.id]
            raise
        return sent

    def ask_result(self, goal: SentGoal) -> None:
        """Ask for the result; it comes when the goal has ended."""
        self._result.call({"goal_id": {"uuid": list(goal.id)}}, goal.resulted)

    def cancel(self, goal_id: bytes = bytes(16)) -> None:
        """Ask the server to cancel a goal; zeros for all.

        A stop must not get lost where the server cannot be called for a moment, as while a bridge before it looks who
        is active: for a goal of its own it is asked until there is an answer, or the goal has ended; for all goals for
        a while, unless one is sent meanwhile.
        """
        wanted = partial(self.has, goal_id) if any(goal_id) else self._stopping()

        def answered(reply: dict[str, Any] | CallError) -> None:
            if isinstance(reply, CallError) and wanted():
                self._node.loop.after(CANCEL_AGAIN, lambda: ask() if wanted() else None)

        def ask() -> None:
            self._cancel.call({"goal_info": {"goal_id": {"uuid": list(goal_id)}}}, answered)

        ask()

    def _stopping(self) -> Callable[[], bool]:
        """Tells whether all goals are still to end that there were."""
        sent, until = self._sent, time.monotonic() + CANCEL_ALL_SECONDS
        return lambda: self._sent == sent and time.monotonic() < until

    def close(self) -> None:
        """Give its ends back; goals under way go on, and nothing more is heard of them."""
        self._goals.clear()
        self._sent += 1  # nothing is asked for again
        for end in (self._send, self._result, self._cancel, self._feedback):
            self._node.release(end)

    def has(self, goal_id: bytes) -> bool:
        """Whether a goal of its own is under way."""
        return goal_id in self._goals

    def forget(self, goal_id: bytes) -> bool:
        """The goal ended; whether it had not before."""
        return self._goals.pop(goal_id, None) is not None

    def _heard(self, message: dict[str, Any]) -> None:
        goal = self._goals.get(bytes(message["goal_id"]["uuid"]))
        if goal is not None and goal.feedback is not None:
            goal.feedback(message["feedback"])
