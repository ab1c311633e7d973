"""A turn of a laser in numbers, as the simulator measures it and as modules read it from the hub or from YARP."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Turn:
    """A turn of a laser: of the hub, of YARP, of the simulator."""

    time_ns: int  #: when it was made
    first: float  #: the first beam's direction on the laser, radians
    step: float  #: from each beam to the next, radians
    nearest: float  #: the least distance that the laser measures, metres
    farthest: float  #: the distance from which on it measures nothing
    # metres; infinite where nothing was hit, NaN where nothing is known, minus infinity where it is too near
    ranges: NDArray[np.float64]

    def turned_over(self) -> Turn:
        """The same of a laser that hangs upside down: seen from above, its beams go round the other way."""
        return replace(self, first=-self.first, step=-self.step)
