"""The states of a goal in either world, and which stands for which; docs/actions.md has them as a table."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum


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
        """Whether a goal stays in it."""
        return self in _ENDED

    @classmethod
    def parse(cls, number: int) -> Ros1State:
        """The state of a number from the network; one that actionlib does not know is LOST."""
        try:
            return cls(number)
        except ValueError:
            return cls.LOST


class Ros2State(IntEnum):
    """action_msgs/msg/GoalStatus (https://github.com/ros2/rcl_interfaces, jazzy)."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def ended(self) -> bool:
        """Whether a goal stays in it."""
        return self >= Ros2State.SUCCEEDED

    @classmethod
    def parse(cls, number: int) -> Ros2State:
        """The state of a number from the network; one that ROS 2 does not know is UNKNOWN."""
        try:
            return cls(number)
        except ValueError:
            return cls.UNKNOWN


class CancelCode(IntEnum):
    """The return codes of action_msgs/srv/CancelGoal (jazzy)."""

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL_ID = 2
    GOAL_TERMINATED = 3


_ENDED = frozenset(
    {
        Ros1State.PREEMPTED, Ros1State.SUCCEEDED, Ros1State.ABORTED,
        Ros1State.REJECTED, Ros1State.RECALLED, Ros1State.LOST,
    }
)  # fmt: skip

TO_ROS2: Mapping[Ros1State, Ros2State] = {
    Ros1State.PENDING: Ros2State.ACCEPTED,
    Ros1State.ACTIVE: Ros2State.EXECUTING,
    Ros1State.RECALLING: Ros2State.CANCELING,
    Ros1State.PREEMPTING: Ros2State.CANCELING,
    Ros1State.SUCCEEDED: Ros2State.SUCCEEDED,
    Ros1State.PREEMPTED: Ros2State.CANCELED,
    Ros1State.RECALLED: Ros2State.CANCELED,
    Ros1State.ABORTED: Ros2State.ABORTED,
    Ros1State.REJECTED: Ros2State.ABORTED,
    Ros1State.LOST: Ros2State.ABORTED,
}
"""Of an accepted goal; one that is REJECTED or RECALLED before it was accepted is rejected on ROS 2."""

TO_ROS1: Mapping[Ros2State, Ros1State] = {
    Ros2State.UNKNOWN: Ros1State.ABORTED,
    Ros2State.ACCEPTED: Ros1State.PENDING,
    Ros2State.EXECUTING: Ros1State.ACTIVE,
    Ros2State.CANCELING: Ros1State.PREEMPTING,
    Ros2State.SUCCEEDED: Ros1State.SUCCEEDED,
    Ros2State.CANCELED: Ros1State.PREEMPTED,
    Ros2State.ABORTED: Ros1State.ABORTED,
}
"""Of an executing goal; one that never executed goes to RECALLING and RECALLED in place of the two of a preemption."""
