"""Depth images of the hub as points, by the camera's ``CameraInfo``.

``32FC1`` is metres, ``16UC1`` millimetres (REP 118). Pixels without a depth (0, NaN, infinite) say nothing. Points are
in the camera's optical frame (REP 103): x to the right, y down, z ahead. The pixels are taken as rectified.
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
    """What of a camera's ``CameraInfo`` is used: pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def view(self) -> tuple[float, float, float, float]:
        """Tangents of its view: right, left, lower and upper edge, positive to the left and upwards."""
        left, up = (self.cx + 0.5) / self.fx, (self.cy + 0.5) / self.fy
        return left - self.width / self.fx, left, up - self.height / self.fy, up


def read_camera(message: Mapping[str, Any]) -> Camera:
    """The camera of a ``CameraInfo``; raises `CloudError`, which names the field."""
    width, height = int(message["width"]), int(message["height"])
    fx, _, cx, _, fy, cy = (float(value) for value in message["k"][:6])
    if not 0 < width * height <= MOST_POINTS:
        raise CloudError(f"width, height: a camera has pixels, {MOST_POINTS} at most; not {width} x {height}")
    if not (all(map(math.isfinite, (fx, fy, cx, cy))) and fx > 0.0 and fy > 0.0):
        raise CloudError(f"k: lengths of focus are above 0, not {fx:g} and {fy:g}; the camera is not calibrated")
    return Camera(width, height, fx, fy, cx, cy)


def read_depth(message: Mapping[str, Any]) -> NDArray[np.float32]:
    """(height, width) metres, 0 where there is none; raises `CloudError`, which names the field."""
    width, height, step = (int(message[key]) for key in ("width", "height", "step"))
    kind, unit = _TYPES.get(str(message["encoding"]), ("", 0.0))
    if not kind:
        raise CloudError(f"encoding: depth is {' or '.join(_TYPES)}, not {str(message['encoding'])[:40]!r}")
    if not 0 < width * height <= MOST_POINTS:
        raise CloudError(f"width, height: an image has pixels, {MOST_POINTS} at most; not {width} x {height}")
    size = int(kind[1])
    if step < width * size:
        raise CloudError(f"step: {step} bytes hold no {width} pixels of {size} bytes")
    data = np.frombuffer(message["data"], np.uint8)
    needed = (height - 1) * step + width * size
    if len(data) < needed:
        raise CloudError(f"data: {len(data)} bytes, where {height} rows of {step} (step) need {needed}")
    order = ">" if message["is_bigendian"] else "<"
    rows = np.ndarray((height, width), order + kind, data, strides=(step, size))
    return rows.astype(np.float32) * np.float32(unit) if unit != 1.0 else rows.astype(np.float32)


class Rays:
    """Points of a camera's images; what does not change from one to the next is kept."""

    def __init__(self, every: int) -> None:
        self._every = every
        self._camera: Camera | None = None
        self._across, self._down = np.empty(0, np.float32), np.empty(0, np.float32)

    def points(self, depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
        """(n, 3) points of an image in its optical frame, metres; raises `CloudError` if it is not of that camera."""
        if depth.shape != (camera.height, camera.width):
            raise CloudError(
                f"width, height: an image of {depth.shape[1]} x {depth.shape[0]} pixels is not of the camera of "
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
        found = np.empty((len(rows), 3), np.float32)
        z = ahead[seen]
        found[:, 0], found[:, 1], found[:, 2] = z * self._across[columns], z * self._down[rows], z
        return found
