"""The layer of Mapper3D on the hub: whole, latched, and what changed of it since; and the heights of what is hit."""

from __future__ import annotations

import numpy as np

from bridge.config.sections.mapper3d import Mapper3DSection
from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from navigation.algorithms.voxel_layer import EDGE, FLOOR, OBSTACLE, LayerColumns
from navigation.maps.grid import to_cdr
from navigation.maps.grid_map import GRID_MAP, HEIGHTS, HIGHEST, LOWEST, to_grid_map
from navigation.messages import GRID
from yarp_compat.dev.mapflag import UNKNOWN, MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

_ALIVE_NS = 1_000_000_000
UPDATE = "map_msgs/msg/OccupancyGridUpdate"
_FLAGS = np.full(4, MapFlag.UNKNOWN, np.uint8)
_FLAGS[[FLOOR, OBSTACLE, EDGE]] = MapFlag.FREE, MapFlag.WALL, MapFlag.KEEP_OUT
_VALUES = np.full(4, UNKNOWN, np.uint8)
_VALUES[[FLOOR, OBSTACLE, EDGE]] = 0, 100, 100


def grid_of(columns: LayerColumns, name: str, resolution: float) -> MapGrid2D:
    """The map of a layer: what is blocked is a wall, what is at a drop or a step is keep-out; both are occupied."""
    kinds = columns.kinds[::-1]
    return MapGrid2D.of(_FLAGS[kinds], _VALUES[kinds], name=name, resolution=resolution, origin=(*columns.corner, 0.0))


class LayerPublisher:
    """Publishes the layer where it is another than before."""

    def __init__(self, host: Host, section: Mapper3DSection) -> None:
        self._frame, self._clock, self._section = section.map_frame, host.clock, section
        topic = section.layer.topic
        self._grid = host.node.publisher(topic, GRID, LATCHED, priority="state")
        self._updates = host.node.publisher(f"{topic}_updates", UPDATE)
        self._heights = host.node.publisher(f"{topic}{HEIGHTS}", GRID_MAP, LATCHED, priority="state")
        self._last: MapGrid2D | None = None
        self._last_heights: bytes | None = None
        self._told = 0

    def tell(self, found: LayerColumns) -> None:
        """Publish a layer; one that is the same as before now and then, for those whom silence stops."""
        grid = grid_of(found, self._section.layer.name, self._section.resolution)
        self._tell_heights(found)
        last, self._last = self._last, grid
        now = self._clock.now_ns()
        if last is not None and _lie_alike(last, grid):
            rows, columns = np.nonzero((last.occupancy != grid.occupancy)[::-1])
            if not len(rows):
                if 0 <= now - self._told < _ALIVE_NS:
                    return
                rows, columns = np.zeros((2, 1), np.int64)
            low, left, high, right = rows.min(), columns.min(), rows.max() + 1, columns.max() + 1
            part = np.ascontiguousarray(grid.occupancy[::-1][low:high, left:right]).view(np.int8).reshape(-1)
            update = {
                "header": {"stamp": {"sec": now // 10**9, "nanosec": now % 10**9}, "frame_id": self._frame},
                "x": int(left), "y": int(low), "width": int(right - left), "height": int(high - low), "data": part,
            }  # fmt: skip
            self._updates.offer(lambda: self._updates.encoded(update))
        self._told = now
        self._grid.publish_cdr(bytes(to_cdr(grid, self._frame, now)))

    def _tell_heights(self, columns: LayerColumns) -> None:
        """Publish how high what is hit is, where it changed, about that alone: most of a layer is free."""
        rows, places = np.nonzero(columns.hits[..., 0] > 0)
        low, left = (int(each.min()) if len(each) else 0 for each in (rows, places))
        high, right = (int(each.max()) + 1 if len(each) else 1 for each in (rows, places))
        part = columns.hits[low:high, left:right]
        size = self._section.resolution
        corner = (columns.corner[0] + left * size, columns.corner[1] + low * size)
        said = np.array([*corner, *part.shape]).tobytes() + part.tobytes()
        if said == self._last_heights:
            return
        self._last_heights, now = said, self._clock.now_ns()
        header = {"stamp": {"sec": now // 10**9, "nanosec": now % 10**9}, "frame_id": self._frame}
        layers = {LOWEST: part[..., 0], HIGHEST: part[..., 1]}
        self._heights.publish(to_grid_map(layers, corner, size, header))


def _lie_alike(one: MapGrid2D, other: MapGrid2D) -> bool:
    """Whether two maps have the same cells."""
    return one.occupancy.shape == other.occupancy.shape and one.getOrigin() == other.getOrigin()
