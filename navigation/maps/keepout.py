"""The mask that keeps planners away from cells: of Nav2's KeepoutFilter, or of a second layer of ROS 1's costmap.

Nav2 takes 100 for a lethal obstacle, and what is below for a cost in proportion, which planners avoid
(https://docs.nav2.org/configuration/packages/costmap-plugins/keepout_filter.html).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from navigation.maps.polygon import cells_of
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapflag import MapFlag, flags_of, looked_up
from yarp_compat.dev.mapgrid import MapGrid2D

KEEP_OUT = 100
"""What planners must not enter."""

TEMPORARY_OBSTACLE = 90
"""What a temporary obstacle weighs: 35 of a costmap's 254 less than a wall."""

ENLARGED_OBSTACLE = 60
"""What the room about an obstacle weighs, which the costmap's own inflation covers too."""

_WEIGHTS = {
    MapFlag.KEEP_OUT: KEEP_OUT,
    MapFlag.TEMPORARY_OBSTACLE: TEMPORARY_OBSTACLE,
    MapFlag.ENLARGED_OBSTACLE: ENLARGED_OBSTACLE,
}


def _by_flag() -> NDArray[np.uint8]:
    table = np.zeros(256, np.uint8)
    table[list(_WEIGHTS)] = list(_WEIGHTS.values())
    return table


_TABLE = _by_flag()


def keepout_mask(grid: MapGrid2D, areas: Iterable[Map2DArea] = ()) -> NDArray[np.int8]:
    """The mask of a map's flags.

    Args:
        grid: the map.
        areas: polygons to be kept out of; those on other maps do not matter.

    Returns:
        of shape (height, width), rows from the top one down: 100, the two weights, or 0.
    """
    mask = looked_up(grid.flags, _TABLE).view(np.int8)
    for area in areas:
        if area.map_id == grid.name:
            part, inside = cells_of(grid, area.points)
            mask[part][inside] = KEEP_OUT
    return mask


def flags_from(occupancy: NDArray[np.uint8], mask: NDArray[np.int8]) -> NDArray[np.uint8]:
    """The flags that a map and its mask say, both of shape (height, width) with the rows in the same order.

    Args:
        occupancy: 0 to 100 or 255.
        mask: of :func:`keepout_mask`; weights that are none of its own leave what the map says.
    """
    flags = flags_of(occupancy)
    for flag, weight in _WEIGHTS.items():
        flags[mask == weight] = flag
    return flags
