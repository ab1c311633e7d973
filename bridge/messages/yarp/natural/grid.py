"""Maps: `nav_msgs/msg/OccupancyGrid` and ``yarp::dev::Nav2D::MapGrid2D``.

``width height origin_x origin_y origin_theta resolution name compressed {occupancy} {flags}``: rows from the top one
down, occupancy 0 to 100 or 255 for unknown, a flag for each cell, both zipped where ``compressed`` is 1. The flags of a
ROS map are those that YARP gives one it loads without flags: free below 50, wall from there on, unknown.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.messages.errors import ConversionError
from bridge.messages.yarp.natural.kind import Message, Missing, header, heading, turned
from yarp_compat.wire import tags
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer

_FREE, _WALL, _UNKNOWN = 0, 4, 5
_MAX_CELLS = 1 << 27


class Grid:
    """The pair of map types."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        """See `Kind`; the map is not zipped."""
        info = message["info"]
        width, height = info["width"], info["height"]
        cells = message["data"]
        if len(cells) != width * height:
            raise ConversionError(f"a map of {width} x {height} cells has not {len(cells)}")
        cells = cells.reshape(height, width)[::-1]
        flags = np.where(cells < 0, _UNKNOWN, np.where(cells < 50, _FREE, _WALL)).astype(np.uint8)
        out.begin(10)
        out.integer(width)
        out.integer(height)
        out.float64(info["origin"]["position"]["x"])
        out.float64(info["origin"]["position"]["y"])
        out.float64(heading(info["origin"]["orientation"]))
        out.float64(info["resolution"])
        out.string(message["header"]["frame_id"])
        out.integer(0, tags.INT8)
        out.blob(cells.astype(np.uint8).tobytes())  # -1 becomes 255
        out.blob(flags.tobytes())

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        """See `Kind`; the flags are not taken."""
        source.begin()
        width, height = source.integer(), source.integer()
        x, y, theta, resolution = (source.float64() for _ in range(4))
        name, compressed = source.string(), source.integer()
        occupancy = source.blob()
        source.blob()
        source.end()
        if min(width, height) < 0 or width * height > _MAX_CELLS:
            raise ConversionError(f"a map of {width} x {height} cells")
        cells = _cells(occupancy, width * height, zipped=bool(compressed)).astype(np.int16)
        cells[cells > 100] = -1
        head = header(stamp_ns, missing.frame or name)
        return {
            "header": head,
            "info": {
                "map_load_time": head["stamp"],
                "resolution": resolution,
                "width": width,
                "height": height,
                "origin": {"position": {"x": x, "y": y}, "orientation": turned(theta)},
            },
            "data": cells.reshape(height, width)[::-1].astype(np.int8).reshape(-1),
        }


def _cells(data: memoryview, count: int, *, zipped: bool) -> np.ndarray:
    content: bytes | memoryview = data
    if zipped:
        try:
            content = zlib.decompressobj().decompress(data, count + 1)
        except zlib.error as err:
            raise ConversionError(f"the map's cells are not zipped as they should be: {err}") from None
    if len(content) != count:
        raise ConversionError(f"a map of {count} cells has not {len(content)}")
    return np.frombuffer(content, np.uint8)
