"""`nav_msgs/OccupancyGrid` of a map of YARP, and back.

ROS's rows go from the bottom up and its numbers are signed: 0 to 100, or -1 for unknown. Its origin is another one
where the map is turned, see :mod:`yarp_compat.dev.mapinfo`; every cell stays in its place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navigation.maps.kernels import joining, parting
from yarp_compat.dev.mapflag import MAX_CELLS, too_large
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.mapinfo import MapGrid2DInfo, MapGrid2DOrigin

Message = dict[str, Any]


def to_grid(grid: MapGrid2D, frame: str = "map", stamp_ns: int = 0) -> Message:
    """The OccupancyGrid of a map.

    Walls and unknown cells of the flags are walls and unknown in it, whatever the occupancy says of them: a wall that
    somebody painted is one to all planners. Keep-out cells and obstacles are in :mod:`navigation.maps.keepout`'s mask.
    """
    return message_of(occupied(grid), grid, frame, stamp_ns)


def message_of(data: NDArray[np.int8], info: MapGrid2DInfo, frame: str = "map", stamp_ns: int = 0) -> Message:
    """The OccupancyGrid of data in ROS's order (:func:`data_of`), which lies as a map does."""
    made = info_of(info, stamp_ns)
    return {"header": {"stamp": made["map_load_time"], "frame_id": frame}, "info": made, "data": data}


def info_of(info: MapGrid2DInfo, stamp_ns: int) -> Message:
    """The `nav_msgs/MapMetaData` of a map at a time in nanoseconds."""
    stamp = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
    x, y, yaw = info.origin.to_ros()
    return {
        "map_load_time": stamp,
        "resolution": info.resolution,
        "width": info.m_width,
        "height": info.m_height,
        "origin": {
            "position": {"x": x, "y": y, "z": 0.0},
            "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)},
        },
    }


def data_of(values: NDArray[np.int8]) -> NDArray[np.int8]:
    """Values of shape (height, width), rows from the top one down, in ROS's order, of shape (height * width,)."""
    return np.ascontiguousarray(values[::-1]).reshape(-1)


def occupied(grid: MapGrid2D) -> NDArray[np.int8]:
    """How surely each cell is occupied, joined with the flags of walls and unknown cells, as :func:`to_grid` says.

    Returns:
        0 to 100, or -1, of shape (height * width,), rows from the bottom up.
    """
    values = np.empty((grid.m_height, grid.m_width), np.uint8)
    joining()(np.ascontiguousarray(grid.occupancy), np.ascontiguousarray(grid.flags), values)
    return values.view(np.int8).reshape(-1)


def from_grid(message: Mapping[str, Any], name: str) -> MapGrid2D:
    """The map of an OccupancyGrid, with the flags that YARP gives one: free below 50, wall from there on, unknown.

    Args:
        message: as `bridge.messages.values` has it.
        name: the map's.

    Raises:
        ValueError: it is none; the text says why.
    """
    info, data = message["info"], np.asarray(message["data"], np.int8)
    width, height = int(info["width"]), int(info["height"])
    if width * height > MAX_CELLS:
        raise ValueError(too_large(width, height))
    if not width * height or data.shape != (width * height,):
        raise ValueError(f"an OccupancyGrid of {width} x {height} cells does not have {data.size} of them")
    occupancy, flags = np.empty((height, width), np.uint8), np.empty((height, width), np.uint8)
    parting()(np.ascontiguousarray(data).view(np.uint8).reshape(height, width), occupancy, flags)
    place, turn = info["origin"]["position"], info["origin"]["orientation"]
    origin = MapGrid2DOrigin.from_ros(place["x"], place["y"], yaw_of(turn))
    return MapGrid2D.of(flags, occupancy, name=name, resolution=float(info["resolution"]), origin=origin)


def yaw_of(turn: Mapping[str, float]) -> float:
    """The turn about the vertical of a quaternion, radians; of one that is all 0, as some programs send, 0."""
    x, y, z, w = (turn.get(axis, 0.0) for axis in "xyzw")
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
