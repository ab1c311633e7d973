"""The depth camera: images of a world's solids with a stereo camera's noise, and their point clouds."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.base import BasePose
from sim.depth_kernel import render
from sim.section import CameraSection

Depths = NDArray[np.float32]
Floats = NDArray[np.float64]

_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from the optical frame (z ahead, x right, y down) to the camera's own frame (x ahead, y left, z up)."""


class DepthCamera:
    """A pinhole camera on the base.

    Depth is focal length times baseline divided by disparity, so a disparity error causes a depth error that grows with
    the square of the depth (Intel's white paper "Subpixel Linearity Improvement for RealSense D400"). The errors of
    pixels are independent.

    Attributes:
        lens: fx, fy, cx, cy, pixels.
        size: width and height, pixels.
    """

    def __init__(self, section: CameraSection, seed: int) -> None:
        self._section, self._seed = section, seed
        self.size = width, height = section.width, section.height
        fx, fy = (n / 2 / math.tan(math.radians(a) / 2) for n, a in zip(self.size, section.fov, strict=True))
        self.lens = fx, fy, (width - 1) / 2, (height - 1) / 2
        self._error = section.noise / (fx * section.baseline)
        self._rotation = _about_z(section.yaw) @ _about_y(section.pitch) @ _OPTICAL
        rows, columns = np.indices((height, width), np.float32)
        self._rays = np.stack(((columns - self.lens[2]) / fx, (rows - self.lens[3]) / fy), -1).astype(np.float32)

    def picture(self, time_ns: int, pose: BasePose, solids: Floats, drops: Floats) -> Depths:
        """Return the depths, (height, width) meters, of solids and drops as in `sim.depth_kernel.render`.

        Minus infinity means too near, infinity too far, NaN no value. The noise depends only on the seed
        and the time, not on earlier pictures.
        """
        section, out = self._section, np.empty(self.size[::-1], np.float32)
        turned, eye = self.optical_frame(pose)
        render(solids, drops, eye, turned, np.array(self.lens), math.inf, out)
        rng = np.random.default_rng((self._seed, time_ns))
        if self._error:
            noise = rng.standard_normal(out.shape, np.float32)
            noise *= float(self._error)
            with np.errstate(invalid="ignore"):
                out += noise * np.square(np.where(np.isfinite(out), out, np.float32(0.0)))
        out[out > section.farthest] = math.inf
        out[out < section.nearest] = -math.inf
        if section.dropouts:
            out[rng.random(out.shape, np.float32) < section.dropouts] = math.nan
        return out

    def optical_frame(self, pose: BasePose) -> tuple[Floats, Floats]:
        """Return the optical frame's rotation (3, 3) and position (3, meters; z from the floor) for a base pose."""
        around = _about_z(math.degrees(pose.yaw))
        x, y, z = self._section.at
        return np.ascontiguousarray(around @ self._rotation), around @ (x, y, 0.0) + (pose.x, pose.y, z)

    def points(self, depths: Depths) -> Depths:
        """Return a picture's points in the optical frame, (height, width, 3) meters; not finite for missing depths."""
        points = np.empty((*depths.shape, 3), np.float32)
        with np.errstate(invalid="ignore"):
            np.multiply(self._rays, depths[..., None], out=points[..., :2])
        points[..., 2] = depths
        return points


def _about_z(degrees: float) -> Floats:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _about_y(degrees: float) -> Floats:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
