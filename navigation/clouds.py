"""Point clouds of the hub (``sensor_msgs/msg/PointCloud2``), as all modules take them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.tf.transform import Transform

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
MOST_POINTS = 4_000_000
"""A cloud of more is refused: a scanner with 128 lines and a 4-megapixel depth camera have fewer."""

FARTHEST = 1e9
"""Metres: what is not nearer is no point, as the greatest float32 that some sensors give for "nothing"."""

Points = NDArray[np.float32]

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""``sensor_msgs/msg/PointField``: its numbers of types."""


class CloudError(ValueError):
    """A cloud that cannot be used; the text names the field."""


def read_points(message: Mapping[str, Any], most: int = MOST_POINTS) -> Points:
    """The points of a ``PointCloud2``: (n, 3) x, y, z in its own frame, metres; those nearer than ``FARTHEST``.

    Fields may lie in any order and be of any of the eight types, of either byte order, with gaps between points and
    between rows. Raises `CloudError` where the cloud has more than ``most`` points, or does not fit its own words.
    """
    width, height, step, row = (int(message[key]) for key in ("width", "height", "point_step", "row_step"))
    if width * height > most:
        raise CloudError(f"width, height: {width} x {height} points are declared, more than {most}")
    if not width * height:
        return np.empty((0, 3), np.float32)
    if row < width * step:
        raise CloudError(f"row_step: {row} bytes hold no {width} points of {step} bytes (point_step)")
    data = np.frombuffer(message["data"], np.uint8)
    needed = (height - 1) * row + width * step
    if len(data) < needed:
        raise CloudError(f"data: {len(data)} bytes, where {height} rows of {row} (row_step) need {needed}")
    cells = np.ndarray((height, width), _layout(message, step), data, strides=(row, step))
    points = np.empty((height * width, 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for axis, name in enumerate("xyz"):
            points[:, axis] = cells[name].ravel()
    x, y, z = (np.abs(points) < FARTHEST).T  # three times as fast as all(axis=1); NaN is not
    near = x & y & z
    return points if near.all() else points[near]


def placed(points: Points, at: Transform) -> Points:
    """Points (n, 3) of a frame that is at a pose in another one, in that one."""
    x, y, z, w = at.rotation
    turned = np.array([
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ], np.float32)  # fmt: skip
    found: Points = points @ turned.T + np.array(at.translation, np.float32)
    return found


def _layout(message: Mapping[str, Any], step: int) -> np.dtype[Any]:
    """Where x, y and z lie in a point of so many bytes."""
    fields = {str(field["name"]): field for field in reversed(message["fields"])}  # of several the first
    missing = [name for name in "xyz" if name not in fields]
    if missing:
        raise CloudError(f"fields: there is no {', '.join(missing)} among {', '.join([*fields][::-1]) or 'none'}")
    order = ">" if message["is_bigendian"] else "<"
    formats, offsets = [], []
    for name in "xyz":
        field = fields[name]
        kind, offset = _TYPES.get(int(field["datatype"])), int(field["offset"])
        if kind is None:
            raise CloudError(f"fields.{name}.datatype: {field['datatype']} is none of 1 to 8")
        if int(field["count"]) > 1:
            raise CloudError(f"fields.{name}.count: a point has one {name}, not {field['count']}")
        if offset + int(kind[1]) > step:
            raise CloudError(f"fields.{name}.offset: byte {offset} is not within a point of {step} bytes (point_step)")
        formats.append(order + kind)
        offsets.append(offset)
    return np.dtype({"names": list("xyz"), "formats": formats, "offsets": offsets, "itemsize": step})
