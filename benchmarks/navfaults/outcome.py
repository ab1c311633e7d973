"""What a fault led to."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass
class Outcome:
    """What happened, and what the client heard.

    Attributes:
        key: the fault's.
        still: seconds from the fault until the wheels stood; infinite where they did not.
        distance: meters that the robot went meanwhile.
        reported: what the client heard of it: state and reason.
        onward: seconds from the end of the fault until the robot drove on; infinite where it was not to, or did not.
        anew: seconds from asking for the goal anew until the robot drove; infinite where nobody did, or it did not.
        end: how the client's goal ended, and its reason.
        wrong: what was not as it should be.
    """

    key: str
    still: float = math.inf
    distance: float = 0.0
    reported: str = ""
    onward: float = math.inf
    anew: float = math.inf
    end: str = ""
    wrong: str = ""

    def __str__(self) -> str:
        parts = [
            f"still after {self.still:.2f} s ({self.distance * 100:.0f} cm)"
            if math.isfinite(self.still)
            else "drove on"
        ]
        if self.reported:
            parts.append(f"client: {self.reported}")
        if math.isfinite(self.onward):
            parts.append(f"went on {self.onward:.2f} s after the end of the fault")
        if self.end:
            parts.append(f"goal: {self.end}")
        if math.isfinite(self.anew):
            parts.append(f"asked anew, it drove after {self.anew:.2f} s")
        if self.wrong:
            parts.append(f"WRONG: {self.wrong}")
        return "; ".join(parts)
