"""The mapper: it builds a map from scans with poses, and overlays painted cells."""

from __future__ import annotations

import math

import numpy as np
import pytest

from navigation.mapper2d.mapper import PAINTS, Mapper
from navigation.mapper2d.section import Mapper2DSection
from navigation.pose import Pose
from yarp_compat.dev.mapflag import UNKNOWN, MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

BEAMS = 360
STEP = math.tau / BEAMS
WALL, FREE, KEEP_OUT = MapFlag.WALL, MapFlag.FREE, MapFlag.KEEP_OUT


def circle(mapper: Mapper, x: float, y: float, radius: float = 2.02, times: int = 5) -> None:
    """Add scans from the center of a round room."""
    for _ in range(times):
        mapper.scan(Pose(x, y, 0.3), np.full(BEAMS, radius), 0.0, STEP, 10.0)


def flag(grid: MapGrid2D, x: float, y: float) -> MapFlag:
    column, row = grid.cells_at((x, y))
    return MapFlag(grid.flags[row, column])


@pytest.fixture
def mapper() -> Mapper:
    return Mapper(Mapper2DSection(map_name="here", width=6.0, height=6.0, farthest=8.0, largest=30.0))


def test_the_map_is_centered_on_the_first_pose(mapper: Mapper) -> None:
    circle(mapper, 100.02, -50.0)
    grid = mapper.grid()
    assert grid.name == "here"
    assert mapper.size == pytest.approx((6.0, 6.0))
    assert (flag(grid, 100.0, -50.0), flag(grid, 102.02, -50.0)) == (FREE, WALL)
    assert flag(grid, 102.5, -50.0) == MapFlag.UNKNOWN
    assert set(np.unique(grid.occupancy)) == {0, 100, UNKNOWN}


def test_the_map_grows_with_the_laser_range_and_keeps_known_cells(mapper: Mapper) -> None:
    circle(mapper, 0.0, 0.0)
    mapper.paint((0.5, 0.5), KEEP_OUT, 2)
    before = mapper.grid()
    circle(mapper, 5.0, -4.0)
    after = mapper.grid()
    assert after.width() > before.width()
    for x, y in ((0.0, 0.0), (0.51, 0.49), (-1.99, 0.01), (5.0, -4.0), (5.0, -6.02)):
        inside = abs(x) < 3.0 and abs(y) < 3.0
        assert flag(after, x, y) == (flag(before, x, y) if inside else WALL if y == -6.02 else FREE), (x, y)
    assert not mapper.full


def test_the_map_does_not_exceed_its_largest_size(mapper: Mapper) -> None:
    circle(mapper, 0.0, 0.0)
    circle(mapper, 40.0, 0.0)
    assert mapper.full
    assert mapper.size == pytest.approx((6.0, 6.0))
    circle(mapper, 20.0, 0.0)
    assert mapper.full is False
    assert mapper.size[0] <= 30.0
    with pytest.raises(ValueError, match="more than 30 m"):
        mapper.enlarge(1e9)


def test_beams_without_echoes_do_not_grow_the_map(mapper: Mapper) -> None:
    mapper.scan(Pose(0.0, 0.0, 0.0), np.full(BEAMS, math.inf), 0.0, STEP, 100.0)
    mapper.scan(Pose(0.0, 0.0, 0.0), np.full(BEAMS, math.nan), 0.0, STEP, 100.0)
    assert mapper.size == pytest.approx((6.0, 6.0))
    assert mapper.scans == 2


def test_scans_are_used_only_between_start_and_stop(mapper: Mapper) -> None:
    mapper.mapping = False
    circle(mapper, 0.0, 0.0)
    assert (mapper.grid().flags == MapFlag.UNKNOWN).all()
    mapper.mapping = True
    circle(mapper, 0.0, 0.0)
    assert mapper.scans == 5
    mapper.clear()
    assert (mapper.grid().flags == MapFlag.UNKNOWN).all()


def test_paint_overrides_the_laser_until_it_is_reset(mapper: Mapper) -> None:
    circle(mapper, 0.0, 0.0)
    assert mapper.paint((1.0, 0.0), WALL, 1) == 1
    mapper.paint((-1.0, 0.0), KEEP_OUT, 3)
    mapper.paint((0.0, 2.02), FREE, 5)
    circle(mapper, 0.0, 0.0)
    grid = mapper.grid()
    assert (flag(grid, 1.0, 0.0), flag(grid, -1.0, 0.0), flag(grid, 0.0, 2.02)) == (WALL, KEEP_OUT, FREE)
    column, row = grid.cells_at((1.0, 0.0))
    assert grid.occupancy[row, column] == 100
    for place in ((1.0, 0.0), (-1.0, 0.0), (0.0, 2.02)):
        mapper.paint(place, PAINTS["unknown"], 5)
        assert flag(mapper.grid(), *place) == MapFlag.UNKNOWN
    circle(mapper, 0.0, 0.0)
    assert (flag(mapper.grid(), 1.0, 0.0), flag(mapper.grid(), 0.0, 2.02)) == (FREE, WALL)


def test_a_line_is_painted_without_gaps(mapper: Mapper) -> None:
    cells = mapper.paint((-1.0, -1.0), WALL, 1, (1.52, 0.37))
    assert cells == round(2.52 / 0.05) + 1
    grid = mapper.grid()
    for share in np.linspace(0.0, 1.0, 51):
        column, row = grid.cells_at((-1.0 + share * 2.52, -1.0 + share * 1.37))
        around = grid.flags[row - 1 : row + 2, column - 1 : column + 2]
        assert (around == WALL).any()


def test_a_brush_at_the_border_paints_only_cells_on_the_map(mapper: Mapper) -> None:
    assert mapper.paint((-2.99, -2.99), WALL, 5) == 9
    with pytest.raises(ValueError, match="outside the map"):
        mapper.paint((3.1, 0.0), WALL, 1)
    for brush in (0, -3, 1_000_000):
        with pytest.raises(ValueError, match="a brush must have"):
            mapper.paint((0.0, 0.0), WALL, brush)


def test_a_saved_map_is_continued(mapper: Mapper) -> None:
    circle(mapper, 0.0, 0.0)
    mapper.paint((-1.0, 0.0), KEEP_OUT, 3)
    saved = mapper.grid()
    other = Mapper(mapper.settings)
    other.load(saved)
    assert (other.grid().flags == saved.flags).all()
    assert other.grid().origin == saved.origin
    circle(other, 0.0, 0.0, radius=1.52, times=30)
    assert (flag(other.grid(), 1.52, 0.0), flag(other.grid(), -1.0, 0.0)) == (WALL, KEEP_OUT)


def test_a_rotated_map_is_aligned_with_the_axes(mapper: Mapper) -> None:
    flags = np.zeros((40, 20), np.uint8)
    flags[:, 0] = WALL
    mapper.load(MapGrid2D.of(flags, name="turned", resolution=0.05, origin=(0.0, 0.0, 90.0)))
    assert mapper.name == "turned"
    assert mapper.grid().origin.theta == 0.0
    assert (mapper.grid().flags == WALL).sum() >= 38


def test_maps_with_another_resolution_or_size_are_rejected(mapper: Mapper) -> None:
    with pytest.raises(ValueError, match=r"cells have 0\.1 m"):
        mapper.load(MapGrid2D.of(np.zeros((4, 4), np.uint8), name="coarse", resolution=0.1))
    with pytest.raises(ValueError, match="larger than 30 m"):
        mapper.load(MapGrid2D.of(np.zeros((4, 700), np.uint8), name="wide", resolution=0.05))


def test_a_scan_from_a_pose_that_is_not_finite_is_rejected(mapper: Mapper) -> None:
    with pytest.raises(ValueError, match="finite"):
        mapper.scan(Pose(math.nan, 0.0, 0.0), np.ones(4), 0.0, STEP, 10.0)


def test_obstacles_are_enlarged_only_on_published_maps(mapper: Mapper) -> None:
    circle(mapper, 0.0, 0.0)
    mapper.enlarged = 0.2
    assert flag(mapper.grid(), 1.85, 0.0) == MapFlag.ENLARGED_OBSTACLE
    mapper.enlarged = 0.0
    assert flag(mapper.grid(), 1.85, 0.0) == FREE


def test_enlarge_adds_cells_on_all_sides(mapper: Mapper) -> None:
    circle(mapper, 0.0, 0.0)
    mapper.enlarge(2.0)
    assert mapper.size == pytest.approx((10.0, 10.0))
    assert flag(mapper.grid(), 2.02, 0.0) == WALL
    with pytest.raises(ValueError, match="above 0"):
        mapper.enlarge(-1.0)
