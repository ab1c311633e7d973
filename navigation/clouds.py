"""Point clouds from the hub (``sensor_msgs/msg/PointCloud2``)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.messages.point_cloud import CloudError, number_format, records
from bridge.tf.transform import Transform

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
MOST_POINTS = 4_000_000
"""Larger clouds are rejected: a lidar with 128 channels and a 3-megapixel depth camera have fewer points."""

FARTHEST = 1e9
"""Points with a coordinate of this many meters or more are left out: some sensors report "no echo" as the largest
float32."""

Points = NDArray[np.float32]


def read_points(message: Mapping[str, Any], most: int = MOST_POINTS, enough: int = MOST_POINTS) -> Points:
    """Return the points of a ``PointCloud2``, (n, 3) meters in its frame.

    Points that have a coordinate of NaN, or of `FARTHEST` or more, are left out. Of a cloud with more than ``enough``
    others, every n-th point of all is read, which leaves about that many.
    Raises `CloudError` if the cloud has more than ``most`` points, or its data does not match its description.
    """
    width, height = int(message["width"]), int(message["height"])
    if width * height > most:
        raise CloudError(f"width, height: {width} x {height} points are declared, more than {most}")
    if not width * height:
        return np.empty((0, 3), np.float32)
    cells = _cells(message).reshape(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        if len(cells) > enough:
            valid = int(np.count_nonzero(np.abs(cells["z"]) < FARTHEST))
            cells = cells[:: thinning(valid, enough)]
        points = np.empty((len(cells), 3), np.float32)
        for axis, name in enumerate("xyz"):
            points[:, axis] = cells[name]
    x, y, z = (np.abs(points) < FARTHEST).T  # three times as fast as all(axis=1); NaN compares false
    near = x & y & z
    return points if near.all() else points[near]


def thinning(count: int, enough: int) -> int:
    """Return n for every n-th of ``count`` points, odd: an even n selects the same columns in all rows of an image."""
    return math.ceil(count / enough) | 1 if count > enough else 1


def transform_points(points: Points, at: Transform) -> Points:
    """Transform points (n, 3) into another frame; `at` is the pose of the points' frame in that frame."""
    x, y, z, w = at.rotation
    turned = np.array([
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ], np.float32)  # fmt: skip
    moved: Points = points @ turned.T + np.array(at.translation, np.float32)
    return moved


def _cells(message: Mapping[str, Any]) -> NDArray[Any]:
    """Return x, y and z of each point."""
    fields = {
        str(field["name"]): field for field in reversed(message["fields"])
    }  # the first of several with the same name
    missing = [name for name in "xyz" if name not in fields]
    if missing:
        raise CloudError(f"fields: no {', '.join(missing)} among {', '.join([*fields][::-1]) or 'none'}")
    formats = [number_format(message, fields[name]) for name in "xyz"]
    return records(message, ["x", "y", "z"], formats, [int(fields[name]["offset"]) for name in "xyz"])
