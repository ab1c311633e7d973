"""Converts YARP maps to `nav_msgs/OccupancyGrid` and back.

ROS's rows go from the bottom up and its values are signed: 0 to 100, or -1 for unknown. The origin of a rotated map
differs, see :mod:`yarp_compat.dev.mapinfo`; every cell stays in its place.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navigation.maps.kernels import join, part
from yarp_compat.dev.mapflag import MAX_CELLS, UNKNOWN, MapFlag, lookup, too_large
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.mapinfo import MapGrid2DInfo, MapGrid2DOrigin

Message = dict[str, Any]


def to_grid(grid: MapGrid2D, frame: str = "map", stamp_ns: int = 0) -> Message:
    """Convert a map to an OccupancyGrid.

    Walls and unknown cells of the flags override the occupancy, so that a painted wall is a wall for all planners.
    Keep-out cells and obstacles are in the mask of :mod:`navigation.maps.masks`.
    """
    return message_of(occupied(grid), grid, frame, stamp_ns)


def message_of(data: NDArray[np.int8], info: MapGrid2DInfo, frame: str = "map", stamp_ns: int = 0) -> Message:
    """Return an OccupancyGrid of data in ROS's order (:func:`data_of`), with the geometry of a map."""
    metadata = info_of(info, stamp_ns)
    return {"header": {"stamp": metadata["map_load_time"], "frame_id": frame}, "info": metadata, "data": data}


def info_of(info: MapGrid2DInfo, stamp_ns: int) -> Message:
    """Return the `nav_msgs/MapMetaData` of a map, with a time in nanoseconds."""
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
    """Convert values (height, width), rows from the top down, to ROS's order (height * width,)."""
    return np.ascontiguousarray(values[::-1]).reshape(-1)


def occupied(grid: MapGrid2D) -> NDArray[np.int8]:
    """Return occupancy with flags applied, as in `to_grid`: 0 to 100 or -1, (height * width,) from the bottom up."""
    values = np.empty((grid.m_height, grid.m_width), np.uint8)
    join(np.ascontiguousarray(grid.occupancy).data, np.ascontiguousarray(grid.flags).data, values.data)
    return values.view(np.int8).reshape(-1)


def from_grid(message: Mapping[str, Any], name: str) -> MapGrid2D:
    """Convert an OccupancyGrid to a map: free below 50, walls from 50 on, -1 unknown. Raises `ValueError`."""
    info, data = message["info"], np.asarray(message["data"], np.int8)
    width, height = int(info["width"]), int(info["height"])
    if width * height > MAX_CELLS:
        raise ValueError(too_large(width, height))
    if not width * height or data.shape != (width * height,):
        raise ValueError(f"an OccupancyGrid of {width} x {height} cells must not have {data.size} values")
    occupancy, flags = np.empty((height, width), np.uint8), np.empty((height, width), np.uint8)
    values = np.ascontiguousarray(data).view(np.uint8).reshape(height, width)
    part(values.data, occupancy.data, flags.data)
    place, turn = info["origin"]["position"], info["origin"]["orientation"]
    origin = MapGrid2DOrigin.from_ros(place["x"], place["y"], yaw_of(turn))
    return MapGrid2D.of(flags, occupancy, name=name, resolution=float(info["resolution"]), origin=origin)


def yaw_of(turn: Mapping[str, float]) -> float:
    """Return the yaw of a quaternion, radians; 0 for one that is all zeros, as some programs send."""
    x, y, z, w = (turn.get(axis, 0.0) for axis in "xyzw")
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


_ENCAPSULATION = bytes((0, 1, 0, 0))
_STAMP = struct.Struct("<iI")
_INFO = struct.Struct("<iIfII")
_POSE = struct.Struct("<7d")
_COUNT = struct.Struct("<I")


def to_cdr(grid: MapGrid2D, frame: str = "map", stamp_ns: int = 0) -> memoryview:
    """Return the message of `to_grid` as `bridge.messages.values.MessageWriter` encodes it; the time in nanoseconds."""
    stamp, cells = divmod(stamp_ns, 10**9), grid.m_width * grid.m_height
    name = frame.encode() + b"\0"
    x, y, yaw = grid.origin.to_ros()
    body = bytearray(_STAMP.pack(*stamp) + _COUNT.pack(len(name)) + name)
    _align(body, 4)
    body += _INFO.pack(*stamp, grid.resolution, grid.m_width, grid.m_height)
    _align(body, 8)
    body += _POSE.pack(x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)) + _COUNT.pack(cells)
    head = _ENCAPSULATION + body
    message = np.empty(len(head) + cells, np.uint8)  # unlike a bytearray, not initialized with zeros
    message[: len(head)] = np.frombuffer(head, np.uint8)
    values = message[len(head) :].reshape(grid.m_height, grid.m_width)
    join(np.ascontiguousarray(grid.occupancy).data, np.ascontiguousarray(grid.flags).data, values.data)
    return message.data


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)


_ROWS = 64  # rows converted at once
_PLACES = ((0.0, 0.0), (-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25))
_RANK = np.array([MapFlag.UNKNOWN, MapFlag.FREE, MapFlag.ENLARGED_OBSTACLE, MapFlag.TEMPORARY_OBSTACLE,
                  MapFlag.KEEP_OUT, MapFlag.WALL], np.uint8)  # fmt: skip
"""Flags from the lowest to the highest rank: if several cells fall into one cell, the highest rank wins."""


def turned(grid: MapGrid2D) -> MapGrid2D:
    """Align a rotated map with the axes; return the same object if its theta is 0.

    Each cell gets the highest rank of the old cells at its center and half way to its corners, so that walls stay
    closed. Cells outside the old map are unknown. Raises `ValueError` if the result has too many cells.
    """
    if not grid.origin.theta:
        return grid
    left, bottom, width, height = _bounds(grid)
    straight = MapGrid2D.of(
        np.full((height, width), MapFlag.UNKNOWN, np.uint8),
        name=grid.name, resolution=grid.resolution, origin=(left, bottom, 0.0),
    )  # fmt: skip
    straight.enable_map_compression_over_network(grid.compressed)
    order = np.zeros(256, np.uint8)
    order[_RANK] = np.arange(len(_RANK))
    ranks, cells = lookup(grid.flags, order).reshape(-1), np.ascontiguousarray(grid.occupancy).reshape(-1)
    for top in range(0, height, _ROWS):
        rows = slice(top, min(top + _ROWS, height))
        worst, occupancy = _highest_ranks(grid, ranks, cells, straight, rows)
        straight.flags[rows], straight.occupancy[rows] = _RANK[worst], occupancy
    return straight


def _bounds(grid: MapGrid2D) -> tuple[float, float, int, int]:
    """Return the lower left corner of the area that a map covers, meters, and the area's width and height in cells."""
    ends = np.array([(x, y) for x in (0, grid.m_width) for y in (0, grid.m_height)]) * grid.resolution
    ends += (grid.origin.x, grid.origin.y)
    ca, sa = grid.origin.get_ca(), grid.origin.get_sa()
    x, y = ends[:, 0] * ca + ends[:, 1] * sa, ends[:, 1] * ca - ends[:, 0] * sa
    width, height = (max(math.ceil(float(np.ptp(v)) / grid.resolution - 1e-6), 1) for v in (x, y))
    if width * height > MAX_CELLS:
        raise ValueError(f"aligned to yaw 0, it is {too_large(width, height)}")
    return float(x.min()), float(y.min()), width, height


def _highest_ranks(
    grid: MapGrid2D, ranks: NDArray[np.uint8], cells: NDArray[np.uint8], straight: MapGrid2D, rows: slice
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return each cell's highest rank, and its occupancy, for some rows of the aligned map."""
    start, right, down = grid.in_cells(straight.centers_of([(0, rows.start), (1, rows.start), (0, rows.start + 1)]))
    columns, lines = np.arange(straight.m_width), np.arange(rows.stop - rows.start)[:, None]
    middles = [start[axis] + columns * (right - start)[axis] + lines * (down - start)[axis] for axis in (0, 1)]
    shape = len(lines), len(columns)
    worst, occupancy = np.zeros(shape, np.uint8), np.full(shape, UNKNOWN, np.uint8)
    for place in _PLACES:
        shift = place[0] * (right - start) + place[1] * (down - start)
        column, row = (np.floor(middle + by).astype(np.int32) for middle, by in zip(middles, shift, strict=True))
        inside = (column >= 0) & (column < grid.m_width) & (row >= 0) & (row < grid.m_height)
        at = np.where(inside, row * np.int64(grid.m_width) + column, 0)
        rank, sample = np.where(inside, ranks[at], 0), np.where(inside, cells[at], UNKNOWN)
        # of equal ranks, take the higher occupancy; 255 wraps to 0, below all known values
        higher = (rank > worst) | (rank == worst) & (sample + np.uint8(1) > occupancy + np.uint8(1))
        worst, occupancy = np.where(higher, rank, worst), np.where(higher, sample, occupancy)
    return worst, occupancy


def same_walls(one: MapGrid2D, other: MapGrid2D) -> bool:
    """Whether two maps have the same name, and the same walls and unknown cells in the same place."""
    return (
        one.name == other.name
        and one.resolution == other.resolution
        and one.origin == other.origin
        and one.flags.shape == other.flags.shape
        and all(((one.flags == flag) == (other.flags == flag)).all() for flag in (MapFlag.WALL, MapFlag.UNKNOWN))
    )
