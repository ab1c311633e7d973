"""The voxel map builds the same tree as octomap from the same clouds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from navigation.algorithms import voxel_leaves, voxel_map
from navigation.algorithms.voxel_map import LEAST, MIDDLE, MOST, VoxelMap, within
from tests.support.uncompiled import uncompiled

Uncompiled: type[VoxelMap] = uncompiled("navigation.algorithms.voxel_map").VoxelMap
CELL = 0.05


def room(rng: np.random.Generator, count: int = 4000) -> tuple[np.ndarray, tuple[float, float, float]]:
    """Return points on the walls of a room, some beyond the range, and the sensor's position."""
    origin = rng.uniform(-0.2, 0.2, 3)
    directions = rng.normal(size=(count, 3)) * (1.0, 1.0, 0.4)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    reach = (np.array([1.0, 1.5, 0.6]) / np.abs(directions)).min(axis=1) + rng.normal(0.0, 0.02, count)
    return (origin + directions * reach[:, None]).astype(np.float32), tuple(origin.tolist())


def ours(voxels: VoxelMap) -> dict[tuple[int, int, int], float]:
    """Return the log odds of all known voxels, by key."""
    keys = voxels.blocks[:, None, :] * 8 + within(np.arange(512))
    known = ~np.isnan(voxels.values)
    return dict(zip(map(tuple, keys[known].tolist()), voxels.values[known].tolist(), strict=True))


@pytest.mark.parametrize("farthest", [10.0, 1.1])
def test_the_tree_equals_octomaps(farthest):
    octomap = pytest.importorskip("pyoctomap")
    rng = np.random.default_rng(3)
    voxels, tree = VoxelMap(CELL, 10_000), octomap.OcTree(CELL)
    for _ in range(6):
        points, origin = room(rng)
        voxels.insert(points, origin, farthest)
        tree.insertPointCloud(points.astype(float), np.array(origin), max_range=farthest, discretize=True)
    our_tree, expected = ours(voxels), []
    for leaf in tree.begin_leafs():
        low = np.array(leaf.getCoordinate()) - (leaf.getSize() - CELL) / 2
        key = tuple((np.floor(low / CELL).astype(int) + MIDDLE).tolist())
        expected.append((leaf.getDepth(), leaf.current_node.getLogOdds(), our_tree.get(key)))
    _, depths, odds = voxel_leaves.leaves(voxels.blocks, voxels.values)
    assert list(zip(depths.tolist(), odds.tolist(), odds.tolist(), strict=True)) == expected
    assert min(depths) < 16
    assert len(expected) > 2000
    assert any(value > 0 for value in our_tree.values())


def test_compiled_and_uncompiled_leaves_are_equal():
    points, origin = room(np.random.default_rng(4), 600)
    maps = [made(CELL, 10_000) for made in (VoxelMap, Uncompiled)]
    for each in maps:
        each.insert(points, origin, 1.1, 5.0)
    # Python computes in double precision, C partly in single: a ray may pass a corner on different sides
    one, other = map(ours, maps)
    assert len(one.keys() ^ other.keys()) < 0.01 * len(one)
    assert {k for k, v in one.items() if v > 0} == {k for k, v in other.items() if v > 0}
    slow = uncompiled("navigation.algorithms.voxel_leaves").leaves(maps[0].blocks, maps[0].values)
    for fast, expected in zip(voxel_leaves.leaves(maps[0].blocks, maps[0].values), slow, strict=True):
        np.testing.assert_array_equal(fast, expected)


@pytest.mark.parametrize("made", [VoxelMap, Uncompiled])
def test_hit_voxels_gain_and_passed_voxels_lose_odds(made):
    voxels = made(0.1, 100)
    points = np.array([[1.05, 0.05, 0.05], [np.nan, 0, 0], [np.inf, 0, 0], [0, 1e30, 0]], np.float32)
    assert voxels.insert(points, (0.05, 0.05, 0.05), 5.0, 7.0) == 11
    odds = voxels.log_odds(np.array([[1.05, 0.05, 0.05], [0.55, 0.05, 0.05], [1.15, 0.05, 0.05], [1e9, 0, 0]]))
    assert odds[:2].tolist() == pytest.approx([voxel_map.HIT, voxel_map.MISS])
    assert np.isnan(odds[2:]).all()
    assert np.flatnonzero(voxels.seen.ravel() == 7.0).size == 1
    for _ in range(20):
        voxels.insert(points, (0.05, 0.05, 0.05), 5.0)
    assert np.nanmax(voxels.values) == np.float32(MOST)
    assert np.nanmin(voxels.values) == np.float32(LEAST)
    voxels.clear()
    assert not voxels.count
    assert np.isnan(voxels.log_odds(np.array([[1.05, 0.05, 0.05]]))).all()


def test_a_point_beyond_the_range_is_not_hit_and_its_ray_frees_voxels_in_range():
    voxels = VoxelMap(0.1, 100)
    voxels.insert(np.array([[9.05, 0.05, 0.05]], np.float32), (0.05, 0.05, 0.05), 2.0)
    odds = voxels.log_odds(np.array([[x + 0.05, 0.05, 0.05] for x in np.arange(0.0, 3.0, 0.1)]))
    assert (odds[:20] < 0).all()
    assert np.isnan(odds[21:]).all()


def test_the_map_grows_to_its_limit_and_reports_dropped_voxels():
    points, origin = room(np.random.default_rng(5))
    unlimited, bounded = VoxelMap(CELL, 10_000), VoxelMap(CELL, 50)
    unlimited.insert(points, origin, 5.0)
    bounded.insert(points, origin, 5.0)
    assert unlimited.count > 110
    assert not unlimited.full
    assert bounded.count == 50
    assert bounded.full
    assert bounded.megabytes < 1.0
    assert ours(bounded).items() <= ours(unlimited).items()
    bounded.keep(np.arange(50) < 40)
    assert bounded.count == 40
    kept = ours(bounded)
    bounded.insert(points, origin, 5.0)
    assert bounded.count == 50, "the memory of removed blocks is reused"
    assert ours(bounded).keys() >= kept.keys()


@pytest.mark.parametrize("made", [VoxelMap, Uncompiled])
def test_leaves_fill_the_map(made):
    voxels = made(CELL, 1000)
    voxels.fill(np.array([[0, 0, 0], [40, 8, 8], [64, 64, 64]]), np.array([1, 4, 32]), np.array([1.0, -1.0, 2.0]))
    assert sorted(set(ours(voxels).values())) == [-1.0, 1.0, 2.0]
    assert len(ours(voxels)) == 1 + 4**3 + 32**3
    _, depths, odds = voxel_leaves.leaves(voxels.blocks, voxels.values)
    assert (depths.tolist(), odds.tolist()) == ([16, 14] + [13] * 64, [1.0, -1.0] + [2.0] * 64)


@pytest.mark.parametrize(
    ("keys", "side", "words"),
    [
        ([0, 0, 0], 65536, "more than the 50 blocks"),
        ([0, 0, 0], 32, "more than the 50 blocks"),
        ([0, 0, 65536], 1, "outside its keys"),
        ([-1, 0, 0], 1, "outside its keys"),
        ([0, 1, 0], 2, "outside its keys"),
        ([0, 0, 0], 3, "outside its keys"),
    ],
)
def test_invalid_cubes_are_rejected(keys, side, words):
    with pytest.raises(ValueError, match=words):
        VoxelMap(CELL, 50).fill(np.array([keys]), np.array([side]), np.array([1.0]))


@pytest.mark.parametrize("odd", [math.nan, math.inf, 1e9])
def test_a_sensor_outside_the_map_is_rejected(odd):
    voxels = VoxelMap(CELL, 50)
    with pytest.raises(ValueError, match="outside the map"):
        voxels.insert(np.zeros((1, 3), np.float32), (odd, 0.0, 0.0), 5.0)
    with pytest.raises(ValueError, match="points must be"):
        voxels.insert(np.zeros((1, 2), np.float32), (0.0, 0.0, 0.0), 5.0)
    with pytest.raises(ValueError, match="invalid map"):
        VoxelMap(0.0, 50)
