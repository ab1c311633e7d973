"""The state of a planner, as all of Midspan's planners and the gateway publish it, and why a goal is refused.

The states are YARP's (``yarp::dev::Nav2D::NavigationStatusEnum``, ``INavigation2D.h``), by their names.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple

import bridge.kernels as kernels

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
    MAY_MOVE = 9014
    SILENT = 9015
    OTHER = 9099

    @property
    def anywhere(self) -> bool:
        """Whether it is the robot's and not the way's: by another way it would be the same."""
        return self in (Fault.NO_LASER, Fault.NOT_LOCALIZED, Fault.BASE_STANDS)

    @classmethod
    def parse(cls, code: int) -> Fault:
        """The fault of a number; OTHER for a number that is not ours."""
        try:
            return cls(code)
        except ValueError:
            return cls.OTHER


class PlannerStatus(NamedTuple):
    """The state of a planner and its reason, in words for people and as a number for programs."""

    state: State = State.IDLE
    reason: str = ""
    fault: int = Fault.NONE  #: a `Fault`, or a number of another planner's own

    @property
    def words(self) -> str:
        """The state with its reason."""
        return f"{self.state.value}: {self.reason}" if self.reason else self.state.value


def status_message(
    stamp: Mapping[str, int], status: PlannerStatus, *, goal_id: bytes = NO_GOAL, goal: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """A ``midspan_msgs/NavigationStatus``; the goal is a ``geometry_msgs/PoseStamped``."""
    state, reason, code = status
    said = {"header": {"stamp": stamp}, "state": state.value, "reason": reason, "error_code": int(code)}
    return {**said, "goal_id": list(goal_id), **({} if goal is None else {"goal": goal})}


class PlanError(ValueError):
    """There is no way; ``passing``: it may be there soon, as only what the laser sees stands in the way."""

    def __init__(self, fault: Fault, reason: str, *, passing: bool = False) -> None:
        super().__init__(reason)
        self.fault, self.passing = fault, passing


def not_compiled() -> str:
    """Why no goal is driven to, with the cure; "" where all kernels are compiled, also of other sources."""
    state = kernels.state()
    return f"driving is refused, since {state}: {kernels.CURE}" if state.missing else ""


class Compiled:
    """What was found as a module started: what it has imported by then does not change any more."""

    def __init__(self) -> None:
        self.trouble = not_compiled()  # see `not_compiled`

    def check(self) -> None:
        """Raise `PlanError` with why no goal is driven to."""
        if self.trouble:
            raise PlanError(Fault.OTHER, self.trouble)
