"""An actionlib server that forwards goals of actionlib clients to an action on the hub.

Like `bridge.adapters.ros1.actions.client`, it uses no threads, sockets or system clock. Toward its clients it behaves
like actionlib's ``ActionServer`` (https://github.com/ros/actionlib, 1.14), but instead of user callbacks it calls the
three services of the hub's action server.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol
from uuid import uuid4

from bridge.adapters.ros1.actions import states, wire
from bridge.adapters.ros1.actions.client import LOST
from bridge.adapters.ros1.actions.discovery import FEEDBACK, RESULT, STATUS
from bridge.adapters.ros1.actions.orphans import OrphanedGoals
from bridge.adapters.ros1.actions.states import TO_ROS1, Ros1State
from bridge.adapters.ros1.actions.wire import ZERO, GoalId, GoalInfo, GoalStatus, RosTime
from bridge.hub.endpoints.calls import CallError, Done, UnsentCallError
from bridge.messages.actions import CANCEL_GOAL, GET_RESULT, SEND_GOAL, CancelCode, GoalState
from bridge.messages.errors import ConversionError

_log = logging.getLogger(__name__)

STATUS_SECONDS = 0.2
"""actionlib's default ``actionlib_status_frequency`` is 5 Hz."""

_TICK_SLACK = 0.05

LIST_SECONDS = 5.0
"""actionlib's default ``status_list_timeout``: an ended goal stays in the status list for this time."""

RESULT_SECONDS = 60.0
"""A result is sent once, and again to each client that connects to the result topic within this time."""

MAX_RESULT_BYTES = 16 << 20
"""Maximum total size of the results that are stored to be sent again; the oldest are dropped first."""

MAX_GOALS = 10_000
"""Maximum number of entries in the status list; further goals are rejected."""

CALM_SECONDS = 0.05
FEW_GOALS = 32
"""A longer status list is published at most once per `CALM_SECONDS`, because each message contains all entries."""

CANCEL_SECONDS = 1.0
"""Pause before a cancel request that did not reach the hub's server is repeated."""

_CANCELED_EARLIER = "the goal's stamp is not after that of the last cancel request"
_ANY = bytes(wire.UUID_SIZE)
_CANCELING = {Ros1State.PENDING: Ros1State.RECALLING, Ros1State.ACTIVE: Ros1State.PREEMPTING}
_STARTED = {Ros1State.PENDING: Ros1State.ACTIVE, Ros1State.RECALLING: Ros1State.PREEMPTING}


class ServerOutput(Protocol):
    """Sends the messages and calls of an `ActionlibServer`; never blocks."""

    def publish(self, part: str, payload: bytes, source: str = "") -> None:
        """Publish on ``status``, ``feedback`` or ``result``; later subscribers also receive the stored results.

        ``source`` is the id of a result's goal, for `drop_result`.
        """

    def drop_result(self, goal: str) -> None:
        """Drop a goal's result."""

    def call(self, part: str, request: bytes, done: Done) -> None:
        """Call one of the hub's three services; ``done`` is called later, never from within the call."""


@dataclass(eq=False, slots=True)
class _ListedGoal:
    """One goal of the status list.

    ``ours`` is whether a ROS 1 client sent it; otherwise a hub client did, and ROS 1 clients only see its status.
    ``uuid`` is its id on the hub, None for a cancel request whose goal has not arrived. ``since`` is the time from
    which `LIST_SECONDS` count: the goal ended, or was sent again after its end, or such a cancel request arrived.
    ``unheeded`` is whether the hub's server did not accept the last answered cancel request; ``cancel_at`` is when to
    repeat one that did not reach it.
    """

    id: str
    stamp: RosTime
    state: Ros1State
    uuid: bytes | None
    ours: bool
    text: str = ""
    accepted: bool = False
    since: float | None = None
    unheeded: bool = False
    cancel_at: float | None = None

    @property
    def status(self) -> GoalStatus:
        return GoalStatus(GoalId(self.stamp, self.id), self.state, self.text)


class ActionlibServer:
    """The goals of one action.

    ``clock`` returns monotonic seconds, ``now`` the time for ROS 1's stamps; ``empty`` is a serialized empty result.
    ``orphans``: goals that were aborted here without the server's report; they are canceled while the server lists them
    as executing.
    """

    def __init__(
        self, name: str, output: ServerOutput, clock: Callable[[], float], now: Callable[[], RosTime], empty: bytes,
        orphans: OrphanedGoals,
    ) -> None:  # fmt: skip
        self.name, self._orphans = name, orphans
        self._executing: tuple[bytes, ...] = ()
        self._cancel_again: dict[bytes, float] = {}
        self._output, self._clock, self._now, self._empty = output, clock, now, empty
        self._entries: dict[str, _ListedGoal] = {}
        self._by_uuid: dict[bytes, _ListedGoal] = {}
        self._results: deque[tuple[float, str, int]] = deque()
        self._result_bytes = 0
        self._last_cancel = ZERO
        self._seq = 0
        self._generated = 0
        self._published = float("-inf")
        self._changed = True
        self._closed = False

    def open(self) -> None:
        """Publish the first status list, by which clients discover the server."""
        self._flush()

    def forget_time(self) -> None:
        """Forget the stamp of the last cancel request: the clock was set, so goals with earlier stamps are accepted."""
        self._last_cancel = ZERO

    # -- events of ROS 1 clients ---------------------------------------------------------------------------------------

    def goal(self, goal: GoalId, body: bytes) -> str:
        """Accept a client's goal; return the id under which it is listed, "" if it is not listed."""
        if self._closed:
            return ""
        listed = goal.id
        known = self._entries.get(goal.id) if goal.id else None
        if known is not None:
            self._on_known_id(known)
        elif len(self._entries) >= MAX_GOALS:
            _log.warning("%s: a goal is rejected: there are %d already", self.name, MAX_GOALS)
            refused = _ListedGoal(goal.id, goal.stamp, Ros1State.REJECTED, None, ours=True, text="too many goals")
            self._publish_result(refused, self._empty)
            listed = ""
        else:
            listed = self._accept(goal, body)
        self._flush()
        return listed

    def _on_known_id(self, entry: _ListedGoal) -> None:
        """Handle a goal whose id is listed: end it if its cancel request arrived first; list an ended goal longer."""
        if entry.state is Ros1State.RECALLING and entry.uuid is None:
            self._end(entry, Ros1State.RECALLED, self._empty, "")
        elif entry.since is not None:
            entry.since = self._clock()

    def knows(self, goal: str) -> bool:
        """Return whether a goal with this id is listed."""
        return goal in self._entries

    def _accept(self, goal: GoalId, body: bytes) -> str:
        id_, stamp = goal.id or self._new_id(), goal.stamp if goal.stamp != ZERO else self._now()
        entry = _ListedGoal(id_, stamp, Ros1State.PENDING, uuid4().bytes, ours=True)
        self._add(entry)
        if goal.stamp != ZERO and goal.stamp <= self._last_cancel:
            self._end(entry, Ros1State.RECALLED, self._empty, _CANCELED_EARLIER)
            return id_
        assert entry.uuid is not None
        self._output.call(SEND_GOAL, entry.uuid + body, lambda reply: self._on_goal_reply(entry, reply))
        return id_

    def cancel(self, request: GoalId) -> None:
        """Handle a cancel request for one goal (id), for all goals up to a time (stamp), or for all goals (neither)."""
        if self._closed:
            return
        everything = request == GoalId(ZERO, "")
        if everything:
            # one call for all goals, so that goals of hub clients are canceled, too
            listed = [entry for entry in self._entries.values() if entry.accepted]
            self._call_cancel(GoalInfo(_ANY, ZERO), listed)
        for entry in list(self._entries.values()):
            before = request.stamp != ZERO and entry.stamp <= request.stamp
            if (everything or entry.id == request.id or before) and not entry.state.ended:
                self._cancel(entry, already_sent=everything)
        if request.id and request.id not in self._entries and len(self._entries) < MAX_GOALS:
            self._add(_ListedGoal(request.id, request.stamp, Ros1State.RECALLING, None, ours=True, since=self._clock()))
        self._last_cancel = max(self._last_cancel, request.stamp)
        self._flush()

    def _cancel(self, entry: _ListedGoal, *, already_sent: bool) -> None:
        state = _CANCELING.get(entry.state)
        if state is not None:
            self._set(entry, state)
        elif not entry.unheeded:
            return
        if not already_sent and entry.accepted:
            self._send_cancel(entry)

    def _send_cancel(self, entry: _ListedGoal) -> None:
        assert entry.uuid is not None
        self._call_cancel(GoalInfo(entry.uuid, ZERO), [entry])

    def _call_cancel(self, info: GoalInfo, goals: Sequence[_ListedGoal]) -> None:
        for entry in goals:
            entry.cancel_at = None
        self._output.call(CANCEL_GOAL, wire.cancel_request(info), lambda reply: self._on_cancel_reply(goals, reply))

    def _on_cancel_reply(self, goals: Sequence[_ListedGoal], reply: bytes | CallError) -> None:
        """Log a failed cancel request, and note its goals; ROS 1 clients see only that these end in another state.

        A further request of a ROS 1 client is then sent to the server again. A request that did not reach the server is
        also repeated without one.
        """
        reason = _failure(reply)
        running = [entry for entry in goals if not entry.state.ended]
        if reason and not (running and all(entry.unheeded for entry in running)):
            _log.warning("%s: a cancel request had no effect: %s", self.name, reason)
        for entry in running:
            entry.unheeded = bool(reason)
            if isinstance(reply, CallError):
                entry.cancel_at = self._clock() + CANCEL_SECONDS

    # -- events of the hub's server ------------------------------------------------------------------------------------

    def _on_goal_reply(self, entry: _ListedGoal, reply: bytes | CallError) -> None:
        if entry.state.ended or entry.uuid is None:
            return
        accepted = False
        error = reply
        if isinstance(reply, bytes):
            try:
                accepted = wire.read_goal_response(reply)
            except ConversionError as err:
                error = CallError(str(err))
        if accepted:
            entry.accepted = True
            if entry.state is not Ros1State.PENDING and entry.state is not Ros1State.ACTIVE:
                self._send_cancel(entry)
            self._output.call(GET_RESULT, entry.uuid, lambda result: self._on_result_reply(entry, result))
        elif isinstance(error, UnsentCallError):
            self._end(entry, Ros1State.REJECTED, self._empty, str(error))
        elif isinstance(error, CallError):
            self._lose(entry, str(error))
        else:
            self._end(entry, Ros1State.REJECTED, self._empty, "the action server rejected the goal")
        self._flush()

    def _on_result_reply(self, entry: _ListedGoal, reply: bytes | CallError) -> None:
        if entry.state.ended:
            return
        if isinstance(reply, CallError):
            self._lose(entry, str(reply))
        else:
            self._on_result(entry, reply)
        self._flush()

    def _on_result(self, entry: _ListedGoal, reply: bytes) -> None:
        try:
            number, body, text = wire.read_result_response(reply)
        except ConversionError as err:
            self._lose(entry, str(err))
            return
        state = GoalState.parse(number)
        if state.ended:
            self._end(entry, self._final(entry, state), body, text)
        else:
            self._lose(entry, text if text.startswith(LOST) else "the action server no longer knows the goal", body)

    @staticmethod
    def _final(entry: _ListedGoal, state: GoalState) -> Ros1State:
        if state is GoalState.CANCELED and entry.state in _STARTED:
            return Ros1State.RECALLED
        return TO_ROS1[state]

    def states(self, goals: list[tuple[GoalInfo, int]]) -> None:
        """Adopt the goal states from the hub server's status topic."""
        if self._closed:
            return
        for info, number in goals:
            self._follow(info, GoalState.parse(number))
        named = {info.uuid for info, _ in goals}
        for entry in [e for e in self._by_uuid.values() if not e.ours and not e.state.ended and e.uuid not in named]:
            self._set(entry, Ros1State.ABORTED, "the action server no longer knows the goal")
            entry.since = self._clock()
        active = {GoalState.ACCEPTED, GoalState.EXECUTING}
        self._executing = tuple(info.uuid for info, number in goals if GoalState.parse(number) in active)
        self._cancel_orphans()
        self._flush()

    def _follow(self, info: GoalInfo, state: GoalState) -> None:
        entry = self._by_uuid.get(info.uuid)
        if entry is None and not state.ended and len(self._entries) < MAX_GOALS:
            entry = _ListedGoal(
                states.text_of(info.uuid), info.stamp, Ros1State.PENDING, info.uuid, ours=False, accepted=True
            )
            self._add(entry)
        if entry is None or entry.state.ended:
            return
        if state is GoalState.EXECUTING and entry.state in _STARTED:
            self._set(entry, _STARTED[entry.state])
        elif state is GoalState.CANCELING and entry.state in _CANCELING:
            self._set(entry, _CANCELING[entry.state])
        elif state.ended and not entry.ours:  # goals of ROS 1 clients end with get_result's reply
            self._set(entry, self._final(entry, state))
            entry.since = self._clock()

    def feedback(self, uuid: bytes, body: bytes) -> None:
        """Publish feedback from the hub's server."""
        entry = self._by_uuid.get(uuid)
        if self._closed or entry is None or entry.state.ended:
            return
        if entry.state in _STARTED:
            self._set(entry, _STARTED[entry.state])
        self._seq += 1
        self._output.publish(FEEDBACK, wire.action_outcome(self._seq, self._now(), entry.status, body))
        self._flush()

    def close(self, reason: str) -> None:
        """End all listed goals, since the hub's server has left."""
        for entry in list(self._entries.values()):
            if not entry.state.ended and entry.uuid is not None:
                self._lose(entry, reason)
        self._published, self._executing = float("-inf"), ()
        self._flush()
        self._closed = True

    # -- the list ------------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Publish the list when it is due, and drop expired goals and results; called about ten times per second."""
        now = self._clock()
        for entry in [e for e in self._entries.values() if e.since is not None and e.since <= now - LIST_SECONDS]:
            del self._entries[entry.id]
            self._by_uuid.pop(entry.uuid or b"", None)
            self._changed = True
        for entry in [e for e in self._entries.values() if e.cancel_at is not None and e.cancel_at <= now]:
            entry.cancel_at = None
            if not entry.state.ended:
                self._send_cancel(entry)
        self._cancel_orphans()
        while self._results and self._results[0][0] <= now - RESULT_SECONDS:
            self._forget_result()
        if self._entries and now >= self._published + STATUS_SECONDS - _TICK_SLACK:
            self._changed = True
        self._flush()

    def _new_id(self) -> str:
        self._generated += 1
        secs, nsecs = self._now()
        return f"{self.name}-{self._generated}-{secs}.{nsecs:09}"

    def _add(self, entry: _ListedGoal) -> None:
        self._entries[entry.id] = entry
        if entry.uuid is not None:
            self._by_uuid[entry.uuid] = entry
        self._changed = True

    def _set(self, entry: _ListedGoal, state: Ros1State, text: str = "") -> None:
        entry.state, entry.text = state, text
        self._changed = True

    def _end(self, entry: _ListedGoal, state: Ros1State, body: bytes, text: str) -> None:
        self._set(entry, state, text)
        entry.since = self._clock()
        if entry.ours:
            self._publish_result(entry, body)

    def _lose(self, entry: _ListedGoal, text: str, body: bytes | None = None) -> None:
        """End a goal as ABORTED, although the hub's server has not reported its end."""
        if entry.ours and entry.uuid is not None:
            self._orphans.add(entry.uuid)
        self._end(entry, Ros1State.ABORTED, self._empty if body is None else body, text)

    def _cancel_orphans(self) -> None:
        """Cancel orphaned goals until the hub's server lists them as canceling or ended."""
        now, before = self._clock(), self._cancel_again
        self._cancel_again = {goal: before.get(goal, now) for goal in self._orphans.among(self._executing)}
        for goal in [goal for goal, due in self._cancel_again.items() if due <= now]:
            if goal not in before:
                _log.warning(
                    "%s: canceling a goal that continued after its client had been told that it ended", self.name
                )
            self._cancel_again[goal] = now + CANCEL_SECONDS
            self._output.call(CANCEL_GOAL, wire.cancel_request(GoalInfo(goal, ZERO)), lambda _reply: None)

    def _publish_result(self, entry: _ListedGoal, body: bytes) -> None:
        self._seq += 1
        payload = wire.action_outcome(self._seq, self._now(), entry.status, body)
        self._output.publish(RESULT, payload, entry.id)
        self._results.append((self._clock(), entry.id, len(payload)))
        self._result_bytes += len(payload)
        while len(self._results) > MAX_GOALS or self._result_bytes > MAX_RESULT_BYTES:
            self._forget_result()

    def _forget_result(self) -> None:
        _, goal, size = self._results.popleft()
        self._result_bytes -= size
        self._output.drop_result(goal)

    def _flush(self) -> None:
        now = self._clock()
        if not self._changed or (len(self._entries) > FEW_GOALS and now < self._published + CALM_SECONDS):
            return
        self._changed, self._published = False, now
        self._seq += 1
        self._output.publish(STATUS, wire.statuses(self._seq, self._now(), [e.status for e in self._entries.values()]))


def _failure(reply: bytes | CallError) -> str:
    """Return why a cancel request had no effect, "" if it had one."""
    if isinstance(reply, CallError):
        return str(reply)
    try:
        code, _ = wire.read_cancel_response(reply)
    except ConversionError as err:
        return str(err)
    return "the action server rejected it" if code == CancelCode.REJECTED else ""
