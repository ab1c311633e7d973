"""What an action's two ends share: its five names, and the states of a goal (action_msgs/msg/GoalStatus)."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

CANCEL = "action_msgs/srv/CancelGoal"
STATUSES = "action_msgs/msg/GoalStatusArray"


class Status(IntEnum):
    """A goal's state."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def terminal(self) -> bool:
        """Whether the goal has ended."""
        return self >= Status.SUCCEEDED


class Parts(NamedTuple):
    """The names, or the types, of an action's services and topics."""

    send_goal: str
    get_result: str
    cancel_goal: str
    feedback: str
    status: str


def parts(name: str, sep: str = "/_action/") -> Parts:
    """The names of an action's parts; with ``sep="_"`` the types of those that are the action's own."""
    if sep == "_":
        return Parts(f"{name}_SendGoal", f"{name}_GetResult", CANCEL, f"{name}_FeedbackMessage", STATUSES)
    words = ("send_goal", "get_result", "cancel_goal", "feedback", "status")
    return Parts(*(f"{name}{sep}{word}" for word in words))
