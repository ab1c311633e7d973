"""An action that a module serves on the hub (design.ros2.org/articles/actions.html)."""

from __future__ import annotations

import contextlib
import logging
import time
import uuid
from collections import deque
from collections.abc import Callable, Mapping
from itertools import islice
from typing import Any

import numpy as np

from bridge.hub.endpoints.calls import CallError
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages import actions
from bridge.messages.actions import CANCEL, STATUSES, CancelCode, GoalState
from bridge.modules.endpoints import Endpoints
from bridge.modules.services import Answer

_log = logging.getLogger(__name__)

RESULT_SECONDS = 3600.0
"""Seconds for which a result is stored for clients that request it."""

MAX_RESULTS = 10_000
MAX_STATUSES = 100
"""Maximum number of goals in a status message."""

MAX_GOALS = 1000
"""Maximum number of active goals; further goals are rejected."""


class Goal:
    """A received goal. Its methods are called on the module's thread.

    Attributes:
        id: the goal id, 16 bytes.
        goal: the goal message.
        info: id and timestamp, as ``action_msgs/msg/GoalInfo``.
        status: the current state.
        cancel_wanted: whether a client requested cancellation.
        client: GID of the action client; empty if unknown.
        local: whether the module itself began the goal (`ActionServer.begin`).
    """

    def __init__(
        self, server: ActionServer, goal_id: bytes, goal: dict[str, Any], stamp: dict[str, int], client: bytes = b""
    ) -> None:
        self.id, self.goal, self.stamp, self.client = goal_id, goal, stamp, client
        # a numpy array serializes many times faster than a list, and a status message holds many goals
        self.info = {"goal_id": {"uuid": np.frombuffer(goal_id, np.uint8)}, "stamp": stamp}
        self.status = GoalState.ACCEPTED
        self.cancel_wanted = False
        self.local = False
        self._server = server
        self._result: Mapping[str, Any] = {}
        self._result_requests: list[Answer] = []
        self.ended_at = 0.0

    @property
    def active(self) -> bool:
        """Whether the goal has not ended."""
        return not self.status.ended

    def execute(self) -> None:
        """Mark the goal as executing."""
        self._change(GoalState.EXECUTING)

    def feedback(self, feedback: Mapping[str, Any]) -> None:
        """Publish feedback to the clients."""
        if self.active:
            self._server.publish_feedback(self.id, feedback)

    def succeed(self, result: Mapping[str, Any] | None = None) -> None:
        """End the goal as succeeded."""
        self._end(GoalState.SUCCEEDED, result)

    def abort(self, result: Mapping[str, Any] | None = None) -> None:
        """End the goal as aborted."""
        self._end(GoalState.ABORTED, result)

    def canceled(self, result: Mapping[str, Any] | None = None) -> None:
        """End the goal as canceled, at a client's request."""
        self._end(GoalState.CANCELED, result)

    def ask(self, answer: Answer) -> None:
        """Send the result to a client, now or as soon as the goal has ended."""
        if self.active:
            self._result_requests.append(answer)
        else:
            answer({"status": int(self.status), "result": self._result})

    def begin_cancel(self) -> None:
        """Accept a client's cancel request."""
        self.cancel_wanted = True
        self._change(GoalState.CANCELING)

    def _end(self, status: GoalState, result: Mapping[str, Any] | None) -> None:
        if not self.active:
            return
        self._result = self._server.checked(result or {})
        self.ended_at = time.monotonic()
        self._server.on_end(self)
        self._change(status)
        requests, self._result_requests = self._result_requests, []
        for answer in requests:
            self.ask(answer)

    def _change(self, status: GoalState) -> None:
        if self.active:
            self.status = status
            self._server.publish_status()


AcceptGoal = Callable[[Goal], bool]
"""``accept(goal)`` returns whether the goal is accepted; the goal may start or end immediately or later.

A goal that it has started or ended is accepted, whatever it returns. If it raises an exception, the goal is canceled
and aborted, with the exception as ``error_msg`` of the result if the type has this field.
"""

Cancel = Callable[[Goal], bool]
"""``cancel(goal)`` returns whether cancellation starts; the goal must then end, normally by `Goal.canceled`."""

Brake = Callable[[bytes], None]
"""``brake(goal_id)`` is called at once for each request to cancel one goal or (with an id of zeros) all. It runs on a
thread of the hub, because the module's thread may be busy."""


class ActionServer:
    """Serves one action, on the module's thread; created by `bridge.modules.host.ModuleNode.action_server`."""

    def __init__(
        self,
        node: Endpoints,
        name: str,
        type_name: str,
        accept: AcceptGoal,
        cancel: Cancel | None = None,
        *,
        result_seconds: float = RESULT_SECONDS,
        brake: Brake | None = None,
    ) -> None:
        self.name, self.type_name = name, type_name
        self._node, self._accept, self._cancel, self._result_seconds = node, accept, cancel, result_seconds
        self._goals: dict[bytes, Goal] = {}
        self._active: dict[bytes, Goal] = {}
        self._ended: deque[Goal] = deque()
        self._starting = False
        names, types = actions.names(name), actions.types(type_name)
        self._status = node.publisher(names.status, STATUSES, LATCHED, priority="state")
        self._feedback = node.publisher(names.feedback, types.feedback, Qos(depth=100))
        at_once = None if brake is None else lambda request: _brake(brake, request["goal_info"])
        self._results = node.server(names.get_result, types.get_result, self._on_result_request)
        self._others = self._results, node.server(names.cancel_goal, CANCEL, self._on_cancel, at_once)
        self._sending = node.server(names.send_goal, types.send_goal, self._on_goal)
        self.accepting = True  # whether new goals are accepted
        self.closed = False
        self._clients_of = names.send_goal
        self.met: Callable[[Goal], object] = lambda _goal: None  # called with each new goal
        self.publish_status()  # an empty list, which informs subscribers that no goal is active

    @property
    def active(self) -> list[Goal]:
        """The goals that have not ended, oldest first."""
        return list(self._active.values())

    def stop_accepting(self) -> None:
        """Stop accepting goals permanently, because another server has the name; active goals run until they end."""
        if self.accepting:
            self.accepting = False
            self._node.release(self._sending)

    def close(self) -> None:
        """Close all five parts of the action."""
        self.stop_accepting()
        self.closed = True
        for endpoint in (*self._others, self._feedback, self._status):
            self._node.release(endpoint)

    @property
    def clients(self) -> int:
        """Number of action clients on the hub."""
        return len(self._node.hub.graph.clients(self._clients_of))

    def publish_feedback(self, goal_id: bytes, feedback: Mapping[str, Any]) -> None:
        """Publish the feedback of a goal."""
        self._feedback.publish({"goal_id": {"uuid": list(goal_id)}, "feedback": feedback})

    def publish_status(self) -> None:
        """Publish the states of `MAX_STATUSES` goals: the newest active ones, and those that ended last."""
        if self._starting:
            return
        self._expire()
        active = list(islice(reversed(self._active.values()), MAX_STATUSES))
        ended = list(islice(reversed(self._ended), MAX_STATUSES - len(active)))
        goals = [*reversed(ended), *reversed(active)]
        self._status.publish({"status_list": [{"goal_info": g.info, "status": int(g.status)} for g in goals]})

    def begin(self) -> Goal:
        """Return a new goal for a request that did not use the action; its clients see the goal and can cancel it."""
        goal_id = uuid.uuid4().bytes
        goal = self._goals[goal_id] = self._active[goal_id] = Goal(self, goal_id, {}, self._node.clock.stamp())
        goal.local = True
        return goal

    def _on_goal(self, request: dict[str, Any], answer: Answer) -> None:
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
            accepted = bool(self._accept(goal)) or goal.status is not GoalState.ACCEPTED
        except Exception as err:
            self._fail(goal, err)
            accepted = True
        finally:
            self._starting = False
        if not accepted:
            self._drop(goal)
        answer({"accepted": accepted, "stamp": stamp})
        if accepted:
            self.publish_status()

    def _fail(self, goal: Goal, err: Exception) -> None:
        """Abort a goal whose start has failed, and stop what it may have started.

        If the result has no field for the reason, the client gets the exception as the error of its request.
        """
        self._stop_quietly(goal)
        reason = {"error_msg": f"{self.name} failed: {type(err).__name__}: {err}"}
        if not self._fits(reason):
            self._drop(goal)
            raise err
        _log.error("%s failed", self.name, exc_info=err)
        goal.abort(reason)

    def fail_goals(self, text: str) -> None:
        """Abort all active goals with a reason, and stop what they have started."""
        reason = {"error_msg": text}
        for goal in self.active:
            self._stop_quietly(goal)
            goal.abort(reason if self._fits(reason) else {})

    def _stop_quietly(self, goal: Goal) -> None:
        if self._cancel is not None:
            with contextlib.suppress(Exception):
                self._cancel(goal)

    def _fits(self, result: Mapping[str, Any]) -> bool:
        return self._results.fits({"status": 0, "result": result})

    def checked(self, result: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return a goal's result, or the reason why it cannot be sent to clients."""
        reply = self._results.encode({"status": 0, "result": result})
        if not isinstance(reply, CallError):
            return result
        _log.error("%s", reply)
        reason = {"error_msg": str(reply)}
        return reason if self._fits(reason) else {}

    def _on_result_request(self, request: dict[str, Any], answer: Answer) -> None:
        goal = self._goals.get(bytes(request["goal_id"]["uuid"]))
        if goal is not None:
            goal.ask(answer)
        elif self.accepting:  # otherwise another server with this name responds
            answer({"status": int(GoalState.UNKNOWN), "result": {}})

    def _on_cancel(self, request: dict[str, Any], answer: Answer) -> None:
        info = request["goal_info"]
        goal_id, until = bytes(info["goal_id"]["uuid"]), _nanoseconds(info["stamp"])
        goal = self._goals.get(goal_id)
        now = self._node.clock.now_ns()  # a goal with a later stamp was accepted before the clock was set back
        wanted = [g for g in self.active if (until and not until < _nanoseconds(g.stamp) <= now) or g is goal]
        if not any(goal_id) and not until:
            wanted = self.active
        begun = [g for g in wanted if g.cancel_wanted or self._begin_cancel(g)]
        code = CancelCode.NONE if begun or not wanted else CancelCode.REJECTED  # as in rclcpp
        if any(goal_id) and not begun:
            code = (
                CancelCode.UNKNOWN_GOAL_ID
                if goal is None
                else CancelCode.REJECTED
                if goal.active
                else CancelCode.GOAL_TERMINATED
            )
        answer({"return_code": code, "goals_canceling": [g.info for g in begun]})

    def _begin_cancel(self, goal: Goal) -> bool:
        if self._cancel is None or not self._cancel(goal):
            return False
        if goal.active:
            goal.begin_cancel()
        return True

    def on_end(self, goal: Goal) -> None:
        """Update the list of goals after one has ended."""
        if self._active.pop(goal.id, None) is not None:
            self._ended.append(goal)

    def _drop(self, goal: Goal) -> None:
        """Drop a goal that was not accepted."""
        del self._goals[goal.id]
        self._active.pop(goal.id, None)

    def _expire(self) -> None:
        long_ago = time.monotonic() - self._result_seconds
        while self._ended and (len(self._ended) > MAX_RESULTS or self._ended[0].ended_at < long_ago):
            goal = self._ended.popleft()
            if self._goals.get(goal.id) is goal:
                del self._goals[goal.id]


def _brake(brake: Brake, info: Mapping[str, Any]) -> None:
    goal_id = bytes(info["goal_id"]["uuid"])
    if any(goal_id) or not _nanoseconds(info["stamp"]):
        brake(goal_id)


def _nanoseconds(stamp: Mapping[str, int]) -> int:
    return stamp["sec"] * 1_000_000_000 + stamp["nanosec"]
