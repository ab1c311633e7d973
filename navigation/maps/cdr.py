"""`nav_msgs/OccupancyGrid` of a map as CDR, in one pass over its cells."""

from __future__ import annotations

import math
import struct

import numpy as np

from navigation.maps.kernels import joining
from yarp_compat.dev.mapgrid import MapGrid2D

_ENCAPSULATION = bytes((0, 1, 0, 0))
_STAMP = struct.Struct("<iI")
_INFO = struct.Struct("<iIfII")
_POSE = struct.Struct("<7d")
_COUNT = struct.Struct("<I")


def to_cdr(grid: MapGrid2D, frame: str = "map", stamp_ns: int = 0) -> memoryview:
    """The message that `navigation.maps.grid.to_grid` says, as `bridge.messages.values.Writer` writes it.

    Args:
        grid: the map.
        frame: its frame.
        stamp_ns: its time, nanoseconds.
    """
    stamp, cells = divmod(stamp_ns, 10**9), grid.m_width * grid.m_height
    name = frame.encode() + b"\0"
    x, y, yaw = grid.origin.to_ros()
    body = bytearray(_STAMP.pack(*stamp) + _COUNT.pack(len(name)) + name)
    _align(body, 4)
    body += _INFO.pack(*stamp, grid.resolution, grid.m_width, grid.m_height)
    _align(body, 8)
    body += _POSE.pack(x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)) + _COUNT.pack(cells)
    head = _ENCAPSULATION + body
    message = np.empty(len(head) + cells, np.uint8)  # unlike a bytearray, not filled with zeros before
    message[: len(head)] = np.frombuffer(head, np.uint8)
    values = message[len(head) :].reshape(grid.m_height, grid.m_width)
    joining()(np.ascontiguousarray(grid.occupancy), np.ascontiguousarray(grid.flags), values)
    return message.data


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)
