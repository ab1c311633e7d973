"""The points of a ``sensor_msgs/PointCloud2`` as records: where its numbers lie, by its own words.

Fields may lie in any order and be of any of the eight types of ``sensor_msgs/PointField``, of either byte order, with
gaps between points and between rows; the last row need not be padded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.messages.errors import ConversionError

FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""numpy's letters of ``PointField``'s types."""


class CloudError(ConversionError, ValueError):
    """A cloud or a depth image does not fit its own words; the text names the field."""


def number_format(message: Mapping[str, Any], field: Mapping[str, Any]) -> str:
    """Numpy's format of a field that is one number; raises `CloudError` if it is none, or is not within a point."""
    name, step, kind = field["name"], int(message["point_step"]), FORMATS.get(int(field["datatype"]))
    if kind is None:
        raise CloudError(f"fields.{name}.datatype: {field['datatype']} is none of 1 to 8")
    if int(field["count"]) > 1:
        raise CloudError(f"fields.{name}.count: a point has one {name}, not {field['count']}")
    if _count(message) and int(field["offset"]) + int(kind[1]) > step:
        offset = field["offset"]
        raise CloudError(f"fields.{name}.offset: byte {offset} is not within a point of {step} bytes (point_step)")
    return (">" if message["is_bigendian"] else "<") + kind


def records(
    message: Mapping[str, Any], names: Sequence[str], formats: Sequence[str], offsets: Sequence[int]
) -> NDArray[Any]:
    """The points (height, width) with some of their fields, uncopied; raises `CloudError` where bytes are missing.

    A cloud without a point is (0, 0), whatever its steps are.
    """
    if not _count(message):
        return np.empty((0, 0), np.dtype({"names": names, "formats": formats}))
    height, width, step, row = (int(message[name]) for name in ("height", "width", "point_step", "row_step"))
    if row < width * step:
        raise CloudError(f"row_step: {row} bytes hold no {width} points of {step} bytes (point_step)")
    data = np.frombuffer(message["data"], np.uint8)
    needed = (height - 1) * row + width * step
    if len(data) < needed:
        raise CloudError(f"data: {len(data)} bytes, where {height} rows of {row} (row_step) need {needed}")
    # only now: numpy knows no step beyond 2^31, and no data have one
    kind = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    return np.ndarray((height, width), kind, data, strides=(row, step))


def _count(message: Mapping[str, Any]) -> int:
    return int(message["height"]) * int(message["width"])
