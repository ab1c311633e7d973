"""Pending cancel requests of hub clients to an actionlib server.

A goal and the request to cancel it use two connections to the server, so the request could arrive first. A request that
names a goal is sent once the server reports the goal, or after `CROSSING_SECONDS`. A request for several goals is sent
at once, and repeated for each goal that the server reports only later. After a reconnection to the cancel topic, all
requests are repeated whose goals show no effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bridge.adapters.ros1.actions import wire
from bridge.adapters.ros1.actions.goal import TrackedGoal
from bridge.adapters.ros1.actions.wire import ZERO, GoalId
from bridge.hub.endpoints.calls import Abandon, Done
from bridge.messages.actions import CancelCode, GoalState

CROSSING_SECONDS = 1.0
"""How long a request is held for a goal that was sent but is not in any of the server's lists yet."""

TERMINATED = wire.cancel_response(CancelCode.GOAL_TERMINATED, ())
REFUSED = wire.cancel_response(CancelCode.REJECTED, ())

ANY = bytes(wire.UUID_SIZE)


@dataclass(eq=False, slots=True)
class _Cancel:
    """A pending cancel request; ``single``: it names one goal; ``unsent`` is its message, None once it is sent."""

    goals: Sequence[TrackedGoal]
    single: bool
    done: Done
    since: float
    unsent: bytes | None

    @property
    def moot(self) -> bool:
        """Whether the named goal has ended."""
        return self.single and all(goal.refused or goal.state.ended for goal in self.goals)

    @property
    def complete(self) -> bool:
        """Whether the server has reported each goal as canceling or ended."""
        return self.unsent is None and not any(_is_untouched(goal) for goal in self.goals)


class CancelRequests:
    """Sends requests through ``publish``, and answers the clients; ``clock`` returns monotonic seconds.

    Attributes:
        reachable: whether the server is connected to the cancel topic.
    """

    def __init__(self, publish: Callable[[bytes], None], clock: Callable[[], float]) -> None:
        self._publish, self._clock = publish, clock
        self._open: list[_Cancel] = []
        self.reachable = False

    def add(self, request: GoalId, goals: Sequence[TrackedGoal], done: Done, *, single: bool) -> Abandon:
        """Begin a request for these goals; ``done`` receives its CancelGoal response."""
        cancel = _Cancel(goals, single, done, self._clock(), wire.goal_id(request))
        self._open.append(cancel)
        self.send()
        return lambda: self._open.remove(cancel) if cancel in self._open else None

    def send(self) -> None:
        """Send the requests that can be sent now, and answer those whose goals are all canceling or ended."""
        for cancel in self._open:
            if cancel.unsent is None:
                continue
            if cancel.moot:
                cancel.unsent = None
            elif self.reachable and not self._overtakes(cancel):
                self._publish(cancel.unsent)
                cancel.unsent = None
        self._answer()

    def _overtakes(self, cancel: _Cancel) -> bool:
        crossing = cancel.single and any(goal.unconfirmed for goal in cancel.goals)
        return crossing and self._clock() < cancel.since + CROSSING_SECONDS

    def on_confirmed(self, goal: TrackedGoal) -> None:
        """Cancel a goal that the server reports for the first time, if a request included it."""
        if any(goal in c.goals and c.unsent is None and not c.single for c in self._open):
            self._publish(wire.goal_id(GoalId(ZERO, goal.id)))

    def repeat(self) -> None:
        """Send again what the loss of a connection may have swallowed, for the goals that show no effect yet."""
        requested = [goal for cancel in self._open if cancel.unsent is None for goal in cancel.goals]
        for id_ in dict.fromkeys(goal.id for goal in requested if _is_untouched(goal)):
            self._publish(wire.goal_id(GoalId(ZERO, id_)))

    def _answer(self) -> None:
        """Answer the requests whose goals are all canceling or ended."""
        complete = [cancel for cancel in self._open if cancel.complete]
        self._open = [cancel for cancel in self._open if cancel not in complete]
        for cancel in complete:
            canceling = [g.info for g in cancel.goals if g.state in (GoalState.CANCELING, GoalState.CANCELED)]
            missed = cancel.single and not canceling
            cancel.done(TERMINATED if missed else wire.cancel_response(CancelCode.NONE, canceling))

    def refuse_unsent(self, before: float) -> None:
        """Refuse the requests made until ``before`` that are still unsent."""
        self._refuse([c for c in self._open if c.unsent is not None and c.since <= before])

    def refuse_all(self) -> None:
        """Refuse all requests, because the server can no longer confirm them."""
        self._refuse(self._open)

    def _refuse(self, cancels: Sequence[_Cancel]) -> None:
        self._open = [cancel for cancel in self._open if cancel not in cancels]
        for cancel in cancels:
            cancel.done(REFUSED)


def concerns(goal: TrackedGoal, uuid: bytes, stamp: wire.RosTime) -> bool:
    """Return whether a CancelGoal request with this UUID and stamp includes a goal."""
    if goal.uuid == uuid or (uuid == ANY and stamp == ZERO):
        return True
    return stamp != ZERO and goal.accepted and goal.stamp <= stamp


def _is_untouched(goal: TrackedGoal) -> bool:
    """Return whether a goal shows no effect of a cancel request."""
    return not (goal.refused or goal.lost or goal.state.ended or goal.state is GoalState.CANCELING)
