"""A goal that RobotGoto drives to."""

from __future__ import annotations

import math
from dataclasses import dataclass

from navigation.constraints import Constraints
from navigation.pose import Pose


@dataclass
class Task:
    """A goal under way.

    Attributes:
        pose: on the map; theta is NaN where any heading will do.
        asked: its constraints.
        near: whether it is there, but for the heading.
        best: the least that was left of the way, metres; ``best_turn`` of the heading, radians.
        progress_at: when that was, seconds; None before the first step.
    """

    pose: Pose
    asked: Constraints
    near: bool = False
    best: float = math.inf
    best_turn: float = math.inf
    progress_at: float | None = None

    @property
    def heading(self) -> bool:
        """Whether its heading matters."""
        return self.asked.heading and not self.asked.through and math.isfinite(self.pose.theta)
