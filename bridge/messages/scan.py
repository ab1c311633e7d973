"""A laser scan as numbers, from the simulator, the hub or YARP."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class LaserScan:
    """One scan of a laser, in the laser's frame."""

    time_ns: int  #: the time of the scan
    first: float  #: the first beam's direction on the laser, radians
    step: float  #: the angle from each beam to the next, radians
    nearest: float  #: the laser's minimum range, meters
    farthest: float  #: the laser's maximum range, meters
    # meters; infinite for no echo, NaN for no valid measurement, minus infinity for an object below the minimum range
    ranges: NDArray[np.float64]

    def turned_over(self) -> LaserScan:
        """Return the scan of a laser mounted upside down: seen from above, its beams are in the opposite order."""
        return replace(self, first=-self.first, step=-self.step)
