"""The state of a planner, as all planners in Midspan and the gateway publish it, and the reasons for failure.

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
        """Whether no goal is active."""
        return self in _ENDED


_ENDED = frozenset((State.IDLE, State.REACHED, State.ABORTED, State.FAILING, State.ERROR))


def has_ended(state: str) -> bool:
    """Return whether no goal is active in a published state; False for a missing or unknown one."""
    return state in _ENDED


class Fault(IntEnum):
    """Why a goal was not reached: ``error_code`` of ``nav2_msgs/action/NavigateToPose``, with Midspan's own numbers.

    No release of Nav2 uses codes from 10000 on. Names and numbers are those of ``midspan_msgs/msg/NavigationFault``.
    """

    NONE = 0
    BAD_GOAL = 20001
    UNKNOWN_FRAME = 20002
    OFF_THE_MAP = 20003
    GOAL_OCCUPIED = 20004
    START_OCCUPIED = 20005
    NO_PATH = 20006
    NO_MAP = 20007
    BLOCKED = 20008
    NO_LASER = 20009
    NOT_LOCALIZED = 20010
    NO_NAVIGATOR = 20011
    MAP_CHANGED = 20012
    BASE_STANDS = 20013
    MAY_MOVE = 20014
    SILENT = 20015
    OTHER = 20099

    @property
    def anywhere(self) -> bool:
        """Whether the robot is at fault, not the path, so that another path would not help."""
        return self in (Fault.NO_LASER, Fault.NOT_LOCALIZED, Fault.BASE_STANDS)

    @classmethod
    def parse(cls, code: int) -> Fault:
        """Return the fault of a number; OTHER for numbers that are not Midspan's."""
        try:
            return cls(code)
        except ValueError:
            return cls.OTHER


class PlannerStatus(NamedTuple):
    """The state of a planner and its reason, as text for people and as a code for programs."""

    state: State = State.IDLE
    reason: str = ""
    fault: int = Fault.NONE  #: a `Fault`, or another planner's code

    @property
    def words(self) -> str:
        """The state with its reason, as text."""
        return f"{self.state.value}: {self.reason}" if self.reason else self.state.value


def status_message(
    stamp: Mapping[str, int], status: PlannerStatus, *, goal_id: bytes = NO_GOAL, goal: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return a ``midspan_msgs/NavigationStatus``; the goal is a ``geometry_msgs/PoseStamped``."""
    state, reason, code = status
    message = {"header": {"stamp": stamp}, "state": state.value, "reason": reason, "error_code": int(code)}
    return {**message, "goal_id": list(goal_id), **({} if goal is None else {"goal": goal})}


class PlanError(ValueError):
    """A goal cannot be driven to; ``passing`` if only obstacles, which may move away, block the path."""

    def __init__(self, fault: Fault, reason: str, *, passing: bool = False) -> None:
        super().__init__(reason)
        self.fault, self.passing = fault, passing


def not_compiled() -> str:
    """Return why goals are refused, with the cure; "" if `kernels.DRIVING` are compiled, even from older sources."""
    missing = tuple(name for name in kernels.state().missing if name in kernels.DRIVING)
    return f"goals are refused, since {kernels.KernelState(missing, ())}: {kernels.CURE}" if missing else ""


class Compiled:
    """The result of `not_compiled` when a module started: imported kernels do not change afterwards."""

    def __init__(self) -> None:
        self.trouble = not_compiled()

    def check(self) -> None:
        """Raise `PlanError` if goals are refused."""
        if self.trouble:
            raise PlanError(Fault.OTHER, self.trouble)
