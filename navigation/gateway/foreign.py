"""The goals that a planner received from clients that bypass the gateway, and their results."""

from __future__ import annotations

import hashlib
import os
import platform
from typing import NamedTuple

from bridge.messages.actions import GoalState
from navigation.gateway.goal_list import GoalList
from navigation.status import State


class GoalMark:
    """Makes goal ids by which the gateway recognizes its own goals, even those from before it was restarted.

    Args:
        daemon: the daemon's name; the machine's name is part of the mark as well.
    """

    def __init__(self, daemon: str) -> None:
        text = f"midspan gateway {platform.node()} {daemon}"
        self._mark = hashlib.blake2b(text.encode(), digest_size=6).digest()
        self._run = os.urandom(4)

    def new_id(self) -> bytes:
        """Return a new goal id, 16 bytes."""
        return self._mark + self._run + os.urandom(6)

    def is_own(self, goal: bytes) -> bool:
        """Whether a gateway of this daemon made the id."""
        return goal.startswith(self._mark)

    def is_orphan(self, goal: bytes) -> bool:
        """Whether an earlier run of this gateway made the id."""
        return self.is_own(goal) and not goal.startswith(self._mark + self._run)


class ForeignEnd(NamedTuple):
    """How a foreign goal ended."""

    goal: bytes
    state: State
    reason: str


class ForeignGoals:
    """The foreign goals in a planner's list; ``lost`` is the reported reason if a new list lacks a goal."""

    def __init__(self, mark: GoalMark, lost: str) -> None:
        self._mark, self._lost = mark, lost
        self.active: tuple[bytes, ...] = ()  # the oldest first
        self.end: ForeignEnd | None = None  # how the last goal ended
        self.doubtful: bytes | None = None  # the newest goal when the list became invalid
        self._listed: frozenset[bytes] | None = None  # foreign goals of the last list; None once it is invalid

    def doubt(self) -> None:
        """Note that the list became invalid, so that the goal may end or continue unseen."""
        self._listed = None
        if self.active:
            self.doubtful = self.active[-1]

    def update(self, goals: GoalList) -> None:
        """Read a valid list.

        A goal that is new in it may have ended already, because lists that follow quickly on each other can be missed.
        """
        theirs = frozenset(goal for goal in goals.all if not self._mark.is_own(goal))
        listed, self._listed = self._listed, theirs
        new = () if listed is None else tuple(goal for goal in goals.all if goal in theirs - listed)
        before, self.active = self.active, tuple(goal for goal in goals.active if goal in theirs)
        for goal in (*before, *new):
            if goal not in self.active and goal != self.doubtful:
                self.end = ForeignEnd(goal, _end_of(goals.status(goal)), "")
        doubtful, self.doubtful = self.doubtful, None
        if doubtful is not None and doubtful not in self.active:
            status = goals.status(doubtful)
            known = status is not None and status.ended
            self.end = ForeignEnd(doubtful, _end_of(status), "" if known else self._lost)

    def settle(self) -> None:
        """Count the doubtful goal as ended, because the base stands still while the list is invalid."""
        if self.doubtful is not None:
            self.end = ForeignEnd(self.doubtful, State.ABORTED, self._lost)
            self.doubtful = None


def _end_of(status: GoalState | None) -> State:
    """Return how a goal ended: aborted if the list does not have it, or has not shown its end."""
    ends = {GoalState.SUCCEEDED: State.REACHED, GoalState.CANCELED: State.IDLE}
    return ends.get(status or GoalState.ABORTED, State.ABORTED)
