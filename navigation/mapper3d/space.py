"""The space that Mapper3D maps: what was seen of it, what is forgotten, and what of it the robot would touch."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.config.sections.mapper3d import Mapper3DSection
from navigation.algorithms.voxel_layer import LayerColumns, RobotSize, columns
from navigation.algorithms.voxel_leaves import leaves
from navigation.algorithms.voxel_map import LEAST, MIDDLE, SIDE, VoxelMap, within
from yarp_compat.octree import OcTree

BLOCK_BYTES = 4700
"""Of a block of 8 x 8 x 8 voxels, with its share of the table."""

_GIVEN_UP = 0.125  # of the blocks, where the farthest are given up
_FORGET_EVERY = 1.0  # seconds
_ALL_AROUND = 0.2  # of all points, not ahead of a sensor: it sees all around

Floats = NDArray[np.float64]
Place = tuple[float, float, float]


class Seat(NamedTuple):
    """Where a sensor was: ``turn`` (3, 3) takes its directions to the map's, ``origin`` is on the map, metres."""

    turn: Floats
    origin: Place


class FieldOfView(NamedTuple):
    """What a sensor looks at.

    Attributes:
        axes: (3, 3) takes its directions to ahead, left and up.
        edges: tangents of the right, left, lower and upper edge by the way ahead; where it sees all around the first
            two are infinite, and the others are by the way along the level.
    """

    axes: Floats
    edges: tuple[float, float, float, float]

    def has(self, ways: Floats) -> NDArray[np.bool_]:
        """Which of the directions (n, 3), in its frame, it looks at."""
        ahead, left, up = self.axes @ ways.T
        right_edge, left_edge, lower, upper = self.edges
        around = math.isinf(left_edge)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = np.hypot(ahead, left) if around else ahead
            aside, above = left / along, up / along
        found: NDArray[np.bool_] = (lower < above) & (above < upper) & (along > 0.0)
        return found if around else found & (right_edge < aside) & (aside < left_edge)


OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Ahead, left and up of an optical frame (REP 103)."""


def view_of(points: NDArray[np.float32]) -> FieldOfView:
    """The view of a sensor by a cloud of it, (n, 3) in its frame: as far as its points go to each side."""
    if not len(points):
        return FieldOfView(np.eye(3), (0.0, 0.0, 0.0, 0.0))
    shares = np.concatenate([(points > 0.0).mean(0), (points < 0.0).mean(0)])
    axis = int(np.argmax(shares * (np.abs(points).max(0)[[0, 1, 2, 0, 1, 2]] > 0)))
    if shares[axis] < 1.0 - _ALL_AROUND or axis in (1, 4, 5):
        level = np.hypot(points[:, 0], points[:, 1])
        heights = points[:, 2] / np.maximum(level, 1e-6)
        return FieldOfView(np.eye(3), (-math.inf, math.inf, float(heights.min()), float(heights.max())))
    way = 1.0 if axis == 0 else -1.0
    axes = OPTICAL if axis == 2 else np.diag([way, way, 1.0])
    x, y, z = points.T
    ahead, left, up = (z, -x, -y) if axis == 2 else (np.float32(way) * x, np.float32(way) * y, z)
    front = ahead > 0.05
    if not front.any():
        return FieldOfView(np.eye(3), (0.0, 0.0, 0.0, 0.0))
    sides, heights = left[front] / ahead[front], up[front] / ahead[front]
    return FieldOfView(axes, (float(sides.min()), float(sides.max()), float(heights.min()), float(heights.max())))


class Space:
    """Takes what sensors see whose places are known. It has no thread and no clock of its own.

    Attributes:
        clouds: how many were taken.
        forgotten: how many voxels were.
        given_up: how many blocks were, since memory was full.
    """

    def __init__(self, settings: Mapper3DSection) -> None:
        self.settings = settings
        self.voxels = VoxelMap(settings.resolution, max(64, (settings.memory << 20) // BLOCK_BYTES))
        layer = settings.layer
        self._robot = RobotSize(layer.height, layer.width, layer.step, layer.margin, math.radians(layer.slope))
        self.clouds = self.forgotten = self.given_up = 0
        self._looked = -math.inf

    def take(self, points: NDArray[np.float32], seat: Seat, view: FieldOfView | None, now: float) -> None:
        """Take points (n, 3) in a sensor's frame, metres; ``now``: seconds of any clock. Raises `ValueError`.

        Without a view it is as wide as the points are.
        """
        settings = self.settings
        far = np.sqrt(np.einsum("ij,ij->i", points, points))
        near = far < settings.nearest
        if near.any():
            points, far = points[~near], far[~near]
        # what is beyond all belief frees the way to it, and is drawn near so that rays to one place are one
        beyond = np.float32(settings.farthest + 2.0 * settings.resolution)
        shares = beyond / np.maximum(far, beyond)
        placed = np.empty((len(points), 3), np.float32)
        turn = seat.turn.astype(np.float32)
        for axis in range(3):  # a product of matrices so narrow takes ten times as long, on all cores
            along = points[:, 0] * turn[axis, 0]
            along += points[:, 1] * turn[axis, 1]
            along += points[:, 2] * turn[axis, 2]
            placed[:, axis] = along * shares + np.float32(seat.origin[axis])
        self.voxels.insert(placed, seat.origin, settings.farthest, now)
        self.clouds += 1
        if self.voxels.full and settings.when_full == "forget":
            self._give_up(seat.origin)
        if settings.forget_after and not 0.0 <= now - self._looked < _FORGET_EVERY:
            self._looked = now
            self.forgotten += self._forget(seat, view or view_of(points), now - settings.forget_after)

    def clear(self) -> None:
        """Forget all."""
        self.voxels.clear()

    def clear_box(self, low: Floats, high: Floats) -> None:
        """Make free what is known in a box, by the middles of voxels (metres), as octomap_server's ``clear_bbx``."""
        side = SIDE * self.settings.resolution
        corners = (self.voxels.blocks - MIDDLE // SIDE) * side
        near = np.flatnonzero(((corners <= high) & (corners + side >= low)).all(-1))
        offsets = (within(np.arange(SIDE**3)) + 0.5) * self.settings.resolution
        for slot in near.tolist():
            middles = corners[slot] + offsets
            values = self.voxels.values[slot]
            values[((middles >= low) & (middles <= high)).all(-1) & ~np.isnan(values)] = LEAST

    def layer(self, base: Place) -> LayerColumns:
        """What the robot would touch, followed from its base on the floor (metres); raises `ValueError`."""
        voxels = self.voxels
        return columns(
            voxels.blocks, voxels.values, self.settings.resolution, base, self._robot, self.settings.layer.largest
        )

    def occupied(self) -> NDArray[np.float32]:
        """(n, 3) middles of the occupied voxels, metres."""
        slots, places = np.nonzero(self.voxels.values > 0.0)
        keys = self.voxels.blocks[slots] * SIDE + within(places)
        return ((keys - MIDDLE + 0.5) * self.settings.resolution).astype(np.float32)

    def tree(self) -> OcTree:
        """The octree of what is known, pruned as OctoMap's."""
        return OcTree(self.settings.resolution, *leaves(self.voxels.blocks, self.voxels.values)).pruned()

    def load(self, tree: OcTree) -> None:
        """Go on with another tree; raises `ValueError` if its voxels have another size, or it is too large."""
        ours = self.settings.resolution
        if abs(tree.resolution - ours) > 1e-6:
            raise ValueError(
                f"the map's voxels are of {tree.resolution:g} m, Mapper3D's of {ours:g} m: "
                "set modules.mapper3d.resolution"
            )
        voxels = VoxelMap(ours, self.voxels.most)
        try:
            voxels.fill(tree.keys().astype(np.int64), tree.edges(), tree.log_odds)
        except ValueError as err:
            raise ValueError(f"{err} (modules.mapper3d.memory)") from None
        self.voxels = voxels

    def _give_up(self, origin: Place) -> None:
        """Forget the blocks that are farthest from a sensor."""
        away = ((self.voxels.blocks - MIDDLE // SIDE + 0.5) * SIDE * self.settings.resolution - origin).astype(
            np.float64
        )
        distances = (away**2).sum(-1)
        last = np.quantile(distances, 1.0 - _GIVEN_UP)
        self.given_up += int((distances >= last).sum())
        self.voxels.keep(distances < last)

    def _forget(self, seat: Seat, view: FieldOfView, before: float) -> int:
        """Make unknown what is occupied, in plain sight, and was not seen since then (seconds); how many voxels."""
        voxels, resolution = self.voxels, self.settings.resolution
        slots, places = np.nonzero((voxels.values > 0.0) & (voxels.seen < before))
        keys = voxels.blocks[slots] * SIDE + within(places)
        ways = (keys - MIDDLE + 0.5) * resolution - seat.origin
        inside = view.has(ways @ seat.turn) & ((ways**2).sum(-1) <= self.settings.farthest**2)
        gone = 0
        for slot, place, way in zip(slots[inside].tolist(), places[inside].tolist(), ways[inside], strict=True):
            if self._in_sight(seat.origin, way):
                voxels.values[slot, place] = np.nan
                gone += 1
        return gone

    def _in_sight(self, origin: Place, way: Floats) -> bool:
        """Whether nothing occupied is between a sensor and a voxel, looked at each half voxel."""
        resolution = self.settings.resolution
        steps = max(2, math.ceil(2.0 * float(np.linalg.norm(way)) / resolution))
        looked = origin + np.linspace(0.0, 1.0, steps)[:, None] * way
        its_own = (np.floor(looked / resolution) == np.floor(looked[-1] / resolution)).all(-1)
        return not (self.voxels.log_odds(looked[~its_own]) > 0.0).any()
