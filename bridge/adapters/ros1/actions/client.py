"""The side of us that is an actionlib client: a ROS 2 action's calls come in, goals go to an actionlib server.

Pure: it has no thread, socket or clock of its own; `bridge.adapters.ros1.actions.turns` gives it one event at a time.
How actionlib servers behave: https://github.com/ros/actionlib (1.14), ``ActionServer`` and ``SimpleActionServer``.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from bridge.adapters.ros1.actions import ids, wire
from bridge.adapters.ros1.actions.goal import Goal, Shelf
from bridge.adapters.ros1.actions.states import TO_ROS2, CancelCode, Ros1State, Ros2State
from bridge.adapters.ros1.actions.wire import ZERO, GoalId, GoalStatus
from bridge.hub.call import Abandon, CallError, Done
from bridge.messages.errors import ConversionError

_log = logging.getLogger(__name__)

RESULT_SECONDS = 2.0
"""How long a result may come after the status list named its goal's end; then it is taken for lost, and is empty."""

CONNECT_SECONDS = 5.0
"""How long a goal or a cancel request waits for the connections to a server that has just been found."""

SHOWN_SECONDS = 10.0
"""How long an ended goal stays in the status topic: as long as Jazzy's servers keep theirs."""

CALM_SECONDS = 0.05
FEW_GOALS = 32
"""With more goals than these, the status topic is published at most each `CALM_SECONDS`: it names all of them."""

_ANY = bytes(wire.UUID_SIZE)
_TERMINATED = wire.cancel_response(CancelCode.GOAL_TERMINATED, ())
_NO_SUCH_GOAL = wire.cancel_response(CancelCode.UNKNOWN_GOAL_ID, ())
_CANCEL_REFUSED = wire.cancel_response(CancelCode.REJECTED, ())
_REFUSED = wire.goal_response(ZERO, accepted=False)


class Outside(Protocol):
    """What an `ActionClient` does in the world; nothing here waits."""

    def goal(self, payload: bytes) -> None:
        """Publish an ActionGoal."""

    def cancel(self, payload: bytes) -> None:
        """Publish a GoalID on the cancel topic."""

    def status(self, payload: bytes) -> None:
        """An action_msgs/GoalStatusArray for the hub."""

    def feedback(self, payload: bytes) -> None:
        """A FeedbackMessage for the hub."""


@dataclass(eq=False, slots=True)
class _Cancel:
    """One cancel request under way.

    Attributes:
        goals: what it is about.
        single: it names one goal alone.
        unsent: what is still to be sent to the server, None once it was.
    """

    goals: Sequence[Goal]
    single: bool
    done: Done
    since: float
    unsent: bytes | None


class ActionClient:
    """The goals of one action.

    Args:
        name: the action's name on ROS 1.
        outside: where its messages go.
        clock: seconds that only grow.
        empty: the bytes of a result with nothing in it.
    """

    def __init__(self, name: str, outside: Outside, clock: Callable[[], float], empty: bytes) -> None:
        self.name = name
        self._outside, self._empty = outside, empty
        self._clock = clock
        self._shelf = Shelf()
        self._cancels: list[_Cancel] = []
        self._lost_results: deque[tuple[float, Goal]] = deque()
        self._ready = False
        self._gone = ""
        self._changed = False
        self._told = float("-inf")
        self._shown = 0

    # -- what the hub asks ---------------------------------------------------------------------------------------------

    def send_goal(self, request: bytes, done: Done) -> Abandon:
        """A SendGoal call; answered once the server shows that it took the goal, or did not."""
        try:
            uuid, body = wire.read_with_uuid(request)
        except ConversionError as err:
            done(CallError(str(err)))
            return _nothing
        why = self._gone or ("there are too many goals" if self._shelf.full else "")
        if not why and (uuid == _ANY or self._shelf.by_uuid(uuid) is not None):
            why = "its UUID was used before"
        if why:
            self._refuse(done, why)
            return _nothing
        goal = Goal(uuid, ids.text_of(uuid), self._clock(), body, ours=True, asker=done)
        self._shelf.add(goal)
        if self._ready:
            self._send(goal)
        return lambda: self._abandon(goal)

    def get_result(self, request: bytes, done: Done) -> Abandon:
        """A GetResult call; answered at the goal's end, however long that takes."""
        try:
            uuid, _ = wire.read_with_uuid(request)
        except ConversionError as err:
            done(CallError(str(err)))
            return _nothing
        goal = self._shelf.by_uuid(uuid)
        if goal is None or goal.refused:
            done(wire.result_response(Ros2State.UNKNOWN, self._empty))
        elif goal.result is not None:
            goal.told = True
            done(wire.result_response(goal.state, goal.result, goal.reason))
        else:
            goal.waiting.append(done)
            return lambda: _remove(goal.waiting, done)
        return _nothing

    def cancel(self, request: bytes, done: Done) -> Abandon:
        """A CancelGoal call; answered once the server shows of each goal that it is being cancelled, or has ended."""
        try:
            uuid, stamp = wire.read_cancel_request(request)
        except ConversionError as err:
            done(CallError(str(err)))
            return _nothing
        single = uuid != _ANY and stamp == ZERO
        named = self._shelf.by_uuid(uuid)
        if single and (named is None or named.refused):
            done(_NO_SUCH_GOAL)
        elif single and named is not None and named.state.ended:
            done(_TERMINATED)
        elif self._gone:
            done(_CANCEL_REFUSED)
        else:
            goals = [g for g in self._shelf.unfinished() if not g.state.ended and _is_meant(g, uuid, stamp)]
            id_ = "" if uuid == _ANY else named.id if named is not None else ids.text_of(uuid)
            cancel = _Cancel(goals, single, done, self._clock(), wire.goal_id(GoalId(stamp, id_)))
            self._cancels.append(cancel)
            self._send_cancels()
            return lambda: _remove(self._cancels, cancel)
        return _nothing

    def _abandon(self, goal: Goal) -> None:
        """The caller of send_goal left; a goal that was not sent yet never is."""
        goal.asker = None
        if goal.body is not None and not goal.refused:
            self._drop(goal, "its caller left")

    # -- what the server says ------------------------------------------------------------------------------------------

    def found(self) -> None:
        """There is a server; it may not be connected yet."""
        self._gone = ""

    def connected(self) -> None:
        """The server hears us and we hear it."""
        self._ready = True
        for goal in self._shelf.unfinished():
            if goal.body is not None:
                self._send(goal)
        self._send_cancels()

    def disconnected(self) -> None:
        """The server does not hear us now; it may come back."""
        self._ready = False

    def lost(self, reason: str) -> None:
        """The server is gone for good, and all that it was doing; until `found` is called, goals are rejected."""
        self._ready, self._gone = False, reason
        self._refuse_cancels(float("inf"))
        for goal in self._shelf.unfinished():
            if not goal.accepted:
                self._drop(goal, reason)
            elif goal.state.ended:
                self._end(goal, goal.state, self._empty)
            else:
                self._abort(goal, reason)
        self._flush()

    def close(self, reason: str) -> None:
        """Nobody will follow the goals any more: those that callers sent are cancelled, and all of them end."""
        if self._ready:
            for goal in self._shelf.unfinished():
                if goal.ours and goal.body is None and not goal.state.ended:
                    self._outside.cancel(wire.goal_id(GoalId(ZERO, goal.id)))
        self.lost(reason)

    def statuses(self, found: Iterable[GoalStatus]) -> None:
        """The server's status list."""
        named: set[str] = set()
        for status in found:
            named.add(status.goal.id)
            goal = self._goal(status)
            if goal is not None:
                goal.listed = True
                self._follow(goal, status)
        for goal in self._shelf.unfinished():
            if goal.listed and goal.id not in named and not goal.state.ended:
                self._abort(goal, "the server does not know it any more")
        self._flush()

    def result(self, status: GoalStatus, body: bytes) -> None:
        """A result."""
        goal = self._goal(status)
        if goal is None or goal.whole or goal.told or goal.refused:
            return
        if goal.result is not None:  # it was given up, but nobody asked yet
            self._shelf.forget(goal)
            goal.result = None
            self._shelf.add(goal)
        self._accept(goal, status)
        if goal.refused:
            return
        state = TO_ROS2[Ros1State.parse(status.state)]
        goal.whole, goal.text = True, status.text
        self._end(goal, state if state.ended else Ros2State.ABORTED, body)
        self._flush()

    def feedback(self, status: GoalStatus, body: bytes) -> None:
        """A feedback; one that the result overtook on its own connection is passed on too."""
        goal = self._goal(status)
        if goal is None:
            return
        self._follow(goal, status)
        if goal.accepted:
            self._outside.feedback(goal.uuid + body)
        self._flush()

    def tick(self) -> None:
        """Time has passed; called some ten times a second."""
        now = self._clock()
        while self._lost_results and self._lost_results[0][0] <= now:
            _, goal = self._lost_results.popleft()
            if goal.result is None and not goal.refused:
                self._end(goal, goal.state, self._empty)
        if not self._ready:
            for goal in self._shelf.unfinished():
                if goal.body is not None and goal.since <= now - CONNECT_SECONDS:
                    self._drop(goal, "the server does not connect to this bridge")
            self._refuse_cancels(now - CONNECT_SECONDS)
        self._shelf.expire(now)
        self._flush()

    # -- the goals -----------------------------------------------------------------------------------------------------

    @property
    def kept(self) -> int:
        """Goals that are remembered."""
        return len(self._shelf)

    def _send(self, goal: Goal) -> None:
        # A server takes a goal whose stamp is older than its last cancel request's for cancelled; zero is never that.
        body, goal.body = goal.body or b"", None
        self._outside.goal(wire.action_goal(GoalId(ZERO, goal.id), body))

    def _goal(self, status: GoalStatus) -> Goal | None:
        """The goal of a status; one of another client's is taken up."""
        id_ = status.goal.id
        goal = self._shelf.by_id(id_)
        if goal is not None and not goal.ours and goal.state.ended and goal.stamp != status.goal.stamp:
            self._shelf.forget(goal)
            goal = None
        if goal is None and not self._shelf.full:
            uuid = ids.uuid_of(self.name, id_)
            if self._shelf.by_uuid(uuid) is None:
                goal = Goal(uuid, id_, self._clock())
                self._shelf.add(goal)
        return goal

    def _follow(self, goal: Goal, status: GoalStatus) -> None:
        """Take over a state that the server tells; a goal never goes back."""
        self._accept(goal, status)
        state = TO_ROS2[Ros1State.parse(status.state)]
        if goal.refused or state <= goal.state or goal.state.ended:
            return
        goal.state, goal.text = state, status.text
        self._changed = True
        if state.ended:
            self._lost_results.append((self._clock() + RESULT_SECONDS, goal))
        self._answer_cancels()

    def _accept(self, goal: Goal, status: GoalStatus) -> None:
        """The first word on a goal says whether the server took it."""
        if goal.accepted or goal.refused:
            return
        state = Ros1State.parse(status.state)
        if goal.ours and state in (Ros1State.REJECTED, Ros1State.RECALLED, Ros1State.LOST):
            self._drop(goal, status.text or f"the server says {state.name}")
            return
        goal.state, goal.stamp = Ros2State.ACCEPTED, status.goal.stamp
        self._changed = True
        asker, goal.asker = goal.asker, None
        if asker is not None:
            asker(wire.goal_response(goal.stamp, accepted=True))

    def _refuse(self, done: Done, why: str) -> None:
        _log.warning("%s: a goal is rejected: %s", self.name, why)
        done(_REFUSED)

    def _drop(self, goal: Goal, why: str) -> None:
        """Reject a goal that was not accepted."""
        goal.refused, goal.body, goal.result = True, None, b""
        self._shelf.end(goal, self._clock())
        asker, goal.asker = goal.asker, None
        if asker is not None:
            self._refuse(asker, why)
        for done in goal.waiting:
            done(wire.result_response(Ros2State.UNKNOWN, self._empty))
        goal.waiting.clear()
        self._answer_cancels()

    def _abort(self, goal: Goal, why: str) -> None:
        _log.warning("%s: goal %s is aborted: %s", self.name, goal.id, why)
        goal.text = why
        self._end(goal, Ros2State.ABORTED, self._empty)

    def _end(self, goal: Goal, state: Ros2State, result: bytes) -> None:
        goal.state, goal.result = state, result
        self._shelf.end(goal, self._clock())
        self._changed = True
        goal.told = goal.told or bool(goal.waiting)
        for done in goal.waiting:
            done(wire.result_response(state, result, goal.reason))
        goal.waiting.clear()
        self._answer_cancels()

    def _send_cancels(self) -> None:
        for cancel in self._cancels:
            if self._ready and cancel.unsent is not None:
                self._outside.cancel(cancel.unsent)
                cancel.unsent = None
        self._answer_cancels()

    def _refuse_cancels(self, before: float) -> None:
        """Give up cancel requests that could not be sent."""
        late = [c for c in self._cancels if c.unsent is not None and c.since <= before]
        self._cancels = [c for c in self._cancels if c not in late]
        for cancel in late:
            cancel.done(_CANCEL_REFUSED)

    def _answer_cancels(self) -> None:
        still: list[_Cancel] = []
        for cancel in self._cancels:
            if cancel.unsent is not None or any(_is_untouched(g) for g in cancel.goals):
                still.append(cancel)
                continue
            canceling = [g.info for g in cancel.goals if g.state in (Ros2State.CANCELING, Ros2State.CANCELED)]
            missed = cancel.single and not canceling
            cancel.done(_TERMINATED if missed else wire.cancel_response(CancelCode.NONE, canceling))
        self._cancels[:] = still

    def _flush(self) -> None:
        """Publish the states where one has changed."""
        now = self._clock()
        if not self._changed or (self._shown > FEW_GOALS and now < self._told + CALM_SECONDS):
            return
        goals = [g for g in self._shelf.ended_since(now - SHOWN_SECONDS) if not g.refused]
        goals = [*reversed(goals), *(g for g in self._shelf.unfinished() if g.accepted)]
        self._changed, self._told, self._shown = False, now, len(goals)
        self._outside.status(wire.goal_states([(g.info, g.state) for g in goals]))


def _nothing() -> None:
    """There is nothing to abandon."""


def _remove(items: list[Any], item: Any) -> None:
    if item in items:
        items.remove(item)


def _is_meant(goal: Goal, uuid: bytes, stamp: wire.Stamp) -> bool:
    """Whether a cancel request is about a goal."""
    if goal.uuid == uuid or (uuid == _ANY and stamp == ZERO):
        return True
    return stamp != ZERO and goal.accepted and goal.stamp <= stamp


def _is_untouched(goal: Goal) -> bool:
    """Whether a goal still goes on as if it had not been cancelled."""
    return not goal.refused and not goal.state.ended and goal.state is not Ros2State.CANCELING
