"""Whether localisation has moved the robot further than it can have driven."""

from __future__ import annotations

import math

from navigation.pose import Pose, wrapped

_TURNED = math.radians(30.0)
_FRESH = 1.0
"""Seconds after which a pose says nothing of the next."""


class Jumps:
    """Compares each pose with the one before.

    Attributes:
        pose: the last one; None before the first.
    """

    def __init__(self) -> None:
        self.pose: Pose | None = None
        self._at = -math.inf

    def add(self, now: float, pose: Pose, least: float) -> str:
        """Take up a pose; returns what is to be said of a jump, or nothing.

        Args:
            now: seconds.
            pose: the robot's on the map.
            least: metres that are a jump, or 30 degrees.
        """
        before, passed = self.pose, now - self._at
        self.pose, self._at = pose, now
        if before is None or not 0 <= passed < _FRESH:
            return ""
        moved, turned = pose.distance(before), abs(wrapped(pose.theta - before.theta))
        if moved > least + passed or turned > _TURNED + math.pi * passed:
            return f"localisation moved the robot by {moved:.2f} m and {math.degrees(turned):.0f} degrees at once"
        return ""
