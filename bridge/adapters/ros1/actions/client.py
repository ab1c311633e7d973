"""An actionlib client that turns calls of a ROS 2 action into goals of an actionlib server.

It uses no threads, sockets or system clock; an `InlineExecutor` passes it one event at a time.
For the behavior of actionlib servers see https://github.com/ros/actionlib (1.14), ``ActionServer`` and
``SimpleActionServer``.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from bridge.adapters.ros1.actions import cancels, states, wire
from bridge.adapters.ros1.actions.cancels import ANY, CancelRequests
from bridge.adapters.ros1.actions.discovery import CANCEL, FEEDBACK, GOAL, STATUS
from bridge.adapters.ros1.actions.goal import GoalStore, TrackedGoal
from bridge.adapters.ros1.actions.states import TO_ROS2, Ros1State
from bridge.adapters.ros1.actions.wire import ZERO, GoalId, GoalStatus
from bridge.hub.endpoints.calls import Abandon, CallError, Done, nothing
from bridge.messages.actions import CancelCode, GoalState
from bridge.messages.errors import ConversionError

_log = logging.getLogger(__name__)

RESULT_SECONDS = 5.0
"""Time limit for a goal's result after the status list has reported the end; on a busy machine, rospy sends it late.

Then the result counts as lost, and clients receive an empty one.
"""

CONNECT_SECONDS = 5.0
"""How long a goal or a cancel request waits for the connections to a newly discovered server."""

SHOWN_SECONDS = 10.0
"""How long an ended goal stays in the status topic, as in the action servers of ROS 2 Jazzy."""

ALIVE_SECONDS = 1.0
"""Period of unchanged status messages while the server lists its goals; they show that the server is alive."""

CALM_SECONDS = 0.05
FEW_GOALS = 32
"""With more goals, the status is published at most once per `CALM_SECONDS`, because each message lists all goals."""

LOST = "lost sight of the goal: "
"""Prefix of the text of a goal whose state is no longer reported; clients may depend on it."""

_NO_SUCH_GOAL = wire.cancel_response(CancelCode.UNKNOWN_GOAL_ID, ())
_REFUSED = wire.goal_response(ZERO, accepted=False)


class ClientOutput(Protocol):
    """Sends the messages of an `ActionlibClient`; never blocks."""

    def publish(self, part: str, payload: bytes) -> None:
        """Publish on the server's ``goal`` or ``cancel`` topic."""

    def deliver(self, part: str, payload: bytes) -> None:
        """Deliver a message of the action's ``status`` or ``feedback`` topic to the hub."""


class ActionlibClient:
    """The goals of one action.

    ``name`` is the action's name on ROS 1, ``clock`` returns monotonic seconds, ``empty`` is a serialized empty result.
    """

    def __init__(self, name: str, output: ClientOutput, clock: Callable[[], float], empty: bytes) -> None:
        self.name = name
        self._output, self._empty = output, empty
        self._clock = clock
        self._goals = GoalStore()
        self._cancels = CancelRequests(lambda payload: output.publish(CANCEL, payload), clock)
        self._lost_results: deque[tuple[float, TrackedGoal]] = deque()
        self._ready, self._disconnected_at = False, 0.0
        self._lost_reason = ""
        self._has_list = False
        self._changed = False
        self._published_at = float("-inf")
        self._shown_goals = 0

    # -- calls of the hub ----------------------------------------------------------------------------------------------

    def send_goal(self, request: bytes, done: Done) -> Abandon:
        """Handle a SendGoal call; it ends once the server has accepted or rejected the goal."""
        try:
            uuid, body = wire.read_with_uuid(request)
        except ConversionError as err:
            done(CallError(str(err)))
            return nothing
        reason = self._lost_reason or ("there are too many goals" if self._goals.full else "")
        if not reason and (uuid == ANY or self._goals.by_uuid(uuid) is not None):
            reason = "its UUID was used before"
        if reason:
            self._refuse(done, reason)
            return nothing
        goal = TrackedGoal(uuid, states.text_of(uuid), self._clock(), body, ours=True, asker=done)
        self._goals.add(goal)
        if self._ready:
            self._send(goal)
        return lambda: self._abandon(goal)

    def get_result(self, request: bytes, done: Done) -> Abandon:
        """Handle a GetResult call, which ends when the goal ends, without a time limit."""
        try:
            uuid, _ = wire.read_with_uuid(request)
        except ConversionError as err:
            done(CallError(str(err)))
            return nothing
        goal = self._goals.by_uuid(uuid)
        if goal is None or goal.refused:
            done(wire.result_response(GoalState.UNKNOWN, self._empty))
        elif goal.result is not None:
            goal.result_delivered = True
            done(_result(goal, goal.result))
        else:
            goal.waiting.append(done)
            return lambda: _remove(goal.waiting, done)
        return nothing

    def cancel(self, request: bytes, done: Done) -> Abandon:
        """Handle a CancelGoal call; it ends once the server reports each goal as canceling or ended."""
        try:
            uuid, stamp = wire.read_cancel_request(request)
        except ConversionError as err:
            done(CallError(str(err)))
            return nothing
        single = uuid != ANY and stamp == ZERO
        named = self._goals.by_uuid(uuid)
        if single and (named is None or named.refused):
            done(_NO_SUCH_GOAL)
        elif single and named is not None and named.state.ended:
            done(cancels.TERMINATED)
        elif self._lost_reason:
            done(cancels.REFUSED)
        elif single and named is not None and named.lost:
            self._publish_cancel(named)
            done(_NO_SUCH_GOAL)
        else:
            goals = [g for g in self._goals.unfinished() if not g.state.ended and cancels.concerns(g, uuid, stamp)]
            id_ = "" if uuid == ANY else named.id if named is not None else states.text_of(uuid)
            return self._cancels.add(GoalId(stamp, id_), goals, done, single=single)
        return nothing

    def _abandon(self, goal: TrackedGoal) -> None:
        """Drop an unsent goal whose send_goal client has left."""
        goal.asker = None
        if goal.unsent and not goal.refused:
            self._drop(goal, "its caller left")

    # -- events of the server ------------------------------------------------------------------------------------------

    def discovered(self) -> None:
        """Accept goals for a discovered server, which may not be connected yet."""
        self._lost_reason = ""

    def connected(self) -> None:
        """Send waiting goals, because all five topics are connected."""
        self._ready = True
        for goal in self._goals.unfinished():
            if goal.unsent:
                self._send(goal)
        self.reach(reachable=True)

    def disconnected(self) -> None:
        """Hold back goals while a connection to the server is missing; the connection may return."""
        self._ready, self._disconnected_at = False, self._clock()
        self.reach(reachable=False)

    def reconnected(self, part: str) -> None:
        """Send again what the server may not have received before its connection to ``goal`` or ``cancel`` ended.

        An actionlib server ignores a goal whose id it lists, so no goal is executed twice.
        """
        if part == CANCEL:
            self._cancels.repeat()
            return
        for goal in self._goals.unfinished():
            if goal.unconfirmed and goal.asker is not None:
                self._send(goal)

    def reach(self, *, reachable: bool) -> None:
        """Set whether the server is connected to the cancel topic; that suffices for canceling its goals."""
        self._cancels.reachable = reachable
        self._cancels.send()

    def lost(self, reason: str) -> None:
        """Handle the loss of contact with the server; until `discovered` is called, goals are rejected.

        A goal that the status list has reported as ended ends in that state with an empty result, and a goal that was
        not sent yet is rejected. For all other goals no state is published, because they may still be executing;
        clients of get_result receive an error, with a text that begins with `LOST`.
        """
        self._ready, self._lost_reason, self._has_list = False, reason, False
        self._cancels.reachable = False
        self._cancels.refuse_all()
        for goal in self._goals.unfinished():
            if goal.state.ended:
                self._end(goal, goal.state, self._empty)
            elif goal.unsent:
                self._drop(goal, reason)
            else:
                self._lose(goal, reason)
        self._changed = False

    def close(self, reason: str) -> None:
        """Cancel the goals of this client if the server is connected to the cancel topic; stop tracking all goals."""
        for goal in self._goals.unfinished():
            if goal.ours and not goal.unsent and not goal.state.ended:
                self._publish_cancel(goal)
        self.lost(reason)

    def statuses(self, found: Iterable[GoalStatus]) -> None:
        """Adopt the server's status list; publish the states after the first list even if it has no goals."""
        self._changed, self._has_list = self._changed or not self._has_list, True
        named: set[str] = set()
        for status in found:
            named.add(status.goal.id)
            goal = self._goal(status)
            if goal is not None:
                goal.listed = True
                self._follow(goal, status)
                if goal.refused and Ros1State.parse(status.state) in (Ros1State.PENDING, Ros1State.ACTIVE):
                    self._publish_cancel(goal)
        for goal in self._goals.unfinished():
            if goal.listed and goal.id not in named and not goal.state.ended:
                self._lose(goal, "the server no longer lists it")
                self._changed = True
        if self._clock() >= self._published_at + ALIVE_SECONDS and self._goals.unfinished():
            self._changed = True
        self._flush()

    def result(self, status: GoalStatus, body: bytes) -> None:
        """End a goal with its result."""
        goal = self._goal(status)
        if goal is None or goal.whole or goal.result_delivered or goal.refused:
            return
        if goal.result is not None:  # the result counted as lost, but no client has received the empty result yet
            self._goals.remove(goal)
            goal.result = None
            self._goals.add(goal)
        self._accept(goal, status)
        if goal.refused:
            return
        state = TO_ROS2[Ros1State.parse(status.state)]
        goal.whole, goal.text = True, status.text
        self._end(goal, state if state.ended else GoalState.ABORTED, body)
        self._flush()

    def feedback(self, status: GoalStatus, body: bytes) -> None:
        """Deliver feedback, even if the goal's result overtook it on another connection."""
        goal = self._goal(status)
        if goal is None:
            return
        self._follow(goal, status)
        if goal.accepted:
            self._output.deliver(FEEDBACK, goal.uuid + body)
        self._flush()

    def tick(self) -> None:
        """Handle expired waits; called about ten times per second."""
        now = self._clock()
        while self._lost_results and self._lost_results[0][0] <= now:
            _, goal = self._lost_results.popleft()
            if goal.result is None and not goal.refused:
                self._end(goal, goal.state, self._empty)
        if not self._ready:
            self._refuse_unconnected(now - CONNECT_SECONDS)
        if not self._cancels.reachable:
            self._cancels.refuse_unsent(now - CONNECT_SECONDS)
        self._cancels.send()
        self._goals.expire(now)
        self._flush()

    # -- the goals -----------------------------------------------------------------------------------------------------

    @property
    def kept(self) -> int:
        """Number of stored goals."""
        return len(self._goals)

    def _send(self, goal: TrackedGoal) -> None:
        # Stamp zero, because a server cancels any other new goal whose stamp is not after the last cancel request's.
        goal.sent = True
        self._output.publish(GOAL, wire.action_goal(GoalId(ZERO, goal.id), goal.body or b""))

    def _refuse_unconnected(self, before: float) -> None:
        """Reject the goals that have waited for connections since ``before``; cancel those that may have arrived.

        If such a goal arrives only later, it is canceled when the server lists it.
        """
        for goal in self._goals.unfinished():
            if goal.unconfirmed and self._disconnected_at <= before:
                self._publish_cancel(goal)
                self._drop(goal, "the server does not connect to this bridge")
            elif goal.unsent and goal.since <= before:
                self._drop(goal, "the server does not connect to this bridge")

    def _publish_cancel(self, goal: TrackedGoal) -> None:
        if self._cancels.reachable:
            self._output.publish(CANCEL, wire.goal_id(GoalId(ZERO, goal.id)))

    def _goal(self, status: GoalStatus) -> TrackedGoal | None:
        """Return the goal of a status; add it if another client sent it. None if there are too many goals."""
        id_ = status.goal.id
        goal = self._goals.by_id(id_)
        if goal is not None and not goal.ours and goal.state.ended and goal.stamp != status.goal.stamp:
            if goal.result is None:  # it counts as lost: a result that arrives now is the new goal's
                self._end(goal, goal.state, self._empty)
            self._goals.remove(goal)
            goal = None
        ours = goal is not None and goal.lost and goal.ours
        if goal is not None and goal.lost:  # the server reports it again
            self._goals.remove(goal)
            goal = None
        if goal is None and not self._goals.full:
            uuid = states.uuid_of(self.name, id_)
            if self._goals.by_uuid(uuid) is None:
                goal = TrackedGoal(uuid, id_, self._clock(), ours=ours)
                self._goals.add(goal)
        return goal

    def _follow(self, goal: TrackedGoal, status: GoalStatus) -> None:
        """Adopt a reported state, unless it precedes the goal's current state or the goal has ended."""
        self._accept(goal, status)
        state = TO_ROS2[Ros1State.parse(status.state)]
        if goal.refused or state <= goal.state or goal.state.ended:
            return
        goal.state, goal.text = state, status.text
        self._changed = True
        if state.ended:
            self._lost_results.append((self._clock() + RESULT_SECONDS, goal))
        self._cancels.send()

    def _accept(self, goal: TrackedGoal, status: GoalStatus) -> None:
        """Accept or reject a goal by its first reported state."""
        if goal.accepted or goal.refused:
            return
        state = Ros1State.parse(status.state)
        if goal.ours and state in (Ros1State.REJECTED, Ros1State.RECALLED, Ros1State.LOST):
            self._drop(goal, status.text or f"the server reports {state.name}")
            return
        goal.state, goal.stamp, goal.body = GoalState.ACCEPTED, status.goal.stamp, None
        self._changed = True
        asker, goal.asker = goal.asker, None
        if asker is not None:
            asker(wire.goal_response(goal.stamp, accepted=True))
        if not state.ended:
            self._cancels.on_confirmed(goal)
            self._cancels.send()

    def _refuse(self, done: Done, reason: str) -> None:
        _log.warning("%s: a goal is rejected: %s", self.name, reason)
        done(_REFUSED)

    def _drop(self, goal: TrackedGoal, reason: str) -> None:
        """Reject a goal that has not been accepted."""
        goal.refused, goal.body, goal.result = True, None, b""
        self._goals.end(goal, self._clock())
        asker, goal.asker = goal.asker, None
        if asker is not None:
            self._refuse(asker, reason)
        for done in goal.waiting:
            done(wire.result_response(GoalState.UNKNOWN, self._empty))
        goal.waiting.clear()
        self._cancels.send()

    def _lose(self, goal: TrackedGoal, reason: str) -> None:
        """End a goal as UNKNOWN: its state is no longer reported, and it may still be executing."""
        _log.warning("%s: can no longer track goal %s: %s", self.name, goal.id, reason)
        goal.lost, goal.body, goal.text = True, None, LOST + reason
        asker, goal.asker = goal.asker, None
        if asker is not None:
            asker(CallError(goal.text))
        self._end(goal, GoalState.UNKNOWN, self._empty)

    def _end(self, goal: TrackedGoal, state: GoalState, result: bytes) -> None:
        goal.state, goal.result = state, result
        self._goals.end(goal, self._clock())
        self._changed = True
        goal.result_delivered = goal.result_delivered or bool(goal.waiting)
        for done in goal.waiting:
            done(_result(goal, result))
        goal.waiting.clear()
        self._cancels.send()

    def _flush(self) -> None:
        """Publish the states if any has changed."""
        now = self._clock()
        if not self._changed or (self._shown_goals > FEW_GOALS and now < self._published_at + CALM_SECONDS):
            return
        goals = [g for g in self._goals.ended_since(now - SHOWN_SECONDS) if not g.refused and not g.lost]
        goals = [*reversed(goals), *(g for g in self._goals.unfinished() if g.accepted)]
        self._changed, self._published_at, self._shown_goals = False, now, len(goals)
        self._output.deliver(STATUS, wire.goal_states([(g.info, g.state) for g in goals]))


def _remove(items: list[Any], item: Any) -> None:
    if item in items:
        items.remove(item)


def _result(goal: TrackedGoal, body: bytes) -> bytes | CallError:
    """Return the response to a get_result call of an ended goal: an error if the goal was lost."""
    return CallError(goal.text) if goal.lost else wire.result_response(goal.state, body, goal.reason)
