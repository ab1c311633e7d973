"""The goal of the hub that a planner drives to, and its end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.modules.action_server import Goal
from bridge.modules.loop import Loop
from navigation.status import NO_GOAL, Fault, State


class CurrentGoal:
    """One goal at a time; what is driven to for others than clients of the hub is none. On the module's thread.

    Args:
        loop: the module's.
        stop: called with the reason once a client has cancelled it; it then ends the goal.

    Attributes:
        goal: None where there is none.
    """

    def __init__(self, loop: Loop, stop: Callable[[str], Any]) -> None:
        self._loop, self._stop = loop, stop
        self.goal: Goal | None = None

    @property
    def id(self) -> bytes:
        """Its 16 bytes; zeros where there is none."""
        return self.goal.id if self.goal else NO_GOAL

    def replace(self, goal: Goal | None) -> None:
        """Another takes its place."""
        self.end(State.IDLE, Fault.OTHER, "another goal took its place")
        self.goal = goal
        if goal is not None:
            goal.execute()

    def cancel(self, goal: Goal) -> bool:
        """A client cancels a goal; whether it is this one."""
        if goal is not self.goal:
            return False
        self._loop.post(lambda: self._stop("cancelled") if goal is self.goal else None)
        return True

    def end(self, state: State, fault: Fault, reason: str) -> None:
        """Tell its client how it ended: `State.IDLE` where it was stopped."""
        goal, self.goal = self.goal, None
        if goal is None:
            return
        end = {State.REACHED: goal.succeed, State.IDLE: goal.canceled}.get(state, goal.abort)
        end(result(fault, "" if state is State.REACHED else reason))


def result(fault: Fault, reason: str) -> dict[str, Any]:
    """The result of a ``NavigateToPose`` goal."""
    return {"error_code": int(fault), "error_msg": reason}


def duration(seconds: float) -> dict[str, int]:
    """``builtin_interfaces/msg/Duration``; what is below 0 is none, and what is too long the longest."""
    whole = min(max(seconds, 0.0), 2e9)
    return {"sec": int(whole), "nanosec": int(whole % 1 * 1e9)}
