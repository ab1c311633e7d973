"""`grid_map_msgs/GridMap`: layers of numbers on a grid, such as heights.

The cells are in the opposite order to those of an OccupancyGrid: the first cell has the largest x and y. In a layer's
data, cells with the same y are contiguous, from the largest x down (Eigen's columns). The message's pose is that of
the map's center.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navigation.maps.grid import yaw_of

GRID_MAP = "grid_map_msgs/msg/GridMap"
HEIGHTS = "_heights"
"""Appended to the topic of Mapper3D's layer, an OccupancyGrid, this gives the topic with its obstacles' heights."""

LOWEST, HIGHEST = "lowest", "highest"
"""Layers with the lowest and highest point that the robot would touch, meters above the floor."""

MOST_CELLS = 1 << 22
_COLUMNS, _ROWS = "column_index", "row_index"

Message = dict[str, Any]


def to_grid_map(
    layers: Mapping[str, NDArray[np.float32]], corner: tuple[float, float], resolution: float, header: Message
) -> Message:
    """Return a GridMap of layers.

    Args:
        layers: arrays (rows, columns) by name; rows follow y, columns follow x, and the first cell is at the corner.
        corner: x and y of the first cell's outer corner, meters.
        resolution: the side of a cell, meters.
        header: the message's header, with the frame of the corner.
    """
    rows, columns = next(iter(layers.values())).shape
    length_x, length_y = columns * resolution, rows * resolution
    middle = {"x": corner[0] + length_x / 2, "y": corner[1] + length_y / 2, "z": 0.0}
    info = {"resolution": resolution, "length_x": length_x, "length_y": length_y,
            "pose": {"position": middle, "orientation": {"w": 1.0}}}  # fmt: skip
    dims = [
        {"label": _COLUMNS, "size": rows, "stride": rows * columns},
        {"label": _ROWS, "size": columns, "stride": columns},
    ]
    data = [
        {
            "layout": {"dim": dims, "data_offset": 0},
            "data": np.ascontiguousarray(layer[::-1, ::-1], np.float32).reshape(-1),
        }
        for layer in layers.values()
    ]
    return {"header": header, "info": info, "layers": list(layers), "basic_layers": [next(iter(layers))], "data": data}


def values_at(message: Mapping[str, Any], layer: str, points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return a layer's values at points (n, 2) in the map's frame; NaN outside. Raises `ValueError` with the reason."""
    if layer not in message["layers"]:
        raise ValueError(f"layers: no {layer!r}; the message has {', '.join(message['layers'][:10]) or 'none'}")
    number = list(message["layers"]).index(layer)
    if number >= len(message["data"]):
        raise ValueError(f"data: {len(message['data'])} arrays for {len(message['layers'])} layers")
    info = message["info"]
    size = float(info["resolution"])
    if not (math.isfinite(size) and size > 0.0):
        raise ValueError(f"info.resolution: invalid cell size {size} m")
    cells = _cells(message["data"][number], message)
    center = info["pose"]["position"]
    yaw = yaw_of(info["pose"]["orientation"])
    cos, sin = math.cos(yaw), math.sin(yaw)
    offsets = points - (float(center["x"]), float(center["y"]))
    rotated = offsets @ np.array([[cos, -sin], [sin, cos]])
    # indices are counted from the corner with the largest x and y
    indices = np.floor(np.array(cells.shape)[::-1] / 2.0 - rotated / size)
    values = np.full(len(points), np.nan, np.float32)
    inside = ((indices >= 0) & (indices < np.array(cells.shape)[::-1])).all(-1)
    at = indices[inside].astype(np.int64)
    values[inside] = cells[at[:, 1], at[:, 0]]
    return values


def _cells(array: Mapping[str, Any], message: Mapping[str, Any]) -> NDArray[np.float32]:
    """Return the cells of a layer: rows from the largest y down, columns from the largest x down."""
    dims = array["layout"]["dim"]
    labels = [dim["label"] for dim in dims]
    if sorted(labels) != [_COLUMNS, _ROWS]:
        raise ValueError(f"data.layout.dim: labels must be {_COLUMNS} and {_ROWS}, not {labels}")
    shape = tuple(int(dim["size"]) for dim in dims)
    values = np.asarray(array["data"], np.float32)
    if shape[0] * shape[1] > MOST_CELLS:
        raise ValueError(f"data: {shape[0]} x {shape[1]} cells exceed the limit of {MOST_CELLS}")
    if values.size != shape[0] * shape[1]:
        raise ValueError(f"data: {values.size} values instead of {shape[0]} x {shape[1]}")
    cells = values.reshape(shape) if labels[0] == _COLUMNS else values.reshape(shape).T
    first = (int(message["inner_start_index"]), int(message["outer_start_index"]))
    return np.roll(cells, (-first[0], -first[1]), (0, 1)) if any(first) else cells
