"""An action that a module serves on the hub (design.ros2.org/articles/actions.html)."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from itertools import islice
from typing import Any

import numpy as np

from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages import actions
from bridge.messages.actions import CANCEL, STATUSES, CancelCode, GoalState
from bridge.modules.endpoints import Endpoints
from bridge.modules.services import Answer

KEPT_SECONDS = 3600.0
"""How long a result is kept for whoever asks for it."""

MAX_KEPT = 10_000
MAX_TOLD = 100
"""Goals of which the status topic tells, at most: the newest."""

MAX_GOALS = 1000
"""Goals that have not ended, at most; further ones are rejected."""


class Goal:
    """One goal that came. Its methods are called on the module's thread.

    Attributes:
        id: its 16 bytes.
        goal: what is asked for.
        info: its id and stamp, as ``action_msgs/msg/GoalInfo``.
        status: its state.
        cancel_wanted: a client asked for its cancellation.
        client: GID of who sent it; empty where it does not say.
    """

    def __init__(
        self, server: ActionServer, goal_id: bytes, goal: dict[str, Any], stamp: dict[str, int], client: bytes = b""
    ) -> None:
        self.id, self.goal, self.stamp, self.client = goal_id, goal, stamp, client
        # an array of numpy is written many times as fast as a list, and the states of many goals are told at once
        self.info = {"goal_id": {"uuid": np.frombuffer(goal_id, np.uint8)}, "stamp": stamp}
        self.status = GoalState.ACCEPTED
        self.cancel_wanted = False
        self._server = server
        self._result: Mapping[str, Any] = {}
        self._asking: list[Answer] = []
        self.ended_at = 0.0

    @property
    def active(self) -> bool:
        """Whether it has not ended."""
        return not self.status.ended

    def execute(self) -> None:
        """It is being worked on."""
        self._change(GoalState.EXECUTING)

    def feedback(self, feedback: Mapping[str, Any]) -> None:
        """Tell its clients how far it is."""
        if self.active:
            self._server.publish_feedback(self.id, feedback)

    def succeed(self, result: Mapping[str, Any] | None = None) -> None:
        """It was reached."""
        self._end(GoalState.SUCCEEDED, result)

    def abort(self, result: Mapping[str, Any] | None = None) -> None:
        """It cannot be reached."""
        self._end(GoalState.ABORTED, result)

    def canceled(self, result: Mapping[str, Any] | None = None) -> None:
        """It was given up, as a client asked for."""
        self._end(GoalState.CANCELED, result)

    def ask(self, answer: Answer) -> None:
        """Answer with the result, once there is one."""
        if self.active:
            self._asking.append(answer)
        else:
            answer({"status": int(self.status), "result": self._result})

    def begin_cancel(self) -> None:
        """A client's cancellation was taken."""
        self.cancel_wanted = True
        self._change(GoalState.CANCELING)

    def _end(self, status: GoalState, result: Mapping[str, Any] | None) -> None:
        if not self.active:
            return
        self._result = result or {}
        self.ended_at = time.monotonic()
        self._server.ended(self)
        self._change(status)
        asking, self._asking = self._asking, []
        for answer in asking:
            self.ask(answer)

    def _change(self, status: GoalState) -> None:
        if self.active:
            self.status = status
            self._server.tell_status()


Take = Callable[[Goal], bool]
"""``take(goal)``: whether a goal is accepted; it may be worked on, or end, at once or later."""

Cancel = Callable[[Goal], bool]
"""``cancel(goal)``: whether its cancellation is begun; the goal is then to end by `Goal.canceled`, or otherwise."""

Brake = Callable[[bytes], None]
"""``brake(goal_id)``: a cancellation has come, of all goals where the id is zeros. On a thread of the hub, at once: the
module's own may be busy."""


class ActionServer:
    """Serves one action; made by `bridge.modules.host.ModuleNode.action_server`. All runs on the module's thread."""

    def __init__(
        self,
        node: Endpoints,
        name: str,
        type_name: str,
        take: Take,
        cancel: Cancel | None = None,
        *,
        kept: float = KEPT_SECONDS,
        brake: Brake | None = None,
    ) -> None:
        self.name, self.type_name = name, type_name
        self._node, self._take, self._cancel, self._kept = node, take, cancel, kept
        self._goals: dict[bytes, Goal] = {}
        self._active: dict[bytes, Goal] = {}
        self._ended: deque[Goal] = deque()
        self._starting = False
        names, types = actions.names(name), actions.types(type_name)
        self._status = node.publisher(names.status, STATUSES, LATCHED, priority="state")
        self._feedback = node.publisher(names.feedback, types.feedback, Qos(depth=100))
        at_once = None if brake is None else lambda request: _brake(brake, request["goal_info"])
        self._others = (
            node.server(names.get_result, types.get_result, self._asked),
            node.server(names.cancel_goal, CANCEL, self._cancelled, at_once),
        )
        self._sending = node.server(names.send_goal, types.send_goal, self._sent)
        self.accepting = True  # whether new goals are served
        self._clients_of = names.send_goal
        self.met: Callable[[Goal], object] = lambda _goal: None  # called with each goal as it comes
        self.tell_status()  # at once: who reads it knows then that there are no goals

    @property
    def active(self) -> list[Goal]:
        """The goals that have not ended, the oldest first."""
        return list(self._active.values())

    def stop_accepting(self) -> None:
        """Serve no new goals, for good: another server has the name. The active ones go on to their end."""
        if self.accepting:
            self.accepting = False
            self._node.release(self._sending)

    def close(self) -> None:
        """Close all five parts of the action."""
        self.stop_accepting()
        for endpoint in (*self._others, self._feedback, self._status):
            self._node.release(endpoint)

    @property
    def clients(self) -> int:
        """How many there are on the hub who could send goals."""
        return len(self._node.hub.graph.clients(self._clients_of))

    def publish_feedback(self, goal_id: bytes, feedback: Mapping[str, Any]) -> None:
        """Tell how far a goal is."""
        self._feedback.publish({"goal_id": {"uuid": list(goal_id)}, "feedback": feedback})

    def tell_status(self) -> None:
        """Publish the states of all goals that have not ended or did so lately."""
        if self._starting:
            return
        self._expire()
        told = reversed(list(islice(reversed(self._goals.values()), MAX_TOLD)))
        self._status.publish({"status_list": [{"goal_info": g.info, "status": int(g.status)} for g in told]})

    def _sent(self, request: dict[str, Any], answer: Answer) -> None:
        goal_id = bytes(request["goal_id"]["uuid"])
        stamp = self._node.clock.stamp()
        if goal_id in self._goals or len(self._active) >= MAX_GOALS:
            answer({"accepted": False, "stamp": stamp})
            return
        goal = self._goals[goal_id] = self._active[goal_id] = Goal(
            self, goal_id, request["goal"], stamp, self._sending.caller
        )
        self._starting = True
        self.met(goal)
        try:
            accepted = self._take(goal)
        except BaseException:
            self._forget(goal)
            raise
        finally:
            self._starting = False
        if not accepted:
            self._forget(goal)
        answer({"accepted": accepted, "stamp": stamp})
        if accepted:
            self.tell_status()

    def _asked(self, request: dict[str, Any], answer: Answer) -> None:
        goal = self._goals.get(bytes(request["goal_id"]["uuid"]))
        if goal is not None:
            goal.ask(answer)
        elif self.accepting:  # else another server has the name, and answers
            answer({"status": int(GoalState.UNKNOWN), "result": {}})

    def _cancelled(self, request: dict[str, Any], answer: Answer) -> None:
        info = request["goal_info"]
        goal_id, until = bytes(info["goal_id"]["uuid"]), _nanoseconds(info["stamp"])
        one = self._goals.get(goal_id)
        wanted = [g for g in self.active if (until and _nanoseconds(g.stamp) <= until) or g is one]
        if not any(goal_id) and not until:
            wanted = self.active
        begun = [goal for goal in wanted if goal.cancel_wanted or self._begin_cancel(goal)]
        code = CancelCode.NONE if begun else CancelCode.REJECTED
        if any(goal_id) and not begun:
            code = (
                CancelCode.UNKNOWN_GOAL_ID
                if one is None
                else CancelCode.REJECTED
                if one.active
                else CancelCode.GOAL_TERMINATED
            )
        answer({"return_code": code, "goals_canceling": [goal.info for goal in begun]})

    def _begin_cancel(self, goal: Goal) -> bool:
        if self._cancel is None or not self._cancel(goal):
            return False
        if goal.active:
            goal.begin_cancel()
        return True

    def ended(self, goal: Goal) -> None:
        """A goal has its result."""
        if self._active.pop(goal.id, None) is not None:
            self._ended.append(goal)

    def _forget(self, goal: Goal) -> None:
        """A goal that was not accepted."""
        del self._goals[goal.id]
        self._active.pop(goal.id, None)

    def _expire(self) -> None:
        long_ago = time.monotonic() - self._kept
        while self._ended and (len(self._ended) > MAX_KEPT or self._ended[0].ended_at < long_ago):
            goal = self._ended.popleft()
            if self._goals.get(goal.id) is goal:
                del self._goals[goal.id]


def _brake(brake: Brake, info: Mapping[str, Any]) -> None:
    goal_id = bytes(info["goal_id"]["uuid"])
    if any(goal_id) or not _nanoseconds(info["stamp"]):
        brake(goal_id)


def _nanoseconds(stamp: Mapping[str, int]) -> int:
    return stamp["sec"] * 1_000_000_000 + stamp["nanosec"]
