"""The current map's flags and areas as masks of Nav2's costmap filters (``nav2_costmap_2d``).

The keep-out mask is for a second layer of ROS 1's costmaps as well (``costmap_2d::StaticLayer``). Both masks lie on the
map's own cells. Topics are called as nav2_bringup calls them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bridge.stores.kinds import AREA
from bridge.stores.store import Store
from navigation.map2d_server.messages import GRID, Head, Message
from navigation.maps.grid import data_of, message_of
from navigation.maps.keepout import keepout_mask
from navigation.maps.speed import speed_mask
from yarp_compat.dev.area_behaviour import AreaBehaviour
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapgrid import MapGrid2D

KEEP_OUT, KEEP_OUT_INFO = "/keepout_filter_mask", "/keepout_costmap_filter_info"
SPEED, SPEED_INFO = "/speed_filter_mask", "/speed_costmap_filter_info"
INFO = "nav2_msgs/msg/CostmapFilterInfo"

_KEEP_OUT_FILTER = 0
"""``CostmapFilterInfo.type`` of KeepoutFilter; 1 and 2 are SpeedFilter's, in percent and metres per second."""


def messages(grid: MapGrid2D, store: Store, head: Head) -> dict[str, tuple[str, Message]]:
    """What to publish: type and message by topic.

    Args:
        grid: the current map, turned to yaw 0.
        store: where areas are.
        head: of the messages.
    """
    areas = [(area, behaviour) for area, behaviour in _areas(store) if area.map_id == grid.name and area.points]
    mask = keepout_mask(grid, [area for area, behaviour in areas if behaviour.keep_out])
    limits = [(area, behaviour.max_speed) for area, behaviour in areas if behaviour.max_speed is not None]
    speed = speed_mask(grid, limits)

    def on_cells(values: NDArray[np.int8]) -> tuple[str, Message]:
        return GRID, message_of(data_of(values), grid, head.frame, head.now_ns())

    def info(kind: int, mask_topic: str, base: float, multiplier: float) -> tuple[str, Message]:
        return INFO, {
            "header": head.header(),
            "type": kind,
            "filter_mask_topic": mask_topic,
            "base": base,
            "multiplier": multiplier,
        }

    return {
        KEEP_OUT: on_cells(mask),
        KEEP_OUT_INFO: info(_KEEP_OUT_FILTER, KEEP_OUT, 0.0, 1.0),
        SPEED: on_cells(speed.values),
        SPEED_INFO: info(speed.type, SPEED, speed.base, speed.multiplier),
    }


def _areas(store: Store) -> list[tuple[Map2DArea, AreaBehaviour]]:
    return [(area, store.behaviour(name)) for name, area in store.all(AREA).items()]
