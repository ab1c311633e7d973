"""The names and types of the five parts of a ROS 2 action, and the states of a goal.

See https://design.ros2.org/articles/actions.html; the messages are those of action_msgs (Jazzy).
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

SEND_GOAL, GET_RESULT, CANCEL_GOAL = "send_goal", "get_result", "cancel_goal"
FEEDBACK, STATUS = "feedback", "status"

SERVICES = (SEND_GOAL, GET_RESULT, CANCEL_GOAL)
TOPICS = (FEEDBACK, STATUS)
PARTS = (*SERVICES, *TOPICS)

CANCEL = "action_msgs/srv/CancelGoal"
STATUSES = "action_msgs/msg/GoalStatusArray"

BETWEEN = "/_action/"  # between the name of an action and the name of a part
ENDINGS = {SEND_GOAL: "_SendGoal", GET_RESULT: "_GetResult", FEEDBACK: "_FeedbackMessage"}
"""The suffixes that turn an action's type into the types of those parts that are specific to the action."""

COMMON = {CANCEL_GOAL: CANCEL, STATUS: STATUSES}  # the types of the parts that all actions have in common


class GoalState(IntEnum):
    """The states of action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def ended(self) -> bool:
        """Whether this state is final."""
        return self >= GoalState.SUCCEEDED

    @classmethod
    def parse(cls, number: int) -> GoalState:
        """Return the state for a number from the network; UNKNOWN for a number that ROS 2 does not define."""
        try:
            return cls(number)
        except ValueError:
            return cls.UNKNOWN


class CancelCode(IntEnum):
    """The return codes of action_msgs/srv/CancelGoal."""

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL_ID = 2
    GOAL_TERMINATED = 3


def part_name(action: str, part: str) -> str:
    """Return the full name of one part of an action."""
    return f"{action}{BETWEEN}{part}"


def split(name: str) -> tuple[str, str]:
    """Split the name of an action's topic or service into action and part; both are "" if it belongs to no action."""
    if BETWEEN not in name:  # true of most names
        return "", ""
    action, _, part = name.rpartition(BETWEEN)
    return (action, part) if action and part in PARTS else ("", "")


class ActionParts(NamedTuple):
    """The names, or the types, of an action's services and topics."""

    send_goal: str
    get_result: str
    cancel_goal: str
    feedback: str
    status: str


def names(action: str) -> ActionParts:
    """Return the names of an action's parts."""
    return ActionParts(*(part_name(action, part) for part in PARTS))


def types(action_type: str) -> ActionParts:
    """Return the types of an action's parts."""
    return ActionParts(*(f"{action_type}{ENDINGS[part]}" if part in ENDINGS else COMMON[part] for part in PARTS))
