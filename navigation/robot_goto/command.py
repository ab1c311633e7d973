"""What RobotGoto commands, and how it is getting on."""

from __future__ import annotations

import math
from typing import NamedTuple

from navigation.status import Fault, State


class Command(NamedTuple):
    """A velocity in the robot's frame: m/s, m/s, rad/s."""

    vx: float = 0.0
    vy: float = 0.0
    omega: float = 0.0

    @property
    def speed(self) -> float:
        """m/s, whatever the direction."""
        return math.hypot(self.vx, self.vy)

    @property
    def polar(self) -> tuple[float, float, float]:
        """Direction (degrees), speed (m/s) and turn (deg/s), as YARP's ``control:o`` has them."""
        direction = math.degrees(math.atan2(self.vy, self.vx)) if self.speed else 0.0
        return direction, self.speed, math.degrees(self.omega)


STILL = Command()


class Status(NamedTuple):
    """How the goal is getting on.

    Attributes:
        state: the state.
        reason: why, in words for people; empty where there is nothing to say.
        fault: why the goal was not reached, as a number for programs.
    """

    state: State = State.IDLE
    reason: str = ""
    fault: Fault = Fault.NONE

    @property
    def ended(self) -> bool:
        """Whether no goal is under way any more."""
        return self.state.ended
