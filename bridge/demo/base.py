"""A differential-drive base: kinematics, a command's time-out, and walls that it does not enter."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

TIMEOUT = 0.5
"""Seconds after its last command at which the base stands still."""

MAX_LINEAR = 0.5
"""Metres per second."""

MAX_ANGULAR = 1.5
"""Radians per second."""

RADIUS = 0.2
"""Metres; the base stops where it would come closer to a wall."""


@dataclass
class Base:
    """Pose in the frame ``odom`` in metres and radians, velocity in the base's own frame; ``now``: the last step's."""

    free: Callable[[float, float], bool]
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    linear: float = 0.0
    angular: float = 0.0
    commanded_at: float = -math.inf
    now: float = 0.0

    def command(self, linear: float, angular: float, now: float) -> None:
        """Obey a velocity command until the next one or its time-out; what is not a number is not obeyed."""
        if math.isfinite(linear) and math.isfinite(angular):
            self.linear = max(-MAX_LINEAR, min(MAX_LINEAR, linear))
            self.angular = max(-MAX_ANGULAR, min(MAX_ANGULAR, angular))
            self.commanded_at = now

    def step(self, seconds: float, now: float) -> None:
        """Move for a while; ``now`` is on the same clock as in `command`."""
        self.now = now
        if now - self.commanded_at > TIMEOUT:
            self.linear = self.angular = 0.0
        self.yaw = math.remainder(self.yaw + self.angular * seconds, math.tau)
        x = self.x + self.linear * seconds * math.cos(self.yaw)
        y = self.y + self.linear * seconds * math.sin(self.yaw)
        if self._fits(x, y):
            self.x, self.y = x, y
        else:
            self.linear = 0.0

    def _fits(self, x: float, y: float) -> bool:
        around = (math.tau * i / 16 for i in range(16))
        return all(self.free(x + RADIUS * math.cos(a), y + RADIUS * math.sin(a)) for a in around)
