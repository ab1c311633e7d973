"""`grid_map_msgs/GridMap`: numbers by place, such as heights.

Its cells go the other way round than an OccupancyGrid's: the first one has the largest x and y, and of a layer's data
those with the same y stand together, from the largest x down (Eigen's columns). Its place is that of its middle.
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
"""Behind the topic of a layer: the topic of the heights of what is hit there."""

LOWEST, HIGHEST = "lowest", "highest"
"""Layers of heights: of the lowest and the highest that the robot would touch, metres above the floor."""

MOST_CELLS = 1 << 22
_COLUMNS, _ROWS = "column_index", "row_index"

Message = dict[str, Any]


def to_grid_map(
    layers: Mapping[str, NDArray[np.float32]], corner: tuple[float, float], resolution: float, header: Message
) -> Message:
    """The message of layers.

    Args:
        layers: by name, each (rows, columns): rows along y, columns along x, the first cell at the corner.
        corner: x and y of the first cell's own corner, metres.
        resolution: metres of a cell's side.
        header: whose frame the corner is in.
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


def values_at(message: Mapping[str, Any], layer: str, places: NDArray[np.float64]) -> NDArray[np.float32]:
    """A layer's values at places (n, 2) in the map's own frame; NaN beside it. Raises `ValueError` with the reason."""
    if layer not in message["layers"]:
        raise ValueError(f"layers: there is no {layer!r} among {', '.join(message['layers'][:10]) or 'none'}")
    number = list(message["layers"]).index(layer)
    if number >= len(message["data"]):
        raise ValueError(f"data: {len(message['data'])} arrays for {len(message['layers'])} layers")
    info = message["info"]
    size = float(info["resolution"])
    if not (math.isfinite(size) and size > 0.0):
        raise ValueError(f"info.resolution: {size} m is no size of a cell")
    cells = _cells(message["data"][number], message)
    place = info["pose"]["position"]
    yaw = yaw_of(info["pose"]["orientation"])
    cos, sin = math.cos(yaw), math.sin(yaw)
    apart = places - (float(place["x"]), float(place["y"]))
    own = apart @ np.array([[cos, -sin], [sin, cos]])
    # counted from the end with the largest x and y
    indices = np.floor(np.array(cells.shape)[::-1] / 2.0 - own / size)
    found = np.full(len(places), np.nan, np.float32)
    inside = ((indices >= 0) & (indices < np.array(cells.shape)[::-1])).all(-1)
    at = indices[inside].astype(np.int64)
    found[inside] = cells[at[:, 1], at[:, 0]]
    return found


def _cells(array: Mapping[str, Any], message: Mapping[str, Any]) -> NDArray[np.float32]:
    """The cells of a layer: rows from the largest y down, columns from the largest x down."""
    dims = array["layout"]["dim"]
    labels = [dim["label"] for dim in dims]
    if sorted(labels) != [_COLUMNS, _ROWS]:
        raise ValueError(f"data.layout.dim: {labels} are not {_COLUMNS} and {_ROWS}")
    shape = tuple(int(dim["size"]) for dim in dims)
    values = np.asarray(array["data"], np.float32)
    if shape[0] * shape[1] > MOST_CELLS:
        raise ValueError(f"data: {shape[0]} x {shape[1]} cells are more than {MOST_CELLS}")
    if values.size != shape[0] * shape[1]:
        raise ValueError(f"data: {values.size} values are not {shape[0]} x {shape[1]}")
    cells = values.reshape(shape) if labels[0] == _COLUMNS else values.reshape(shape).T
    first = (int(message["inner_start_index"]), int(message["outer_start_index"]))
    return np.roll(cells, (-first[0], -first[1]), (0, 1)) if any(first) else cells
