"""What drives from waypoint to waypoint."""

from __future__ import annotations

from typing import Protocol

from navigation.constraints import Constraints
from navigation.pose import Pose
from navigation.status import Fault, State


class LocalNavigator(Protocol):
    """A local navigator: RobotGoto in process, or a client of one.

    Attributes:
        state: of the goal that was sent last, from the moment on at which it was sent; `State.ERROR` also where there
            is no navigator.
        reason: why it waits, failed or is not there.
        fault: the same as a number; `Fault.NONE` where it says none.
    """

    @property
    def state(self) -> State:
        """See above."""

    @property
    def reason(self) -> str:
        """See above."""

    @property
    def fault(self) -> Fault:
        """See above."""

    def send(self, pose: Pose, constraints: Constraints) -> None:
        """Drive there, instead of where it was sent before."""

    def cancel(self) -> None:
        """Stand still."""
