"""Layers of rooms that are built from voxels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from navigation.algorithms import voxel_layer
from navigation.algorithms.voxel_layer import EDGE, FLOOR, OBSTACLE, UNKNOWN, LayerColumns, RobotSize
from navigation.algorithms.voxel_map import MIDDLE, VoxelMap
from tests.support.uncompiled import uncompiled

CELL = 0.05
SIDE, HEIGHT, GROUND = 60, 44, 8  # voxels of a room: along x and y, along z, and those below its floor
ROBOT = RobotSize(height=1.2, width=0.4, step=0.02, margin=0.05, slope=math.radians(10.0))
Box = tuple[slice, slice, slice]


class Room:
    """A completely observed room of 3 x 3 m: the floor, and free space above the floor."""

    def __init__(self) -> None:
        self.odds = np.full((SIDE, SIDE, HEIGHT), np.nan, np.float32)
        self.odds[:, :, GROUND:] = -1.0
        self.odds[:, :, GROUND - 1] = 2.0

    def box(self, x: slice, y: slice, low: float, high: float, odds: float = 2.0) -> Room:
        """Fill a box between two heights above the floor, in meters."""
        self.odds[x, y, GROUND + round(low / CELL) : GROUND + round(high / CELL)] = odds
        return self

    def voxels(self) -> VoxelMap:
        layer = VoxelMap(CELL, 10_000)
        places = np.argwhere(~np.isnan(self.odds))
        layer.fill(
            places + np.array([MIDDLE, MIDDLE, MIDDLE - GROUND]), np.ones(len(places), int), self.odds[tuple(places.T)]
        )
        return layer

    def columns(self, module=voxel_layer, base=(0.5, 0.5, 0.0), robot=ROBOT, largest=20.0) -> LayerColumns:
        voxels = self.voxels()
        return module.columns(voxels.blocks, voxels.values, CELL, base, robot, largest)

    def kinds(self, **settings: Any) -> np.ndarray:
        """Return the kinds of the room's cells (and no others), indexed by x and y."""
        layer = self.columns(**settings)
        assert layer.corner == (0.0, 0.0)
        return layer.kinds.T[:SIDE, :SIDE]


FAR = slice(30, 40)
ALL = slice(None)


def test_the_layer_has_the_lowest_and_highest_voxel_of_obstacles():
    room = Room().box(FAR, FAR, 0.7, 0.75).box(FAR, slice(50, 55), 0.1, 0.2).box(FAR, slice(50, 55), 0.9, 1.0)
    layer = room.box(slice(50, 55), FAR, 1.3, 1.35).columns()
    hits = layer.hits.transpose(1, 0, 2)
    # heights of the lowest and the highest voxel that the robot would touch, measured from the floor's voxel
    assert hits[35, 35] == pytest.approx([0.75, 0.75])
    assert hits[35, 52] == pytest.approx([0.15, 1.0])
    assert np.isnan(hits[52, 35]).all(), "the robot fits under the bar"
    assert (np.isnan(layer.hits[..., 0]) == (layer.kinds != OBSTACLE)).all()


def test_a_bare_floor_is_free_and_unknown_beyond():
    layer = Room().columns()
    assert (layer.kinds[:SIDE, :SIDE] == FLOOR).all()
    assert (layer.kinds[SIDE:] == UNKNOWN).all()
    assert layer.floors[10, 10] == pytest.approx(-0.025)


@pytest.mark.parametrize(
    ("low", "high", "kind"),
    [
        (0.7, 0.75, OBSTACLE),  # a tabletop, which a laser at ankle height does not see
        (1.15, 1.2, OBSTACLE),
        (1.3, 1.35, FLOOR),  # the robot fits under it
        (0.0, 0.05, FLOOR),  # less than the voxels resolve
        (0.0, 0.15, OBSTACLE),  # a step
        (0.0, 2.0, OBSTACLE),
    ],
)
def test_standing_and_hanging_obstacles_block_only_within_the_robots_height(low, high, kind):
    layer = Room().box(FAR, FAR, low, high).kinds()
    assert (layer[FAR, FAR] == kind).all()
    layer[FAR, FAR] = FLOOR
    assert (layer == FLOOR).all()


def test_a_low_robot_fits_under_the_table_and_large_wheels_climb_the_step():
    low = ROBOT._replace(height=0.5)
    assert (Room().box(FAR, FAR, 0.7, 0.75).kinds(robot=low) == FLOOR).all()
    climber = ROBOT._replace(step=0.1)
    assert (Room().box(FAR, ALL, 0.0, 0.1).kinds(robot=climber) == FLOOR).all()
    assert (Room().box(FAR, ALL, 0.0, 0.15).kinds(robot=climber)[FAR] == OBSTACLE).all()


def test_a_stair_down_is_a_drop_and_an_unseen_hole_is_unknown():
    room = Room()
    room.odds[FAR, :, GROUND - 1] = np.nan
    assert (room.kinds()[FAR] == UNKNOWN).all()
    room.odds[FAR, :, GROUND - 4] = -1.0  # a ray passed below the floor
    layer = room.kinds()
    assert (layer[FAR] == EDGE).all()
    assert (layer[:30] == FLOOR).all()
    room.odds[FAR, :, GROUND - 4] = 2.0  # the tread
    assert (room.kinds()[FAR] == EDGE).all()


def test_the_floor_continues_beyond_unknown_and_blocked_columns():
    room = Room().box(slice(20, 22), ALL, 0.0, 2.0)
    room.odds[40:44] = np.nan
    layer = room.kinds()
    assert (layer[22:40] == FLOOR).all()
    assert (layer[40:44] == UNKNOWN).all()
    assert (layer[44:] == FLOOR).all()


def test_a_ramp_is_floor_but_not_its_side_or_a_steeper_one():
    room = Room()
    for x in range(30, 58):  # a slope of 1 in 7, 8 degrees
        room.odds[x, 20:40, GROUND : GROUND + (x - 30) // 7 + 1] = 2.0
    layer = room.kinds()
    assert (layer[30:57, 21:39] == FLOOR).all()
    assert (layer[51:57, [20, 39]] == EDGE).all()
    for x in range(30, 58):
        room.odds[x, 20:40, GROUND : GROUND + (x - 30) // 2 + 1] = 2.0
    assert (room.kinds()[37:55, 21:39] != FLOOR).all()


def test_noise_of_one_voxel_on_the_floor_is_not_an_obstacle():
    rng = np.random.default_rng(1)
    room = Room()
    room.odds[:, :, GROUND] = np.where(rng.random((SIDE, SIDE)) < 0.3, 2.0, -1.0)
    assert (room.kinds() == FLOOR).all()


def test_the_robots_floor_is_at_its_own_height():
    room = Room().box(ALL, ALL, 0.0, 0.5)
    assert (room.kinds(base=(0.5, 0.5, 0.5)) == FLOOR).all()
    assert (room.kinds(base=(0.5, 0.5, 0.0)) != FLOOR).mean() > 0.9


def test_columns_outside_the_largest_size_are_left_out():
    layer = Room().columns(largest=1.6)
    assert layer.kinds.shape == (32, 32)
    empty = voxel_layer.columns(np.empty((0, 3), int), np.empty((0, 512), np.float32), CELL, (9, 9, 0), ROBOT, 20.0)
    assert set(np.unique(empty.kinds)) == {UNKNOWN, FLOOR}


def test_compiled_and_uncompiled_layers_are_equal():
    room = Room().box(FAR, slice(10, 30), 0.7, 0.75).box(slice(10, 14), FAR, 0.0, 0.3)
    fast, slow = room.columns(), room.columns(uncompiled("navigation.algorithms.voxel_layer"))
    np.testing.assert_array_equal(fast.kinds, slow.kinds)
    np.testing.assert_array_equal(fast.floors, slow.floors)


@pytest.mark.parametrize("base", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0)])
def test_an_invalid_robot_position_is_rejected(base):
    with pytest.raises(ValueError, match="invalid robot"):
        Room().columns(base=base)
