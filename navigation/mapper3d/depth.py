"""Converts depth images to points, with the camera's ``CameraInfo``.

``32FC1`` is in meters, ``16UC1`` in millimeters (REP 118). Pixels without a depth (0, NaN, infinite) are unknown.
Points are in the camera's optical frame (REP 103): x to the right, y down, z ahead. The images must be rectified.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.messages.point_cloud import CloudError
from navigation.clouds import FARTHEST, MOST_POINTS

IMAGE, CAMERA_INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_TYPES = {"32FC1": ("f4", 1.0), "16UC1": ("u2", 0.001), "mono16": ("u2", 0.001)}


class Camera(NamedTuple):
    """The used parts of a ``CameraInfo``, in pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def view(self) -> tuple[float, float, float, float]:
        """Tangents of the image's right, left, lower and upper edge, positive to the left and upwards."""
        left, up = (self.cx + 0.5) / self.fx, (self.cy + 0.5) / self.fy
        return left - self.width / self.fx, left, up - self.height / self.fy, up


def read_camera(message: Mapping[str, Any]) -> Camera:
    """Read a ``CameraInfo``; raises `CloudError` with the name of an invalid field.

    ``p`` is the matrix of the rectified image, ``k`` that of the raw one (sensor_msgs, ``CameraInfo.msg``); some
    drivers leave ``p`` empty.
    """
    width, height = int(message["width"]), int(message["height"])
    p, k = ([float(value) for value in message[name]] for name in "pk")
    fx, cx, fy, cy = (p[0], p[2], p[5], p[6]) if p[0] > 0.0 and p[5] > 0.0 else (k[0], k[2], k[4], k[5])
    if not 0 < width * height <= MOST_POINTS:
        raise CloudError(f"width, height: a camera must have 1 to {MOST_POINTS} pixels, not {width} x {height}")
    if not (all(map(math.isfinite, (fx, fy, cx, cy))) and fx > 0.0 and fy > 0.0):
        raise CloudError(f"k: focal lengths must be above 0, not {fx:g} and {fy:g}; calibrate the camera")
    return Camera(width, height, fx, fy, cx, cy)


def read_depth(message: Mapping[str, Any]) -> NDArray[np.float32]:
    """Return the depths (height, width) in meters, 0 if unknown; raises `CloudError` with the name of a bad field."""
    width, height, step = (int(message[key]) for key in ("width", "height", "step"))
    kind, unit = _TYPES.get(str(message["encoding"]), ("", 0.0))
    if not kind:
        raise CloudError(f"encoding: depth must be {' or '.join(_TYPES)}, not {str(message['encoding'])[:40]!r}")
    if not 0 < width * height <= MOST_POINTS:
        raise CloudError(f"width, height: an image must have 1 to {MOST_POINTS} pixels, not {width} x {height}")
    size = int(kind[1])
    if step < width * size:
        raise CloudError(f"step: {step} bytes are too few for {width} pixels of {size} bytes")
    data = np.frombuffer(message["data"], np.uint8)
    needed = (height - 1) * step + width * size
    if len(data) < needed:
        raise CloudError(f"data: {len(data)} bytes, but {height} rows of {step} (step) need {needed}")
    order = ">" if message["is_bigendian"] else "<"
    rows = np.ndarray((height, width), order + kind, data, strides=(step, size))
    return rows.astype(np.float32) * np.float32(unit) if unit != 1.0 else rows.astype(np.float32)


class Rays:
    """Converts a camera's images to points, and caches the directions of its pixels; uses every n-th pixel."""

    def __init__(self, every: int) -> None:
        self._every = every
        self._camera: Camera | None = None
        self._across, self._down = np.empty(0, np.float32), np.empty(0, np.float32)

    def points(self, depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
        """Return an image's points in its optical frame, (n, 3) meters; raises `CloudError` if the sizes differ."""
        if depth.shape != (camera.height, camera.width):
            raise CloudError(
                f"width, height: the image has {depth.shape[1]} x {depth.shape[0]} pixels, its camera "
                f"{camera.width} x {camera.height}"
            )
        every = self._every
        if camera != self._camera:
            self._camera = camera
            self._across = ((np.arange(camera.width)[::every] - camera.cx) / camera.fx).astype(np.float32)
            self._down = ((np.arange(camera.height)[::every] - camera.cy) / camera.fy).astype(np.float32)
        ahead = depth[::every, ::every]
        seen = (ahead > 0.0) & (ahead < FARTHEST)
        rows, columns = np.nonzero(seen)
        points = np.empty((len(rows), 3), np.float32)
        z = ahead[seen]
        points[:, 0], points[:, 1], points[:, 2] = z * self._across[columns], z * self._down[rows], z
        return points
