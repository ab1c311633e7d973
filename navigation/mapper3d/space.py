"""The 3D map: adding and forgetting observations, and the obstacles that the robot would touch."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.voxel_layer import LayerColumns, RobotSize, columns
from navigation.algorithms.voxel_leaves import leaves
from navigation.algorithms.voxel_map import LEAST, MIDDLE, SIDE, VoxelMap, within
from navigation.mapper3d.section import Mapper3DSection
from yarp_compat.octree import OcTree

BLOCK_BYTES = 4700
"""The size of a block of 8 x 8 x 8 voxels, with its share of the table."""

_GIVEN_UP = 0.125  # the share of the blocks that a full map drops, the farthest ones
_FORGET_EVERY = 1.0  # seconds
_ALL_AROUND = 0.2  # if more than this share of the points is not ahead, a sensor sees in all directions

Floats = NDArray[np.float64]
Place = tuple[float, float, float]


class SensorPose(NamedTuple):
    """The pose of a sensor on the map: ``rotation`` (3, 3) from its frame to the map's, ``origin`` in meters."""

    rotation: Floats
    origin: Place


class FieldOfView(NamedTuple):
    """The field of view of a sensor.

    Attributes:
        axes: (3, 3) matrix from directions in the sensor's frame to ahead, left and up.
        edges: tangents of the right, left, lower and upper edge, relative to the distance ahead. If the sensor sees in
            all directions, the first two are infinite, and the others are relative to the horizontal distance.
    """

    axes: Floats
    edges: tuple[float, float, float, float]

    def contains(self, directions: Floats) -> NDArray[np.bool_]:
        """Return which of the directions (n, 3), in the sensor's frame, are in the field of view."""
        ahead, left, up = self.axes @ directions.T
        right_edge, left_edge, lower, upper = self.edges
        around = math.isinf(left_edge)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = np.hypot(ahead, left) if around else ahead
            aside, above = left / along, up / along
        inside: NDArray[np.bool_] = (lower < above) & (above < upper) & (along > 0.0)
        return inside if around else inside & (right_edge < aside) & (aside < left_edge)


OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Ahead, left and up of an optical frame (REP 103)."""


def view_of(points: NDArray[np.float32]) -> FieldOfView:
    """Estimate the field of view from a cloud, (n, 3) in the sensor's frame, as wide as the points."""
    if not len(points):
        return FieldOfView(np.eye(3), (0.0, 0.0, 0.0, 0.0))
    shares = np.concatenate([(points > 0.0).mean(0), (points < 0.0).mean(0)])
    axis = int(np.argmax(shares * (np.abs(points).max(0)[[0, 1, 2, 0, 1, 2]] > 0)))
    if shares[axis] < 1.0 - _ALL_AROUND or axis in (1, 4, 5):
        level = np.hypot(points[:, 0], points[:, 1])
        heights = points[:, 2] / np.maximum(level, 1e-6)
        return FieldOfView(np.eye(3), (-math.inf, math.inf, float(heights.min()), float(heights.max())))
    sign = 1.0 if axis == 0 else -1.0
    axes = OPTICAL if axis == 2 else np.diag([sign, sign, 1.0])
    x, y, z = points.T
    ahead, left, up = (z, -x, -y) if axis == 2 else (np.float32(sign) * x, np.float32(sign) * y, z)
    front = ahead > 0.05
    if not front.any():
        return FieldOfView(np.eye(3), (0.0, 0.0, 0.0, 0.0))
    sides, heights = left[front] / ahead[front], up[front] / ahead[front]
    return FieldOfView(axes, (float(sides.min()), float(sides.max()), float(heights.min()), float(heights.max())))


class Space:
    """Builds a 3D map from sensors with known poses, without a thread or a clock.

    Attributes:
        clouds: the number of added clouds.
        changes: increases with each change of the map.
        forgotten: the number of forgotten voxels.
        given_up: the number of blocks that were dropped because memory was full.
    """

    def __init__(self, settings: Mapper3DSection) -> None:
        self.settings = settings
        self.voxels = VoxelMap(settings.resolution, max(64, (settings.memory << 20) // BLOCK_BYTES))
        layer = settings.layer
        self._robot = RobotSize(layer.height, layer.width, layer.step, layer.margin, math.radians(layer.slope))
        self.clouds = self.changes = self.forgotten = self.given_up = 0
        self._checked_at = -math.inf

    def add(self, points: NDArray[np.float32], pose: SensorPose, view: FieldOfView | None, now: float) -> None:
        """Add points (n, 3) in a sensor's frame, meters; ``now`` in seconds of any clock.

        Without a view, the field of view is as wide as the points. Raises `ValueError` if the sensor is off the map.
        """
        settings = self.settings
        far = np.sqrt(np.einsum("ij,ij->i", points, points))
        near = far < settings.nearest
        if near.any():
            points, far = points[~near], far[~near]
        # a point beyond the range frees the space up to it; it is moved closer so that rays to one voxel coincide
        beyond = np.float32(settings.farthest + 2.0 * settings.resolution)
        shares = beyond / np.maximum(far, beyond)
        placed = np.empty((len(points), 3), np.float32)
        rotation = pose.rotation.astype(np.float32)
        for axis in range(3):  # a product of such narrow matrices takes ten times as long, on all cores
            along = points[:, 0] * rotation[axis, 0]
            along += points[:, 1] * rotation[axis, 1]
            along += points[:, 2] * rotation[axis, 2]
            placed[:, axis] = along * shares + np.float32(pose.origin[axis])
        self.voxels.insert(placed, pose.origin, settings.farthest, now)
        self.clouds += 1
        self.changes += 1
        if self.voxels.full and settings.when_full == "forget":
            self._drop_farthest(pose.origin)
        if settings.forget_after and not 0.0 <= now - self._checked_at < _FORGET_EVERY:
            self._checked_at = now
            self.forgotten += self._forget_unseen(pose, view or view_of(points), now - settings.forget_after)

    def clear(self) -> None:
        self.voxels.clear()
        self.changes += 1

    def clear_box(self, low: Floats, high: Floats) -> None:
        """Free the known voxels whose centers are in a box (meters), like octomap_server's ``clear_bbx``."""
        side = SIDE * self.settings.resolution
        corners = (self.voxels.blocks - MIDDLE // SIDE) * side
        near = np.flatnonzero(((corners <= high) & (corners + side >= low)).all(-1))
        offsets = (within(np.arange(SIDE**3)) + 0.5) * self.settings.resolution
        for slot in near.tolist():
            middles = corners[slot] + offsets
            values = self.voxels.values[slot]
            values[((middles >= low) & (middles <= high)).all(-1) & ~np.isnan(values)] = LEAST
        self.changes += 1

    def layer(self, base: Place) -> LayerColumns:
        """Return the obstacles that the robot would touch; the floor is followed from the base's position (meters).

        Raises `ValueError` if the base's position is not finite.
        """
        voxels = self.voxels
        return columns(
            voxels.blocks, voxels.values, self.settings.resolution, base, self._robot, self.settings.layer.largest
        )

    def occupied(self) -> NDArray[np.float32]:
        """Return the centers of occupied voxels, (n, 3) meters."""
        slots, places = np.nonzero(self.voxels.values > 0.0)
        keys = self.voxels.blocks[slots] * SIDE + within(places)
        return ((keys - MIDDLE + 0.5) * self.settings.resolution).astype(np.float32)

    def tree(self) -> OcTree:
        """Return the octree of known voxels, pruned as OctoMap does."""
        return OcTree(self.settings.resolution, *leaves(self.voxels.blocks, self.voxels.values)).pruned()

    def load(self, tree: OcTree) -> None:
        """Continue another tree; raises `ValueError` if its resolution differs, or it is too large."""
        resolution = self.settings.resolution
        if abs(tree.resolution - resolution) > 1e-6:
            raise ValueError(
                f"the map's voxels have {tree.resolution:g} m, Mapper3D's {resolution:g} m: "
                "set modules.mapper3d.resolution"
            )
        voxels = VoxelMap(resolution, self.voxels.most)
        try:
            voxels.fill(tree.keys().astype(np.int64), tree.edges(), tree.log_odds)
        except ValueError as err:
            raise ValueError(f"{err} (modules.mapper3d.memory)") from None
        self.voxels = voxels
        self.changes += 1

    def _drop_farthest(self, origin: Place) -> None:
        """Drop the blocks that are farthest from a sensor."""
        away = ((self.voxels.blocks - MIDDLE // SIDE + 0.5) * SIDE * self.settings.resolution - origin).astype(
            np.float64
        )
        distances = (away**2).sum(-1)
        last = np.quantile(distances, 1.0 - _GIVEN_UP)
        self.given_up += int((distances >= last).sum())
        self.voxels.keep(distances < last)

    def _forget_unseen(self, pose: SensorPose, view: FieldOfView, before: float) -> int:
        """Reset occupied voxels that are in sight, but were last seen before a time (seconds); return their number."""
        voxels, resolution = self.voxels, self.settings.resolution
        slots, places = np.nonzero((voxels.values > 0.0) & (voxels.seen < before))
        keys = voxels.blocks[slots] * SIDE + within(places)
        rays = (keys - MIDDLE + 0.5) * resolution - pose.origin
        inside = view.contains(rays @ pose.rotation) & ((rays**2).sum(-1) <= self.settings.farthest**2)
        count = 0
        for slot, place, ray in zip(slots[inside].tolist(), places[inside].tolist(), rays[inside], strict=True):
            if self._in_sight(pose.origin, ray):
                voxels.values[slot, place] = np.nan
                count += 1
        return count

    def _in_sight(self, origin: Place, ray: Floats) -> bool:
        """Whether no occupied voxel is between a sensor and a voxel, checked at each half voxel."""
        resolution = self.settings.resolution
        steps = max(2, math.ceil(2.0 * float(np.linalg.norm(ray)) / resolution))
        points = origin + np.linspace(0.0, 1.0, steps)[:, None] * ray
        in_voxel = (np.floor(points / resolution) == np.floor(points[-1] / resolution)).all(-1)
        return not (self.voxels.log_odds(points[~in_voxel]) > 0.0).any()
