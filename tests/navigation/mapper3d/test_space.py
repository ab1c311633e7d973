"""The 3D map: adding, forgetting, saving, and the obstacles that the robot would touch."""

import math
from typing import Any

import numpy as np
import pytest

from navigation.algorithms.voxel_layer import EDGE, FLOOR, OBSTACLE
from navigation.mapper3d.layer import grid_of
from navigation.mapper3d.section import Mapper3DSection
from navigation.mapper3d.space import OPTICAL, FieldOfView, SensorPose, Space, view_of
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.octree import OcTree

CAMERA = SensorPose(OPTICAL, (0.02, 0.03, 1.01))  # at a height of 1 m, looking along x
WIDE = FieldOfView(OPTICAL, (-1.0, 1.0, -1.0, 1.0))


def wall(at, size=0.4, middle=(0.0, 0.0), step=0.02):
    """Return points of a square in front of a camera, at a distance."""
    side = np.arange(-size, size, step)
    x, y = np.meshgrid(side + middle[0], side + middle[1])
    return np.stack((x, y, np.full(x.shape, at)), -1).reshape(-1, 3).astype(np.float32)


def space(**settings: Any) -> Space:
    return Space(Mapper3DSection(resolution=0.05, **settings))


def test_points_are_mapped_at_their_true_positions():
    mapped = space()
    mapped.add(wall(2.0), CAMERA, WIDE, 1.0)
    middles = mapped.occupied()
    assert len(middles) == pytest.approx(17 * 17, abs=20)
    assert np.abs(middles[:, 0] - 2.02).max() < 0.05
    assert np.abs(middles[:, 1]).max() < 0.5
    assert mapped.voxels.log_odds(np.array([[1.0, 0.03, 1.01]]))[0] < 0


def test_points_too_near_or_too_far_are_not_occupied():
    mapped = space(nearest=0.5, farthest=3.0)
    mapped.add(wall(0.3, size=0.2), CAMERA, WIDE, 1.0)
    assert not mapped.voxels.count
    mapped.add(wall(9.0), CAMERA, WIDE, 1.0)
    assert not len(mapped.occupied())
    free = mapped.voxels.log_odds(np.array([[x, 0.03, 1.01] for x in (0.1, 2.9, 3.3)]))
    assert (free[:2] < 0).all()
    assert np.isnan(free[2])


def test_removed_obstacles_are_cleared_by_rays():
    mapped = space()
    for _ in range(3):
        mapped.add(wall(1.0), CAMERA, WIDE, 1.0)
    for _ in range(10):
        mapped.add(wall(2.0, size=1.0), CAMERA, WIDE, 1.0)
    assert (mapped.occupied()[:, 0] > 1.9).all()


def test_visible_voxels_that_are_no_longer_seen_are_forgotten():
    """For example, a person who stood in front of open space has left."""
    kept, mapped = space(), space(forget_after=5.0)
    for target in (kept, mapped):
        target.add(wall(1.0, middle=(-0.5, 0.0), size=0.2), CAMERA, WIDE, 1.0)  # on the left
        target.add(wall(1.5, middle=(3.0, 0.0), size=0.2), CAMERA, WIDE, 1.0)  # beyond the right edge
        hidden = np.concatenate([wall(1.0, middle=(0.5, 0.0), size=0.2), wall(2.0, middle=(1.0, 0.0), size=0.1)])
        target.add(hidden, CAMERA, WIDE, 1.0)
        before = len(target.occupied())
        for second in (3.0, 5.0, 7.0, 9.0):
            target.add(wall(1.0, middle=(0.5, 0.0), size=0.2), CAMERA, WIDE, second)
    assert len(kept.occupied()) == before
    left = mapped.occupied()
    assert mapped.forgotten == before - len(left)
    assert (left[:, 1] < 0.0).all()  # only the left part is forgotten
    assert (left[:, 0] > 1.9).any()
    assert (left[:, 1] < -2.5).any()


@pytest.mark.parametrize(("axes", "edges"), [
    (OPTICAL, (-0.2, 0.2, -0.2, 0.2)), (np.eye(3), (-0.2, 0.2, -0.2, 0.2)),
])  # fmt: skip
def test_the_view_is_as_wide_as_the_cloud(axes, edges):
    cloud = wall(2.0) @ (OPTICAL.T @ axes).astype(np.float32)
    view = view_of(cloud.astype(np.float32))
    np.testing.assert_array_equal(view.axes, axes)
    np.testing.assert_allclose(view.edges, edges, atol=0.011)
    inside, outside = np.array([[2.0, 0.1, 0.1], [2.0, 0.5, 0.0]]) @ axes
    assert view.contains(np.array([inside, outside, -inside])).tolist() == [True, False, False]


def test_the_view_of_a_scanner_covers_all_directions():
    turn = np.linspace(0, math.tau, 100)
    cloud = np.concatenate([np.stack((3 * np.cos(turn), 3 * np.sin(turn), 0 * turn + z), -1) for z in (-0.5, 0.5)])
    view = view_of(cloud.astype(np.float32))
    assert view.contains(np.array([[-3.0, 0.0, 0.1], [0.0, 3.0, 0.1], [1.0, 0.0, 1.0]])).tolist() == [True, True, False]
    assert not view_of(np.empty((0, 3), np.float32)).contains(np.array([[1.0, 0.0, 0.0]])).any()


def test_without_a_view_voxels_within_the_clouds_extent_are_forgotten():
    mapped = space(forget_after=5.0)
    mapped.add(wall(1.0, size=0.2), CAMERA, None, 1.0)
    assert len(mapped.occupied())
    sides = np.concatenate([wall(1.0, middle=(y, 0.0), size=0.3) for y in (-0.6, 0.6)])
    for second in (4.0, 9.0):
        mapped.add(sides, CAMERA, None, second)
    assert mapped.forgotten > 30
    assert (np.abs(mapped.occupied()[:, 1]) > 0.25).all()


def test_a_full_map_stops_or_drops_the_farthest_blocks():
    stops, forgets = space(memory=1), space(memory=1, when_full="forget")
    for target in (stops, forgets):
        for x in range(0, 20, 2):
            target.add(wall(3.0, size=1.5), SensorPose(CAMERA.rotation, (float(x), 0.0, 1.0)), WIDE, 1.0)
        assert target.voxels.count <= (1 << 20) // 4700
        assert target.voxels.megabytes <= 1.1
    assert stops.voxels.full
    assert stops.occupied()[:, 0].max() < 10.0
    assert forgets.given_up > 0
    assert forgets.occupied()[:, 0].max() > 20.0


def test_a_loaded_tree_is_continued():
    mapped, other = space(), space()
    mapped.add(wall(1.0), CAMERA, WIDE, 1.0)
    tree = mapped.tree()
    other.load(OcTree.from_full(tree.full(), 0.05))
    assert other.tree().full() == tree.full()
    with pytest.raises(ValueError, match=r"voxels have 0.1 m, Mapper3D's 0.05 m: set modules.mapper3d.resolution"):
        other.load(OcTree.of([[0, 0, 0]], [1.0], resolution=0.1))
    with pytest.raises(ValueError, match=r"more than the .* \(modules.mapper3d.memory\)"):
        other.load(OcTree.of([[0, 0, 0]], [1.0], [2], resolution=0.05))
    assert other.tree().full() == tree.full()


def test_octomap_reads_the_tree(tmp_path):
    octomap = pytest.importorskip("pyoctomap")
    mapped = space()
    for distance in (1.0, 1.2, 2.0):
        mapped.add(wall(distance), CAMERA, WIDE, 1.0)
    file = tmp_path / "map.ot"
    from yarp_compat.octomap import Octomap

    Octomap.of(mapped.tree()).save(file)
    tree = octomap.OcTree(0.05).read(str(file))
    assert tree.getNumLeafNodes() == len(mapped.tree())
    node = tree.search([2.02, 0.03, 1.01])
    assert node.getLogOdds() == mapped.voxels.log_odds(np.array([[2.02, 0.03, 1.01]]))[0]


def test_clear_box_frees_known_voxels():
    mapped = space()
    mapped.add(wall(1.0), CAMERA, WIDE, 1.0)
    unknown = int(np.isnan(mapped.voxels.values).sum())
    mapped.clear_box(np.array([0.0, -5.0, -5.0]), np.array([5.0, 0.0, 5.0]))
    assert (mapped.occupied()[:, 1] > 0.0).all()
    assert len(mapped.occupied())
    assert np.isnan(mapped.voxels.values).sum() == unknown


def test_a_table_is_an_obstacle_and_a_stair_down_is_keep_out_in_the_layer():
    mapped = space(farthest=8.0)
    rng = np.random.default_rng(1)
    turn = np.linspace(0.0, math.tau, 16, endpoint=False)
    for angle in turn:  # from all sides, from 3 m away, toward the center
        origin = np.array([3.0 * math.cos(angle), 3.0 * math.sin(angle), 1.3])
        rays = rng.normal(size=(40_000, 3)) * (0.3, 0.3, 0.15) - origin / np.linalg.norm(origin)
        rays[:, 2] -= 0.1
        reach = np.full(len(rays), np.inf)
        for height, radius, beyond in ((0.75, 0.5, False), (0.0, 2.0, False), (-0.5, 9.0, True)):
            distance = (height - origin[2]) / rays[:, 2]
            x, y = origin[0] + rays[:, 0] * distance, origin[1] + rays[:, 1] * distance
            inside = (distance > 0) & (np.hypot(x, y) < radius if not beyond else (x > -9.0))
            inside &= ~((height == 0.0) & (x > 1.5))  # the stair begins here
            reach = np.where(inside & (distance < reach), distance, reach)
        seen = np.isfinite(reach)
        pose = SensorPose(np.eye(3), tuple(origin.tolist()))
        mapped.add((rays * reach[:, None])[seen].astype(np.float32), pose, WIDE, 1.0)
    columns = mapped.layer((-1.5, 0.0, 0.0))

    def kinds(x0, x1, y0, y1) -> np.ndarray:
        low = np.floor((np.array([[x0, y0], [x1, y1]]) - columns.corner) / 0.05).astype(int)
        return columns.kinds[low[0, 1] : low[1, 1], low[0, 0] : low[1, 0]]

    assert (kinds(-0.3, 0.3, -0.3, 0.3) == OBSTACLE).mean() > 0.95
    assert (kinds(-1.2, -0.8, -0.3, 0.3) == FLOOR).mean() > 0.95
    assert (kinds(1.6, 1.8, -0.5, 0.5) == EDGE).mean() > 0.9
    grid = grid_of(columns, "layer", 0.05)
    for place, flag, value in (((0.0, 0.0), MapFlag.WALL, 100), ((1.7, 0.0), MapFlag.KEEP_OUT, 100),
                               ((-1.0, 0.0), MapFlag.FREE, 0)):  # fmt: skip
        column, row = grid.cells_at(place)
        assert (grid.flags[row, column], grid.occupancy[row, column]) == (flag, value)
    low = Space(Mapper3DSection(resolution=0.05, farthest=8.0, layer={"height": 0.5}))
    low.voxels = mapped.voxels
    columns = low.layer((-1.5, 0.0, 0.0))
    assert (kinds(-0.3, 0.3, -0.3, 0.3) != OBSTACLE).all()
