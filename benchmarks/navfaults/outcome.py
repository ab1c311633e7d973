"""The outcome of a fault."""

from __future__ import annotations

import math
from dataclasses import dataclass

from typing_extensions import override


@dataclass
class Outcome:
    """The motion of the robot, the end of the goal, and the status that the client received.

    Attributes:
        key: the fault's key.
        still: seconds from the fault until the wheels stood; infinite if they did not.
        distance: meters that the robot moved meanwhile.
        reported: state and reason that the client received.
        onward: seconds from the end of the fault until the robot continued; infinite if it did not.
        anew: seconds from sending the goal again until the robot drove; infinite if it did not, or no goal was sent.
        end: final state of the client's goal, and its reason.
        wrong: the deviation from the expected outcome.
    """

    key: str
    still: float = math.inf
    distance: float = 0.0
    reported: str = ""
    onward: float = math.inf
    anew: float = math.inf
    end: str = ""
    wrong: str = ""

    @override
    def __str__(self) -> str:
        parts = [
            f"still after {self.still:.2f} s ({self.distance * 100:.0f} cm)"
            if math.isfinite(self.still)
            else "drove on"
        ]
        if self.reported:
            parts.append(f"client: {self.reported}")
        if math.isfinite(self.onward):
            parts.append(f"continued {self.onward:.2f} s after the end of the fault")
        if self.end:
            parts.append(f"goal: {self.end}")
        if math.isfinite(self.anew):
            parts.append(f"goal sent again, drove after {self.anew:.2f} s")
        if self.wrong:
            parts.append(f"WRONG: {self.wrong}")
        return "; ".join(parts)
