"""How a planner is getting on, as all of Midspan's planners and the gateway say it.

The states are YARP's (``yarp::dev::Nav2D::NavigationStatusEnum``, ``INavigation2D.h``), by their names.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, StrEnum
from typing import Any

STATUS = "midspan_msgs/msg/NavigationStatus"
NO_GOAL = bytes(16)


class State(StrEnum):
    """A planner's state."""

    IDLE = "idle"
    PREPARING = "preparing_before_move"
    MOVING = "moving"
    WAITING = "waiting_obstacle"
    REACHED = "goal_reached"
    ABORTED = "aborted"
    FAILING = "failing"
    PAUSED = "paused"
    THINKING = "thinking"
    ERROR = "error"

    @property
    def ended(self) -> bool:
        """Whether no goal is under way any more."""
        return self in _ENDED


_ENDED = frozenset((State.IDLE, State.REACHED, State.ABORTED, State.FAILING, State.ERROR))


class Fault(IntEnum):
    """Why a goal was not reached: ``error_code`` of ``nav2_msgs/action/NavigateToPose``; the numbers are ours."""

    NONE = 0
    BAD_GOAL = 9001
    UNKNOWN_FRAME = 9002
    OFF_THE_MAP = 9003
    GOAL_OCCUPIED = 9004
    START_OCCUPIED = 9005
    NO_PATH = 9006
    NO_MAP = 9007
    BLOCKED = 9008
    NO_LASER = 9009
    NOT_LOCALIZED = 9010
    NO_NAVIGATOR = 9011
    MAP_CHANGED = 9012
    BASE_STANDS = 9013
    OTHER = 9099

    @property
    def anywhere(self) -> bool:
        """Whether it is the robot's and not the way's: by another way it would be the same."""
        return self in (Fault.NO_LASER, Fault.NOT_LOCALIZED, Fault.BASE_STANDS)

    @classmethod
    def parse(cls, code: int) -> Fault:
        """The fault of a planner of Midspan's by its number; OTHER where it is none of ours."""
        try:
            return cls(code)
        except ValueError:
            return cls.OTHER


def status_message(
    stamp: Mapping[str, int],
    state: State,
    reason: str = "",
    code: int = Fault.NONE,
    *,
    goal_id: bytes = NO_GOAL,
    goal: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """A ``midspan_msgs/NavigationStatus``; the goal is a ``geometry_msgs/PoseStamped``, the code a `Fault`."""
    said = {"header": {"stamp": stamp}, "state": state.value, "reason": reason, "error_code": int(code)}
    return {**said, "goal_id": list(goal_id), **({} if goal is None else {"goal": goal})}
