"""What YARP's clients of a base call."""

# ruff: noqa: N802 - YARP's names

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from navigation.base_control.inputs import Input
from navigation.base_control.velocity import Velocity, of_degrees
from yarp_compat.dev.basecontrol import INavigation2DVelocityActionsMsgs, IOdometry2DMsgs
from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue

_OK, _FAILED = ReturnValue(ReturnCode.OK), ReturnValue(ReturnCode.METHOD_FAILED)


class Taking(Protocol):
    """Where commands go."""

    def take(self, target: Input, velocity: Velocity, timeout: float | None = None) -> bool:
        """Give a command to its input; whether it is obeyed."""

    def last(self, target: Input) -> Velocity | None:
        """The last command of an input while it holds."""


class Commands(INavigation2DVelocityActionsMsgs):
    """What ``mobileBaseVelocityControl_nwc_yarp`` calls.

    Args:
        doors: where commands go.
        target: the input that they command by.
    """

    def __init__(self, doors: Taking, target: Input) -> None:
        super().__init__()
        self._doors, self._target = doors, target

    def applyVelocityCommandRPC(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> ReturnValue:
        """Drive; refused where the command holds NaN, infinity or an absurd value."""
        taken = self._doors.take(self._target, of_degrees(x_vel, y_vel, theta_vel), timeout)
        return _OK if taken else _FAILED

    def getLastVelocityCommandRPC(self) -> tuple[ReturnValue, float, float, float]:
        """What this input commands; it fails where its last command has timed out, as ``velocityInputHandler`` does."""
        velocity = self._doors.last(self._target)
        if velocity is None:
            return _FAILED, 0.0, 0.0, 0.0
        return _OK, velocity.x, velocity.y, math.degrees(velocity.turn)


class Reset(IOdometry2DMsgs):
    """What ``odometry2D_nwc_yarp`` calls.

    Args:
        reset: begins the odometry at zero; called on the thread of the caller's connection.
    """

    def __init__(self, reset: Callable[[], None]) -> None:
        super().__init__()
        self._reset = reset

    def reset_odometry_RPC(self) -> ReturnValue:
        """Begin at zero from here."""
        self._reset()
        return _OK
