"""A client's drive: its targets, and the state of the current target."""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field

from bridge.client.actions import SentGoal
from bridge.messages.actions import GoalState
from bridge.modules.action_server import Goal
from bridge.state_machine import Machine
from navigation.gateway.machine import DRIVE, DriveEvent, DriveState
from navigation.gateway.targets import Target

LIST_SECONDS = 5.0
"""A replaced goal counts as ended if the planner's list still lacks it this long after the request that replaced it."""


def _machine() -> Machine[DriveState, DriveEvent]:
    return Machine(DRIVE, DriveState.WAITING)


def _now() -> float:
    return time.monotonic()


@dataclass(eq=False)
class ClientDrive:
    """The request of one client. The client's own goal stays active while the drive is paused or sent again."""

    targets: Sequence[Target]  #: the goals, one after the other
    client: str  #: the client, for messages
    goal: Goal | None = None  #: the client's own goal, if it used the action
    name: str = ""  #: the place's name, if the client gave one
    at: int = 0  #: index of the current target
    several: bool = False  #: whether the planner's goal contains all remaining targets
    machine: Machine[DriveState, DriveEvent] = field(default_factory=_machine)
    sent: SentGoal | None = None  #: the planner's current or last goal
    replaced: list[SentGoal] = field(default_factory=list)  #: the planner's earlier goals, until they end
    followed: SentGoal | None = None  #: the goal whose result was requested again after a loss of contact
    sent_at: float = 0.0  #: when the goal was last sent (monotonic)
    released: bool = True  #: whether the planner is known to have none of the drive's goals
    path_canceled: bool = False  #: whether another action that moves the base (Nav2's controller) was asked to cancel
    reason: str = ""  #: the reason for stopping or waiting
    aborted: tuple[int, str] | None = None  #: code and reason of an abort that is reported when the base stands
    pause_seconds: float = math.inf  #: the length of the pause
    due: float = 0.0  #: the earliest time to send the goal again (monotonic)
    transform_missing_at: float = 0.0  #: when the planner began to miss a transform (monotonic); 0: none is missing
    asked_at: float = field(default_factory=_now)  #: when the client last requested motion (monotonic)
    began: float = field(default_factory=_now)
    own_id: bytes = field(default_factory=lambda: uuid.uuid4().bytes)

    @property
    def state(self) -> DriveState:
        return self.machine.state

    @property
    def id(self) -> bytes:
        """The client's goal id, or a generated one."""
        return self.own_id if self.goal is None else self.goal.id

    @property
    def target(self) -> Target:
        return self.targets[self.at]

    @property
    def left(self) -> Sequence[Target]:
        """The targets that have not been reached."""
        return self.targets[self.at :]

    @property
    def unlisted(self) -> Sequence[SentGoal]:
        """The replaced goals that the planner may have although they are not in its list yet."""
        return self.replaced if time.monotonic() < self.asked_at + LIST_SECONDS else ()

    @property
    def begun(self) -> bool:
        """Whether a planner may have accepted any of the drive's goals, perhaps without an answer."""
        return not self.released or (self.sent is not None and self.sent.accepted is not False)

    @property
    def forgotten(self) -> bool:
        """Whether the planner no longer has the drive's goal, even if an earlier list shows the goal."""
        return self.sent is not None and self.sent is self.followed and self.sent.status is GoalState.UNKNOWN

    def replace(self, before: ClientDrive) -> None:
        """Follow another drive, to whose goals the planner may still drive."""
        self.released = before.released
        goals = (*before.replaced, before.sent)
        self.replaced = [sent for sent in goals if sent is not None and sent.active]

    def excuse(self, seconds: float) -> None:
        """Do not count time for which this process stood still."""
        self.machine.excuse(seconds)
        self.asked_at = min(_now(), self.asked_at + seconds)
        if self.transform_missing_at:
            self.transform_missing_at = min(_now(), self.transform_missing_at + seconds)

    def begin_stop(self, event: DriveEvent) -> bool:
        """Handle a client's request to pause or stop; return whether it changes the state.

        If the planner has just ended the goal without a code, its controller may drive on, so that has to end first.
        """
        if self.state is DriveState.JUDGING and self.begun:
            self.released = False
        return self.machine.on(event)

    def end(self, status: GoalState, code: int, reason: str) -> None:
        """End the drive, and the client's own goal if it used the action."""
        self.machine.on(DriveEvent.END)
        if self.goal is None:
            return
        result = {"error_code": int(code), "error_msg": reason}
        if status is GoalState.SUCCEEDED:
            self.goal.succeed({})
        elif status is GoalState.CANCELED:
            self.goal.canceled(result)
        else:
            self.goal.abort(result)
