"""The states of a goal in ROS 1 and ROS 2, and their mapping; docs/sides/actions.md has them as a table."""

from __future__ import annotations

import re
import uuid
from collections.abc import Mapping
from enum import IntEnum

from bridge.messages.actions import GoalState


class Ros1State(IntEnum):
    """actionlib_msgs/GoalStatus (https://docs.ros.org/en/noetic/api/actionlib_msgs/html/msg/GoalStatus.html)."""

    PENDING = 0
    ACTIVE = 1
    PREEMPTED = 2
    SUCCEEDED = 3
    ABORTED = 4
    REJECTED = 5
    PREEMPTING = 6
    RECALLING = 7
    RECALLED = 8
    LOST = 9

    @property
    def ended(self) -> bool:
        """Whether the state is final."""
        return self in _ENDED

    @classmethod
    def parse(cls, number: int) -> Ros1State:
        """Return the state of a number from the network; LOST if actionlib does not define it."""
        try:
            return cls(number)
        except ValueError:
            return cls.LOST


_ENDED = frozenset(Ros1State) - {Ros1State.PENDING, Ros1State.ACTIVE, Ros1State.PREEMPTING, Ros1State.RECALLING}

TO_ROS2: Mapping[Ros1State, GoalState] = {
    Ros1State.PENDING: GoalState.ACCEPTED,
    Ros1State.ACTIVE: GoalState.EXECUTING,
    Ros1State.RECALLING: GoalState.CANCELING,
    Ros1State.PREEMPTING: GoalState.CANCELING,
    Ros1State.SUCCEEDED: GoalState.SUCCEEDED,
    Ros1State.PREEMPTED: GoalState.CANCELED,
    Ros1State.RECALLED: GoalState.CANCELED,
    Ros1State.ABORTED: GoalState.ABORTED,
    Ros1State.REJECTED: GoalState.ABORTED,
    Ros1State.LOST: GoalState.ABORTED,
}
"""For accepted goals; a goal of the hub that is REJECTED, RECALLED or LOST before it is accepted counts as rejected."""

TO_ROS1: Mapping[GoalState, Ros1State] = {
    GoalState.UNKNOWN: Ros1State.ABORTED,
    GoalState.ACCEPTED: Ros1State.PENDING,
    GoalState.EXECUTING: Ros1State.ACTIVE,
    GoalState.CANCELING: Ros1State.PREEMPTING,
    GoalState.SUCCEEDED: Ros1State.SUCCEEDED,
    GoalState.CANCELED: Ros1State.PREEMPTED,
    GoalState.ABORTED: Ros1State.ABORTED,
}
"""For executing goals; a goal that never executed becomes RECALLING and RECALLED, not PREEMPTING and PREEMPTED."""


# -- ids ---------------------------------------------------------------------------------------------------------------
# A goal from the hub has the id ``midspan-<uuid>`` on ROS 1, so that the UUID follows from the id even after a restart
# of the worker. A goal of a ROS 1 client gets a version 5 UUID (RFC 9562) of the action's name and the goal's id.

PREFIX = "midspan-"

_OURS = re.compile(PREFIX + "([0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12})")
_SPACE = uuid.uuid5(uuid.NAMESPACE_URL, "midspan:actionlib")


def text_of(goal: bytes) -> str:
    """Return the ROS 1 id of a goal of the hub."""
    return f"{PREFIX}{uuid.UUID(bytes=goal)}"


def uuid_in(text: str) -> bytes | None:
    """Return the UUID in a ROS 1 id from `text_of`, None for any other id."""
    ours = _OURS.fullmatch(text)
    return uuid.UUID(ours.group(1)).bytes if ours else None


def uuid_of(action: str, text: str) -> bytes:
    """Return the UUID of any ROS 1 id, always the same for the same action and id."""
    return uuid_in(text) or uuid.uuid5(_SPACE, f"{action} {text}".encode(errors="surrogateescape").hex()).bytes
