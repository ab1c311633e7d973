"""Maps: `nav_msgs/msg/OccupancyGrid` and ``yarp::dev::Nav2D::MapGrid2D``.

The flags of a ROS map are those that YARP gives one it loads without flags: free below 50, wall from there on, unknown.
The two say different origins of a map that is turned, see `yarp_compat.dev.mapinfo`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.messages.errors import ConversionError
from bridge.messages.yarp.natural.kind import Message, Missing, header, heading, turned
from yarp_compat.dev.mapflag import flags_of
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.mapinfo import MapGrid2DOrigin
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer


class Grid:
    """The pair of map types."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        """See `Kind`; the map is not zipped."""
        info = message["info"]
        width, height, position = info["width"], info["height"], info["origin"]["position"]
        if len(message["data"]) != width * height:
            raise ConversionError(f"a map of {width} x {height} cells has not {len(message['data'])}")
        cells = np.ascontiguousarray(message["data"].reshape(height, width)[::-1]).view(np.uint8)  # -1 is 255
        yaw = math.radians(heading(info["origin"]["orientation"]))
        try:
            origin = MapGrid2DOrigin.from_ros(position["x"], position["y"], yaw)
            grid = MapGrid2D.of(
                flags_of(cells), cells,
                name=message["header"]["frame_id"], resolution=info["resolution"], origin=origin,
            )  # fmt: skip
        except ValueError as err:
            raise ConversionError(str(err)) from None
        grid.enable_map_compression_over_network(False)
        grid._write(out)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        """See `Kind`; the flags are not taken."""
        grid = MapGrid2D()
        grid._read(source)
        cells = grid.occupancy.astype(np.int16)
        cells[cells > 100] = -1
        head = header(stamp_ns, missing.frame or grid.getMapName())
        x, y, yaw = grid.origin.to_ros()
        return {
            "header": head,
            "info": {
                "map_load_time": head["stamp"],
                "resolution": grid.getResolution(),
                "width": grid.width(),
                "height": grid.height(),
                "origin": {"position": {"x": x, "y": y}, "orientation": turned(math.degrees(yaw))},
            },
            "data": cells[::-1].astype(np.int8).reshape(-1),
        }
