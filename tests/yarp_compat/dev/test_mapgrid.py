"""MapGrid2D: cells, positions, obstacles and the encoding."""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.yarp_compat.dev.maps import METERS, maps
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapflag import MAX_CELLS, UNKNOWN, MapFlag, flags_of, lookup, occupancy_of
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.mapinfo import MapGrid2DInfo, MapGrid2DOrigin
from yarp_compat.sig.image import ImageMono, ImageRgb
from yarp_compat.sig.vec2d import Vec2D, Vec2DInt, Vec2DSize
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile

# Results of MapGrid2D of YARP 4.0 for a map of 53 x 37 cells of 0.05 m at (-1.25, 0.5): theta, a position, its cell by
# world2Cell, the position of that cell by cell2World, and whether the position is inside.
REAL = """
0 -1.1499999999999995 0.45999999999999969 2 36 -1.1499999999999999 0.5 1
0 -0.40999999999999948 0.86999999999999966 16 29 -0.44999999999999996 0.84999999999999987 1
0 1.0700000000000005 1.6899999999999995 46 13 1.0500000000000003 1.6499999999999999 1
0 -3 1.2799999999999996 0 21 -1.25 1.25 0
30 -0.40999999999999948 0.86999999999999966 9 36 -0.44282032302755103 0.83301270189221932 1
30 1.0700000000000005 1.2799999999999996 30 14 1.0165063509461096 1.2606406460551021 1
30 -3 0.86999999999999966 0 36 -0.83253175473054841 1.0580127018922192 0
-120 -2.6299999999999999 0.049999999999999711 52 1 -2.6235571585149868 0.044134295108992694 1
-120 -0.03999999999999948 -1.1800000000000002 4 34 0.0053847577293366644 -1.2093266739736603 1
-120 -3 1.2799999999999996 52 7 -2.3637495373796553 0.19413429510899272 0
"""


@pytest.mark.parametrize("line", REAL.split("\n")[1:-1])
def test_cells_and_positions_equal_those_of_a_real_yarp(line: str) -> None:
    theta, x, y, column, row, cell_x, cell_y, inside = map(float, line.split())
    info = MapGrid2DInfo("m", 53, 37, 0.05, (-1.25, 0.5, theta))
    assert info.world2Cell(Vec2D(x, y)) == Vec2DSize(int(column), int(row))
    place = info.cell2World(Vec2DSize(int(column), int(row)))
    assert (place.x, place.y) == pytest.approx((cell_x, cell_y), abs=1e-12)
    assert info.isInsideMap(Vec2D(x, y)) == bool(inside)


@given(grid=maps(), spot=st.tuples(st.integers(0, 11), st.integers(0, 11)))
@settings(max_examples=50)
def test_the_center_of_a_cell_is_in_the_cell(grid: MapGrid2D, spot: tuple[int, int]) -> None:
    grid.setResolution(max(grid.resolution, 0.01))
    cell = spot[0] % grid.width(), spot[1] % grid.height()
    assert tuple(grid.cells_at(grid.centers_of(cell))) == cell
    shape = grid.centers_of(np.zeros((3, 4, 2), int)).shape
    assert grid.cells_at(np.zeros(shape)).shape == shape == (3, 4, 2)


@given(x=METERS, y=METERS, theta=st.floats(-180, 180), d=st.tuples(METERS, METERS))
@settings(max_examples=50)
def test_the_origins_of_yarp_and_ros_are_equivalent(x: float, y: float, theta: float, d: Any) -> None:
    info = MapGrid2DInfo("m", 1, 1, 1.0, (x, y, theta))
    corner_x, corner_y, yaw = info.origin.to_ros()
    ca, sa = math.cos(yaw), math.sin(yaw)
    ros = corner_x + (d[0] + 0.5) * ca - (d[1] + 0.5) * sa, corner_y + (d[0] + 0.5) * sa + (d[1] + 0.5) * ca
    assert tuple(info.centers_of((d[0], -d[1]))) == pytest.approx(ros, abs=1e-6)
    assert tuple(MapGrid2DOrigin.from_ros(corner_x, corner_y, yaw)) == pytest.approx((x, y, theta), abs=1e-6)


def test_positions_and_cells_are_converted() -> None:
    with pytest.raises(ValueError, match="origin"):
        MapGrid2DOrigin(math.nan, 0, 0)
    assert MapGrid2DOrigin(1, 2, 370) == MapGrid2DOrigin(1, 2, 10)
    grid = MapGrid2D.of(np.zeros((2, 3)), name="m", resolution=0.5)
    assert grid.toLocation(Vec2DSize(1, 0)) == Map2DLocation("m", 0.5, 0.5)
    assert grid.toLocation(Vec2D(0.2, 0.3)) == Map2DLocation("m", 0.2, 0.3)
    assert grid.toXYCell(Map2DLocation("m", 1.2, 0.7)) == Vec2DSize(2, 0)
    assert grid.toXYWorld(Map2DLocation("m", 1.2, 0.7)) == Vec2D(1.2, 0.7)
    assert grid.isInsideMap(Vec2DInt(2, 1))
    assert not grid.isInsideMap(Vec2DInt(3, 1))
    assert not grid.isInsideMap(Vec2DInt(-1, 1))


def test_the_flag_and_occupancy_of_a_cell_are_set_and_read() -> None:
    grid = MapGrid2D()
    assert (grid.width(), grid.height(), grid.getResolution(), grid.getMapName()) == (2, 2, 1.0, "")
    cell = Vec2DSize(1, 0)
    assert grid.isFree(cell)
    assert grid.setMapFlag(cell, MapGrid2D.MAP_CELL_WALL)
    assert (grid.getMapFlag(cell), grid.flags[0, 1], grid.isWall(cell)) == (MapFlag.WALL, 4, True)
    assert (grid.isFree(cell), grid.isNotFree(cell)) == (False, False)  # as in YARP, which checks the occupancy
    assert grid.setOccupancyData(cell, 100)
    assert (grid.getOccupancyData(cell), grid.isNotFree(cell)) == (100.0, True)
    assert grid.setOccupancyData(cell, -1)
    assert (grid.getOccupancyData(cell), grid.occupancy[0, 1]) == (-1.0, UNKNOWN)
    for flag in (MapFlag.KEEP_OUT, MapFlag.TEMPORARY_OBSTACLE, MapFlag.ENLARGED_OBSTACLE):
        assert grid.setMapFlag((0, 0), flag)
        assert (grid.isNotFree((0, 0)), grid.isKeepOut((0, 0))) == (True, flag == MapFlag.KEEP_OUT)
    grid.clearMapTemporaryFlags()
    assert grid.isFree((0, 0))
    away = Vec2DSize(2, 0)
    assert (grid.setMapFlag(away, 1), grid.getMapFlag(away), grid.getOccupancyData(away)) == (False, None, None)
    assert not any((grid.isFree(away), grid.isNotFree(away), grid.isWall(away), grid.isKeepOut(away)))
    with pytest.raises(ValueError, match="6 is not a valid MapFlag"):
        grid.setMapFlag(cell, 6)
    with pytest.raises(ValueError, match="at most 100"):
        grid.setOccupancyData(cell, 101)


def test_the_size_and_name_of_a_map_are_set_and_read() -> None:
    grid = MapGrid2D()
    assert grid.setMapName("m")
    assert not grid.setMapName("")
    assert grid.setResolution(0.5)
    assert not any(map(grid.setResolution, (0, -1, math.nan, math.inf)))
    assert grid.setSize_in_meters(2, 1)
    assert (grid.getSize_in_cells(), grid.getSize_in_meters(), grid.flags.shape) == ((4, 2), (2.0, 1.0), (2, 4))
    assert not grid.setSize_in_cells(0, 3)
    with pytest.raises(ValueError, match="is too large"):
        grid.setSize_in_cells(MAX_CELLS, 2)
    assert grid.setOrigin(-1, 2, 3)
    assert (grid.getOrigin(), grid.getMapName()) == ((-1.0, 2.0, 3.0), "m")
    with pytest.raises(ValueError, match="shape"):
        MapGrid2D.of(np.zeros((2, 2)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="0 to 255"):
        MapGrid2D.of([[0, 256]])
    with pytest.raises(ValueError, match="meters wide"):
        MapGrid2D.of(np.zeros((2, 2)), resolution=0)


@pytest.mark.parametrize("size", [0.05, 0.1, 0.12, 0.35, 10.0])
def test_obstacles_are_enlarged_as_by_the_passes_of_yarp(size: float) -> None:
    rng = np.random.default_rng(5)
    flags = np.where(rng.random((31, 17)) < 0.02, rng.integers(1, 6, (31, 17)), 0).astype(np.uint8)
    grid = MapGrid2D.of(flags.copy(), resolution=0.05)
    grid.enlargeObstacles(size)
    wanted = flags.copy()
    for _ in range(math.ceil(size / 0.05)):
        around = np.pad(wanted, 1)
        near = np.max([around[y : y + 31, x : x + 17] for y in range(3) for x in range(3)], axis=0)
        wanted[(near > 0) & (wanted == 0)] = MapFlag.ENLARGED_OBSTACLE
    assert (grid.flags == wanted).all()
    grid.enlargeObstacles(0)
    assert (grid.flags == np.where(flags == MapFlag.ENLARGED_OBSTACLE, 0, flags)).all()


def test_a_map_is_cropped_to_a_range_or_to_known_cells() -> None:
    flags = np.arange(20, dtype=np.uint8).reshape(4, 5) % 6
    grid = MapGrid2D.of(flags, resolution=0.5, origin=(1, 2, 90))
    before = grid.centers_of((2, 1))
    assert grid.crop(1, 1, 4, 3)
    assert (grid.flags == flags[1:3, 1:4]).all()
    assert tuple(grid.centers_of((1, 0))) == pytest.approx(tuple(before))
    assert not grid.crop(0, 0, 9, 1)
    assert not grid.crop(2, 0, 1, 1)
    known = np.full((6, 7), UNKNOWN, np.uint8)
    known[1:4, 2:6] = 0
    grid = MapGrid2D.of(flags_of(known), known)
    assert grid.crop()
    assert (grid.getSize_in_cells(), grid.getOrigin()) == ((4, 3), (2.0, 2.0, 0.0))
    assert not MapGrid2D.of(np.full((2, 2), MapFlag.UNKNOWN, np.uint8)).crop()


def test_flags_and_occupancy_are_converted_from_and_to_images() -> None:
    flags = np.array([[0, 1, 2], [3, 4, 5]], np.uint8)
    grid, picture, grays = MapGrid2D.of(flags), ImageRgb(), ImageMono()
    assert grid.getMapImage(picture)
    colors = [(254, 254, 254), (255, 0, 0), (100, 100, 200), (255, 200, 0), (0, 0, 0), (205, 205, 205)]
    assert [picture.getPixel(i % 3, i // 3) for i in range(6)] == colors
    other = MapGrid2D.of(np.zeros((2, 3), np.uint8))
    assert other.setMapImage(picture)
    assert (other.flags == flags).all()
    picture.setPixel(0, 0, (1, 2, 3))
    assert other.setMapImage(picture)
    assert other.getMapFlag((0, 0)) is MapFlag.UNKNOWN
    assert grid.getOccupancyGrid(grays)
    assert (grays.numpy() == [[0, 0, 0], [0, 100, 255]]).all()
    assert other.setOccupancyGrid(grays)
    assert (other.occupancy == grid.occupancy).all()
    assert not MapGrid2D().setMapImage(picture)
    assert not MapGrid2D().setOccupancyGrid(grays)


def test_flags_and_occupancy_are_derived_from_each_other() -> None:
    assert occupancy_of(np.arange(7, dtype=np.uint8)).tolist() == [0, 0, 0, 0, 100, 255, 255]
    assert flags_of(np.array([0, 49, 50, 100, 101, 255], np.uint8)).tolist() == [0, 0, 4, 4, 5, 5]


@given(
    edges=st.lists(st.integers(1, 255), max_size=4, unique=True),
    values=st.lists(st.integers(0, 255), min_size=5, max_size=5),
    shape=st.sampled_from([(0, 0), (1, 1), (3, 5), (1100, 1000)]),
    rotated=st.booleans(),
)
@settings(max_examples=60)
def test_lookup_equals_indexing_for_any_table(
    edges: list[int], values: list[int], shape: tuple[int, int], rotated: bool
) -> None:
    table = np.array(values, np.uint8)[np.searchsorted(sorted(edges), np.arange(256), "right")]
    cells = np.resize(np.random.default_rng(5).permutation(np.arange(256)).astype(np.uint8), shape)
    cells = cells[::-1, ::-1] if rotated else cells
    assert np.array_equal(lookup(cells, table), table[cells])


@given(grid=maps(), profile=st.sampled_from(Profile), zipped=st.booleans())
@settings(max_examples=50)
def test_a_map_survives_encoding_and_decoding(grid: MapGrid2D, profile: Profile, zipped: bool) -> None:
    grid.enable_map_compression_over_network(zipped)
    decoded = MapGrid2D.from_bytes(grid.to_bytes(profile), profile)
    assert decoded == grid == decoded.copy()
    assert decoded.compressed == zipped
    assert decoded.flags.flags.writeable
    text = MapGrid2D()
    text.from_text(grid.to_text())
    assert text == grid


def fields(**changes: Any) -> list[Any]:
    usual = {"width": 5, "height": 2, "x": 0.0, "y": 0.0, "theta": 0.0, "resolution": 0.1, "name": "m", "zipped": 0}
    usual |= {"cells": bytes(10), "flags": bytes(10)}
    return list((usual | changes).values())


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"width": 31623, "height": 31623}, "31623 x 31623 cells is too large"),
        ({"width": -5, "height": -2}, "is too large"),
        ({"flags": bytes(9)}, "has 10 cells, but its data has 9"),
        ({"zipped": 1}, "cannot be unzipped"),
        ({"zipped": 1, "cells": zlib.compress(bytes(10_000_000))}, "its data has 11"),
        ({"resolution": 0.0}, "meters wide"),
        ({"x": math.nan}, "origin"),
    ],
)
def test_malicious_maps_are_rejected(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(WireError, match=reason):
        MapGrid2D.from_bytes(binary.encode(fields(**changes), Profile.YARP4), Profile.YARP4)
    grid = MapGrid2D()
    grid.setMapName("x" * 255)
    with pytest.raises(WireError, match="at most 254 bytes"):
        grid.to_bytes()
