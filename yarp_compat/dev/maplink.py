"""Ways from one map to another, such as a lift, which YARP does not know: its clients see the two locations."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class MapLink:
    """Two locations on two maps between which robots change maps, either way; it has a name where it is kept.

    Attributes:
        first: a location's name.
        second: the name of the location on the other map.
        cost: what the change costs whoever plans a way, as so many metres of way.
    """

    first: str
    second: str
    cost: float = 0.0

    def __post_init__(self) -> None:
        if not (self.first and self.second and self.first != self.second):
            raise ValueError(f"a link joins two locations, not {self.first!r} and {self.second!r}")
        if not (math.isfinite(self.cost) and self.cost >= 0):
            raise ValueError(f"a link's cost is 0 or more, not {self.cost}")
