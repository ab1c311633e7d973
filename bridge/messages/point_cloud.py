"""The points of a ``sensor_msgs/PointCloud2`` as numpy records, laid out as the message describes.

Fields may have any order and any of the eight types of ``sensor_msgs/PointField``, in either byte order, with padding
after points and after rows; the last row need not be padded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.messages.errors import ConversionError

FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""numpy's codes for ``PointField``'s types."""


class CloudError(ConversionError, ValueError):
    """The fields of a cloud or a depth image contradict its data or each other; the text names the field."""


def number_format(message: Mapping[str, Any], field: Mapping[str, Any]) -> str:
    """Return the numpy format of a field; raises `CloudError` if it is not a single number within its point."""
    name, step, kind = field["name"], int(message["point_step"]), FORMATS.get(int(field["datatype"]))
    if kind is None:
        raise CloudError(f"fields.{name}.datatype: {field['datatype']} is not between 1 and 8")
    if int(field["count"]) > 1:
        raise CloudError(f"fields.{name}.count: a point has one {name}, not {field['count']}")
    if _count(message) and int(field["offset"]) + int(kind[1]) > step:
        offset = field["offset"]
        raise CloudError(f"fields.{name}.offset: byte {offset} is not within a point of {step} bytes (point_step)")
    return (">" if message["is_bigendian"] else "<") + kind


def records(
    message: Mapping[str, Any], names: Sequence[str], formats: Sequence[str], offsets: Sequence[int]
) -> NDArray[Any]:
    """Return some fields of the points, (height, width), without a copy; raises `CloudError` if bytes are missing.

    A cloud without points has the shape (0, 0), whatever its steps are.
    """
    if not _count(message):
        return np.empty((0, 0), np.dtype({"names": names, "formats": formats}))
    height, width, step, row = (int(message[name]) for name in ("height", "width", "point_step", "row_step"))
    if row < width * step:
        raise CloudError(f"row_step: {row} bytes cannot hold {width} points of {step} bytes (point_step)")
    data = np.frombuffer(message["data"], np.uint8)
    needed = (height - 1) * row + width * step
    if len(data) < needed:
        raise CloudError(f"data: {len(data)} bytes, but {height} rows of {row} (row_step) need {needed}")
    # only after these checks: numpy rejects an itemsize beyond 2^31, which no real data need
    kind = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    return np.ndarray((height, width), kind, data, strides=(row, step))


def _count(message: Mapping[str, Any]) -> int:
    return int(message["height"]) * int(message["width"])
