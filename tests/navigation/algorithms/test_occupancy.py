"""Maps from scans of known rooms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from navigation.algorithms.occupancy import OccupancyMap
from tests.support.uncompiled import uncompiled

Uncompiled: type[OccupancyMap] = uncompiled("navigation.algorithms.occupancy").OccupancyMap
BEAMS = 720
STEP = 2 * math.pi / BEAMS
CELL = 0.05
ROOM = 3.0


def room_ranges(x: float, y: float, direction: float) -> np.ndarray:
    """Return the ranges of a laser in a square room from 0 to ``ROOM``."""
    angles = direction + np.arange(BEAMS) * STEP
    with np.errstate(divide="ignore"):
        to_x = np.where(np.cos(angles) > 0, ROOM - x, -x) / np.cos(angles)
        to_y = np.where(np.sin(angles) > 0, ROOM - y, -y) / np.sin(angles)
    return np.minimum(to_x, to_y)


@pytest.fixture
def grid() -> OccupancyMap:
    return OccupancyMap(80, 80, CELL, (-0.525, -0.525))


def test_a_rooms_walls_are_occupied_and_its_floor_is_free(grid: OccupancyMap) -> None:
    for x, y, direction in ((1.5, 1.5, 0.0), (0.7, 2.0, 1.0), (2.2, 0.9, -2.0)) * 3:
        assert grid.insert((x, y, direction), room_ranges(x, y, direction), 0.0, STEP, 10.0) > 1000
    centers = np.arange(80) * CELL - 0.5
    found = grid.occupancy()
    inside = (centers > CELL) & (centers < ROOM - CELL)
    assert (found[np.ix_(inside, inside)] == 0).mean() > 0.99
    rows, columns = np.nonzero(found == 100)
    x, y = centers[columns], centers[rows]
    from_wall = np.minimum.reduce([abs(x), abs(y), abs(x - ROOM), abs(y - ROOM)])
    assert from_wall.max() < 1.5 * CELL
    outside = (centers < -2 * CELL) | (centers > ROOM + 2 * CELL)
    assert (found[outside] == -1).all()
    assert (found[:, outside] == -1).all()
    wall = np.argmin(abs(centers))
    assert (found[wall, inside] == 100).mean() > 0.9


def test_unknown_ranges_change_nothing(grid: OccupancyMap) -> None:
    assert grid.insert((1.5, 1.5, 0.0), np.full(BEAMS, np.nan), 0.0, STEP, 10.0) == 0
    assert grid.insert((1.5, 1.5, 0.0), np.zeros(BEAMS), 0.0, STEP, 10.0) == 0
    assert (grid.occupancy() == -1).all()


def test_ranges_beyond_the_limit_free_cells_and_occupy_none(grid: OccupancyMap) -> None:
    for _ in range(5):
        grid.insert((1.5, 1.5, 0.0), np.full(BEAMS, np.inf), 0.0, STEP, 1.0)
    assert grid.odds.max() == 0.0
    assert grid.odds.min() < -1.0


def test_removed_obstacles_are_forgotten(grid: OccupancyMap) -> None:
    one = np.array([1.0])
    for _ in range(50):
        grid.insert((1.5, 1.5, 0.0), one, 0.0, STEP, 10.0)
    at = int((1.5 + 0.525) / CELL), int((2.5 + 0.525) / CELL)
    assert grid.occupancy()[at] == 100
    for _ in range(20):
        grid.insert((1.5, 1.5, 0.0), np.array([2.0]), 0.0, STEP, 10.0)
    assert grid.occupancy()[at] == 0


def test_a_hit_outweighs_beams_that_pass_in_the_same_scan(grid: OccupancyMap) -> None:
    grid.insert((1.5, 1.5, 0.0), np.array([1.0, 2.0, 2.0, 2.0]), 0.0, 1e-6, 10.0)
    at = int((1.5 + 0.525) / CELL), int((2.5 + 0.525) / CELL)
    assert grid.odds[at] > 0.0
    assert not grid.marks.any()


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (-50.0, 3.0, 1.0), (1e9, 0.0, 0.0)])
def test_poses_at_the_border_and_outside_the_map_are_harmless(
    grid: OccupancyMap, pose: tuple[float, float, float]
) -> None:
    grid.insert(pose, np.full(BEAMS, 2.0), 0.0, STEP, 10.0)
    assert np.isfinite(grid.odds).all()


def test_poses_that_are_not_finite_are_rejected(grid: OccupancyMap) -> None:
    with pytest.raises(ValueError, match="finite"):
        grid.insert((math.nan, 0.0, 0.0), np.ones(4), 0.0, STEP, 10.0)


@pytest.mark.parametrize(("rows", "resolution"), [(0, 0.05), (10, 0.0), (10, math.nan)])
def test_invalid_maps_are_rejected(rows: int, resolution: float) -> None:
    with pytest.raises(ValueError, match="a map must have rows, columns and a resolution above 0"):
        OccupancyMap(rows, 10, resolution, (0.0, 0.0))


@pytest.mark.parametrize(("ranges", "free"), [((2.0, 2.0, 2.0), True), ((2.0, 1.0, 2.0), False), ((1.0, 2.0), False)])
def test_a_beam_frees_cells_only_as_far_as_its_neighbors_reach(
    grid: OccupancyMap, ranges: tuple[float, ...], free: bool
) -> None:
    # along a wall, a beam seems to pass through the wall between two hits
    grid.insert((0.5, 0.5, 0.0), np.array(ranges), 0.0, 0.1, 10.0)
    last = 0.1 * (len(ranges) - 1)
    for way, passed in ((0.8, True), (1.5, free)):
        at = int((0.5 + way * math.sin(last) + 0.525) / CELL), int((0.5 + way * math.cos(last) + 0.525) / CELL)
        assert (grid.odds[at] < 0.0) == passed


def test_compiled_and_uncompiled_maps_are_equal() -> None:
    rng = np.random.default_rng(2)
    maps = [map_type(60, 90, CELL, (-1.0, -1.0)) for map_type in (OccupancyMap, Uncompiled)]
    for turn in range(6):
        ranges = np.abs(rng.normal(1.5, 0.8, 200 + turn))
        for odd in (math.nan, math.inf, -math.inf, 1e300, 0.0, -1.0):
            ranges[rng.integers(0, len(ranges), 8)] = odd
        pose = (*rng.uniform(-1.5, 3.5, 2).tolist(), rng.uniform(-9.0, 9.0))
        first, step = rng.random(), rng.choice([-1.0, 1.0]) * rng.uniform(0.0, 0.03)
        farthest = rng.choice([1.0, 10.0, math.inf])
        with np.errstate(all="ignore"):
            touched, wanted = (each.insert(pose, ranges, first, step, farthest) for each in maps)
        assert touched == wanted
        np.testing.assert_array_equal(maps[0].odds, maps[1].odds)
    assert (maps[0].odds > 0.0).any()


@pytest.mark.parametrize("map_type", [OccupancyMap, Uncompiled])
@pytest.mark.parametrize("odd", [math.inf, 1e300, 1e18])
@pytest.mark.parametrize("farthest", [1e300, math.inf])
def test_huge_distances_are_handled(map_type: type[OccupancyMap], odd: float, farthest: float) -> None:
    grid = map_type(20, 30, CELL, (0.0, 0.0))
    with np.errstate(all="ignore"):
        assert grid.insert((0.51, 0.51, 0.0), np.full(8, odd), 0.0, math.pi / 4, farthest) > 20
        grid.insert((1e300, -1e300, 0.0), np.full(8, odd), 0.0, math.pi / 4, farthest)
    assert grid.odds.max() == 0.0
    assert np.isfinite(grid.odds).all()
    assert not grid.marks.any()


@pytest.mark.parametrize("map_type", [OccupancyMap, Uncompiled])
def test_scans_without_beams_and_of_any_layout_are_inserted(map_type: type[OccupancyMap]) -> None:
    grid = map_type(20, 30, CELL, (0.0, 0.0))
    assert grid.insert((0.5, 0.5, 0.0), np.empty(0), 0.0, 0.1, 10.0) == 0
    assert grid.insert((0.31, 0.51, 0.0), np.ones((4, 2), np.float32)[:, 0], 0.0, 0.0, 10.0) == 21
    for first, step in ((math.nan, 0.1), (0.0, math.nan), (math.inf, 0.1), (0.0, math.inf)):
        with pytest.raises(ValueError, match="finite"):
            grid.insert((0.5, 0.5, 0.0), np.ones(4), first, step, 10.0)
