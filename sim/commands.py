"""What the base is told. Nothing outlives its time-out, and nothing is queued."""

from __future__ import annotations

import math

import numpy as np

from sim.base import Base, Floats, Twist
from sim.errors import SimError

_ABSURD = 100.0
"""A velocity greater than this, in metres or radians per second, is a mistake and not a wish."""


class Drive:
    """Turns velocity commands into wheel velocities, within the robot's limits, when the simulator drives by itself.

    Args:
        base: what is driven.
    """

    def __init__(self, base: Base) -> None:
        self._limits = base.robot.limits
        believed = base.robot.believed
        self._matrix = base.matrix(believed.radius, believed.separation)
        self._greatest = base.robot.wheels.max_velocity
        self._lateral = base.robot.kinematics != "differential"
        self._wanted = np.zeros(3)
        self._until = 0
        self._now = np.zeros(3)

    def command(self, twist: Twist, now_ns: int) -> None:
        """Drive so from now on, until the time-out.

        Raises:
            SimError: it is not finite, or absurd; the last command stays.
        """
        if not all(math.isfinite(v) and abs(v) <= _ABSURD for v in twist):
            msg = f"the velocity {tuple(twist)} is refused: it is not finite, or greater than {_ABSURD:g}"
            raise SimError(msg)
        angular = math.radians(self._limits.angular)
        x, y = twist.x, twist.y if self._lateral else 0.0
        speed = math.hypot(x, y)
        share = min(1.0, self._limits.linear / speed) if speed else 1.0
        self._wanted = np.array([x * share, y * share, min(angular, max(-angular, twist.yaw))])
        self._until = now_ns + round(self._limits.timeout * 1e9)

    def halt(self) -> None:
        """Forget what was wanted; the base brakes."""
        self._until = 0

    def wheels(self, now_ns: int, seconds: float) -> Floats:
        """The wheels' velocities for the next so many seconds, radians per second."""
        wanted = self._wanted if now_ns < self._until else np.zeros(3)
        linear = self._limits.linear_acceleration * seconds
        change = wanted - self._now
        along = math.hypot(change[0], change[1])
        if along > linear:
            change[:2] *= linear / along
        angular = math.radians(self._limits.angular_acceleration) * seconds
        change[2] = min(angular, max(-angular, change[2]))
        self._now = self._now + change
        wheels: Floats = self._matrix @ self._now
        fastest = float(np.abs(wheels).max())
        return wheels * (self._greatest / fastest) if fastest > self._greatest else wheels
