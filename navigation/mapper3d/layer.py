"""The layer of Mapper3D on the hub: latched, with updates, and with the heights of obstacles."""

from __future__ import annotations

import numpy as np

from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from navigation.algorithms.voxel_layer import EDGE, FLOOR, OBSTACLE, LayerColumns
from navigation.mapper3d.section import Mapper3DSection
from navigation.maps.grid import to_cdr
from navigation.maps.grid_map import GRID_MAP, HEIGHTS, HIGHEST, LOWEST, to_grid_map
from navigation.messages import GRID
from yarp_compat.dev.mapflag import UNKNOWN, MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

_ALIVE_NS = 1_000_000_000  # time after which an unchanged layer is published again
UPDATE = "map_msgs/msg/OccupancyGridUpdate"
_FLAGS = np.full(4, MapFlag.UNKNOWN, np.uint8)
_FLAGS[[FLOOR, OBSTACLE, EDGE]] = MapFlag.FREE, MapFlag.WALL, MapFlag.KEEP_OUT
_VALUES = np.full(4, UNKNOWN, np.uint8)
_VALUES[[FLOOR, OBSTACLE, EDGE]] = 0, 100, 100


def grid_of(columns: LayerColumns, name: str, resolution: float) -> MapGrid2D:
    """Return a layer as a map: obstacles are walls, drops and steps are keep-out cells; both are occupied."""
    kinds = columns.kinds[::-1]
    return MapGrid2D.of(_FLAGS[kinds], _VALUES[kinds], name=name, resolution=resolution, origin=(*columns.corner, 0.0))


class LayerPublisher:
    """Publishes the layer when it changes."""

    def __init__(self, host: Host, section: Mapper3DSection) -> None:
        self._frame, self._clock, self._section = section.map_frame, host.clock, section
        topic = section.layer.topic
        self._grid = host.node.publisher(topic, GRID, LATCHED, priority="state")
        self._updates = host.node.publisher(f"{topic}_updates", UPDATE)
        self._heights = host.node.publisher(f"{topic}{HEIGHTS}", GRID_MAP, LATCHED, priority="state")
        self._last: MapGrid2D | None = None
        self._last_heights: bytes | None = None
        self._published = 0

    def publish(self, layer: LayerColumns) -> None:
        """Publish a layer; an unchanged one once a second, because some subscribers stop the robot on silence."""
        grid = grid_of(layer, self._section.layer.name, self._section.resolution)
        self._publish_heights(layer)
        last, self._last = self._last, grid
        now = self._clock.now_ns()
        if last is not None and _same_cells(last, grid):
            rows, columns = np.nonzero((last.occupancy != grid.occupancy)[::-1])
            if not len(rows):
                if 0 <= now - self._published < _ALIVE_NS:
                    return
                rows, columns = np.zeros((2, 1), np.int64)
            low, left, high, right = rows.min(), columns.min(), rows.max() + 1, columns.max() + 1
            part = np.ascontiguousarray(grid.occupancy[::-1][low:high, left:right]).view(np.int8).reshape(-1)
            update = {
                "header": {"stamp": {"sec": now // 10**9, "nanosec": now % 10**9}, "frame_id": self._frame},
                "x": int(left), "y": int(low), "width": int(right - left), "height": int(high - low), "data": part,
            }  # fmt: skip
            self._updates.offer(lambda: self._updates.encoded(update))
        self._published = now
        self._grid.publish_cdr(bytes(to_cdr(grid, self._frame, now)))

    def _publish_heights(self, columns: LayerColumns) -> None:
        """Publish the heights of obstacles if they changed, only for the part with obstacles: most cells are free."""
        rows, places = np.nonzero(columns.hits[..., 0] > 0)
        low, left = (int(indices.min()) if len(indices) else 0 for indices in (rows, places))
        high, right = (int(indices.max()) + 1 if len(indices) else 1 for indices in (rows, places))
        part = columns.hits[low:high, left:right]
        size = self._section.resolution
        corner = (columns.corner[0] + left * size, columns.corner[1] + low * size)
        content = np.array([*corner, *part.shape]).tobytes() + part.tobytes()
        if content == self._last_heights:
            return
        self._last_heights, now = content, self._clock.now_ns()
        header = {"stamp": {"sec": now // 10**9, "nanosec": now % 10**9}, "frame_id": self._frame}
        layers = {LOWEST: part[..., 0], HIGHEST: part[..., 1]}
        self._heights.publish(to_grid_map(layers, corner, size, header))


def _same_cells(one: MapGrid2D, other: MapGrid2D) -> bool:
    """Whether the cells of two maps cover the same area."""
    return one.occupancy.shape == other.occupancy.shape and one.getOrigin() == other.getOrigin()
