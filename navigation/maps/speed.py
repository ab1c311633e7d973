"""The mask of Nav2's SpeedFilter: how fast robots may go in areas.

A cell's limit is ``base + multiplier * value``, in metres per second where the filter's type is 2; the value 0 means no
limit (https://docs.nav2.org/configuration/packages/costmap-plugins/speed_filter.html).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navigation.maps.polygon import cells_of
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapinfo import MapGrid2DInfo

ABSOLUTE = 2
"""CostmapFilterInfo's type of limits in metres per second."""


@dataclass(frozen=True, eq=False)
class SpeedMask:
    """A mask, and what its values mean.

    Attributes:
        values: of shape (height, width), rows from the top one down: 1 to 100, or 0 where there is no limit.
        base: metres per second.
        multiplier: metres per second for each 1 of a value.
        type: CostmapFilterInfo's.
    """

    values: NDArray[np.int8]
    base: float
    multiplier: float
    type: int = ABSOLUTE


def speed_mask(info: MapGrid2DInfo, limits: Sequence[tuple[Map2DArea, float]]) -> SpeedMask:
    """The mask of areas that have a limit each; where they overlap, the lowest holds.

    The lowest and the highest limit of all are exact; one between may come out lower by up to a 99th of their
    difference, never higher.

    Args:
        info: the map.
        limits: areas, and metres per second above 0; areas on other maps do not matter.

    Raises:
        ValueError: a limit is not above 0, which would mean none.
    """
    here = [(area, limit) for area, limit in limits if area.map_id == info.name]
    for area, limit in here:
        if not (math.isfinite(limit) and limit > 0):
            raise ValueError(f"{limit} m/s is no limit of an area ({area.description!r}): it must be above 0")
    values = np.zeros((info.m_height, info.m_width), np.int8)
    low, high = min((limit for _, limit in here), default=1.0), max((limit for _, limit in here), default=1.0)
    multiplier = high / 100 if low == high else (high - low) / 99
    base = 0.0 if low == high else low - multiplier
    for area, limit in sorted(here, key=lambda pair: -pair[1]):
        part, inside = cells_of(info, area.points)
        values[part][inside] = min(max(math.floor((limit - base) / multiplier + 1e-6), 1), 100)
    return SpeedMask(values, base, multiplier)
