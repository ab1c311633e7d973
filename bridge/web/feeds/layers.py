"""The feed of a layer from Mapper3D or a similar program: the cells in which a robot would collide, with heights."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from bridge.web.feeds.frames import FrameFollower
from bridge.web.feeds.robot import TopicsFeed, pose_json
from navigation.frames import FramesError
from navigation.maps.grid import yaw_of
from navigation.maps.grid_map import GRID_MAP, HEIGHTS, LOWEST, values_at
from navigation.messages import GRID
from navigation.pose import Pose

SECONDS = 0.5
MOST_CELLS = 1 << 22
"""Maximum number of cells of a layer; a larger layer is not shown."""

MOST_TINTED = 20_000
"""Maximum number of cells sent to a page; while more are blocked, each square of four cells is merged into one."""

BLOCKED = 50
"""Minimum cell value that planners treat as blocked."""


class LayerFeed(TopicsFeed):
    """``layer``: the blocked cells of a layer on the map, with the obstacles' heights, at most twice a second."""

    def __init__(self, host: Host, follower: FrameFollower, topic: str) -> None:
        super().__init__(host, "layer")
        self._follower, self._topic = follower, topic
        self._grid: dict[str, Any] | None = None
        self._heights: dict[str, Any] | None = None
        self._fresh = False
        self._drawn_pose: dict[str, float] | None = None
        self._timer: Timer | None = None

    @override
    def open(self) -> None:
        if not self._topic:
            self.put(None, "no layer is configured (web.layer)")
            return
        self._follower.begin()
        self.follow(self._topic, GRID, self._on_grid, LATCHED)
        self.follow(self._topic + HEIGHTS, GRID_MAP, self._on_heights, LATCHED)
        self._timer = self._host.loop.every(SECONDS, self._refresh)

    @override
    def close(self) -> None:
        super().close()
        self._grid = self._heights = self._drawn_pose = None
        if self._timer is not None:
            self._timer.close()
            self._timer = None
            self._follower.end()

    def _on_grid(self, grid: dict[str, Any]) -> None:
        self._grid, self._fresh = grid, True

    def _on_heights(self, heights: dict[str, Any]) -> None:
        self._heights, self._fresh = heights, True

    def _refresh(self) -> None:
        grid = self._grid
        if grid is None:
            return
        try:
            frame = self._follower.grid_frame(self._topic, grid, MOST_CELLS)
        except FramesError as err:
            self.put(None, str(err))
            return
        if not self._fresh and pose_json(frame) == self._drawn_pose:
            return
        self._fresh, self._drawn_pose = False, pose_json(frame)
        try:
            self.put(tint(grid, self._heights, frame))
        except ValueError as err:
            self.put(None, f"{self._topic}: {err}")


def tint(grid: dict[str, Any], heights: dict[str, Any] | None, frame: Pose) -> dict[str, Any]:
    """Return the feed's value; ``frame``: pose of the layer's frame on the map. Raises `ValueError` with the reason."""
    info = grid["info"]
    height, width, size = int(info["height"]), int(info["width"]), float(info["resolution"])
    cells = np.asarray(grid["data"], np.int8)
    if cells.size != width * height:
        raise ValueError(f"data: {cells.size} cells instead of {width} x {height}")
    if not (math.isfinite(size) and size > 0.0):
        raise ValueError(f"info.resolution: {size} m is not a valid cell size")
    blocked = cells.reshape(height, width) >= BLOCKED
    position, orientation = info["origin"]["position"], info["origin"]["orientation"]
    origin = Pose(float(position["x"]), float(position["y"]), yaw_of(orientation))
    cell_heights = _heights_of(blocked, heights, grid, origin)
    while np.count_nonzero(blocked) > MOST_TINTED:
        blocked = np.asarray(_group_cells(blocked, False).any((1, 3)))
        cell_heights, size = _group_cells(cell_heights, np.inf).min((1, 3)), 2.0 * size
    return {"origin": pose_json(frame @ origin), "size": round(size, 4), "runs": runs_of(blocked, cell_heights)}


def _heights_of(
    blocked: NDArray[np.bool_], heights: dict[str, Any] | None, grid: dict[str, Any], origin: Pose
) -> NDArray[np.float32]:
    """Return each cell's height in meters; infinite if unknown."""
    known = np.full(blocked.shape, np.inf, np.float32)
    if heights is None or heights["header"]["frame_id"].lstrip("/") != grid["header"]["frame_id"].lstrip("/"):
        return known
    rows, columns = np.nonzero(blocked)
    x, y = ((part + 0.5) * float(grid["info"]["resolution"]) for part in (columns, rows))
    cos, sin = math.cos(origin.theta), math.sin(origin.theta)
    places = np.stack([origin.x + cos * x - sin * y, origin.y + sin * x + cos * y], axis=1)
    try:
        values = values_at(heights, LOWEST, places)
    except ValueError as err:
        raise ValueError(f"heights: {err}") from None
    known[rows, columns] = np.where(np.isfinite(values), values, np.inf)
    return known


def _group_cells(cells: NDArray[Any], fill: float) -> NDArray[Any]:
    """Group the cells in squares of four: (rows, 2, columns, 2)."""
    rows, columns = cells.shape
    full = np.pad(cells, ((0, rows % 2), (0, columns % 2)), constant_values=fill)
    return full.reshape(full.shape[0] // 2, 2, full.shape[1] // 2, 2)


def runs_of(blocked: NDArray[np.bool_], heights: NDArray[np.float32]) -> list[list[float | None]]:
    """Return runs of adjacent blocked cells: row and column of the first cell, then each cell's height or None."""
    rows, columns = np.nonzero(blocked)
    values = heights[rows, columns]
    rounded = [None if math.isinf(value) else value for value in np.round(values.astype(np.float64), 2).tolist()]
    begins = np.flatnonzero(np.concatenate([[True], (np.diff(rows) != 0) | (np.diff(columns) != 1)]))
    if not len(rows):
        return []
    ends = [*begins[1:].tolist(), len(rows)]
    firsts = zip(rows[begins].tolist(), columns[begins].tolist(), begins.tolist(), ends, strict=True)
    return [[row, column, *rounded[begin:end]] for row, column, begin, end in firsts]
