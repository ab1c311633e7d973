"""Maps for planners: grids, masks, polygons and rotated maps."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bridge.messages.definitions.schema import Schema
from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter
from navigation.maps import kernels
from navigation.maps.grid import data_of, from_grid, message_of, to_cdr, to_grid, turned
from navigation.maps.masks import (
    ENLARGED_OBSTACLE,
    KEEP_OUT,
    TEMPORARY_OBSTACLE,
    cells_of,
    keepout_mask,
    speed_mask,
)
from tests.support.uncompiled import uncompiled
from tests.yarp_compat.dev.maps import maps
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapflag import MAX_CELLS, UNKNOWN, MapFlag, flags_of
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.vec2d import Vec2D


def flags_from(occupancy: NDArray[np.uint8], mask: NDArray[np.int8]) -> NDArray[np.uint8]:
    """Return the flags of a map and its keep-out mask, both (height, width) with the rows in the same order."""
    flags = flags_of(occupancy)
    flags[mask == KEEP_OUT] = MapFlag.KEEP_OUT
    flags[mask == TEMPORARY_OBSTACLE] = MapFlag.TEMPORARY_OBSTACLE
    flags[mask == ENLARGED_OBSTACLE] = MapFlag.ENLARGED_OBSTACLE
    return flags


@given(grid=maps())
@settings(max_examples=60)
def test_flags_survive_the_round_trip_through_grid_and_mask(grid: MapGrid2D) -> None:
    mask = from_rows(data_of(keepout_mask(grid)), grid)
    again = from_grid(to_grid(grid), grid.name)
    assert (flags_from(again.occupancy, mask) == grid.flags).all()
    assert (again.occupancy == grid.occupancy).all()
    assert (again.name, again.resolution) == (grid.name, grid.resolution)
    assert again.getOrigin() == pytest.approx(grid.getOrigin(), abs=1e-7)
    with tempfile.TemporaryDirectory() as folder:  # the map also survives ROS map files
        grid.save(Path(folder, "m.yaml"))
        stored = MapGrid2D.load(Path(folder, "m.yaml"))
    assert (flags_from(from_grid(to_grid(stored), "m").occupancy, mask) == grid.flags).all()


@pytest.fixture(scope="module")
def schema() -> Schema:
    return Registry().schema("nav_msgs/msg/OccupancyGrid")


@given(grid=maps(), frame=st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=9), data=st.data())
@settings(max_examples=60)
def test_to_cdr_matches_the_message_writer(schema: Schema, grid: MapGrid2D, frame: str, data: st.DataObject) -> None:
    stamp = data.draw(st.integers(0, 2**31 * 10**9 - 1))
    assert bytes(to_cdr(grid, frame, stamp)) == MessageWriter(schema).message(to_grid(grid, frame, stamp))


def from_rows(data: np.ndarray, grid: MapGrid2D) -> np.ndarray:
    return data.reshape(grid.height(), grid.width())[::-1]


def test_a_map_becomes_an_occupancy_grid() -> None:
    flags = np.array([[0, 1, 2], [3, 4, 5]], np.uint8)
    grid = MapGrid2D.of(flags, [[0, 7, 255], [101, 60, 255]], name="m", resolution=0.5, origin=(-1, 2, 0))
    message = to_grid(grid, "map", 5_000_000_007)
    assert message["data"].dtype == np.int8
    assert message["data"].tolist() == [-1, 60, -1, 0, 7, -1]
    assert message["header"] == {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": "map"}
    info = message["info"]
    assert (info["width"], info["height"], info["resolution"]) == (3, 2, 0.5)
    assert info["origin"]["position"] == {"x": -1.0, "y": 2.0, "z": 0.0}
    assert info["origin"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    assert data_of(keepout_mask(grid)).tolist() == [ENLARGED_OBSTACLE, 0, 0, 0, KEEP_OUT, TEMPORARY_OBSTACLE]
    assert message_of(data_of(keepout_mask(grid)), grid)["info"]["width"] == 3
    assert 0 < ENLARGED_OBSTACLE < TEMPORARY_OBSTACLE < 99
    assert KEEP_OUT == 100


CELLS = pytest.mark.parametrize(
    "cells", [kernels, uncompiled("navigation.maps.kernels")], ids=["compiled", "uncompiled"]
)


@CELLS
def test_join_handles_every_pair_of_occupancy_and_flag(cells: ModuleType) -> None:
    occupancy, flags = (np.ascontiguousarray(part, np.uint8) for part in np.mgrid[:256, :256])
    values = np.empty_like(flags)
    cells.join(occupancy.data, flags.data, values.data)
    wanted = np.where(occupancy <= 100, occupancy, 255)
    wanted[(flags == MapFlag.WALL) & ((occupancy < 50) | (occupancy > 100))] = 100
    wanted[flags == MapFlag.UNKNOWN] = 255
    np.testing.assert_array_equal(values[::-1], wanted)


@CELLS
def test_part_handles_every_grid_value(cells: ModuleType) -> None:
    values = np.arange(256, dtype=np.uint8).reshape(8, 32)
    occupancy, flags = np.empty_like(values), np.empty_like(values)
    cells.part(values.data, occupancy.data, flags.data)
    upward = values[::-1]
    np.testing.assert_array_equal(occupancy, np.where(upward > 100, 255, upward))
    known = np.where(upward >= 50, MapFlag.WALL, MapFlag.FREE)
    np.testing.assert_array_equal(flags, np.where(upward > 100, MapFlag.UNKNOWN, known))


@CELLS
@pytest.mark.parametrize("odd", range(3))
@pytest.mark.parametrize("shape", [(3, 5), (4, 4), (0, 4)])
def test_different_shapes_are_rejected(cells: ModuleType, odd: int, shape: tuple[int, int]) -> None:
    for kernel in (cells.join, cells.part):
        arrays = [np.zeros(shape if number == odd else (3, 4), np.uint8).data for number in range(3)]
        with pytest.raises(ValueError, match="one shape"):
            kernel(*arrays)


def test_painted_walls_and_unknown_cells_are_in_the_grid() -> None:
    grid = MapGrid2D.of([[4, 4, 4, 5, 0, 0]], [[0, 255, 70, 0, 100, 101]])
    assert to_grid(grid)["data"].tolist() == [100, 100, 70, -1, 100, -1]


def test_cells_of_a_rotated_map_keep_their_positions() -> None:
    grid = MapGrid2D.of(np.zeros((3, 5), np.uint8), name="m", resolution=0.5, origin=(1, -2, 40))
    message = to_grid(grid)["info"]
    turn, place = message["origin"]["orientation"], message["origin"]["position"]
    yaw = 2 * math.atan2(turn["z"], turn["w"])
    x, y = 4.5 * 0.5, 0.5 * 0.5
    ros = place["x"] + x * math.cos(yaw) - y * math.sin(yaw), place["y"] + x * math.sin(yaw) + y * math.cos(yaw)
    assert tuple(grid.centers_of((4, 2))) == pytest.approx(ros)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"width": 31623, "height": 31623}, "is too large"),
        ({"width": 3}, "3 x 2 cells must not have 4"),
        ({"width": 0, "height": 0}, "0 x 0 cells must not have"),
        ({"resolution": 0.0}, "meters wide"),
        ({"resolution": math.nan}, "meters wide"),
    ],
)
def test_invalid_grids_are_rejected(changes: dict[str, float], reason: str) -> None:
    message = to_grid(MapGrid2D())
    message["info"] |= changes
    with pytest.raises(ValueError, match=reason):
        from_grid(message, "m")


def square(low: float, high: float, name: str = "m") -> Map2DArea:
    return Map2DArea(name, [Vec2D(low, low), Vec2D(high, low), Vec2D(high, high), Vec2D(low, high)])


def empty(width: int = 10, height: int = 8, theta: float = 0.0) -> MapGrid2D:
    return MapGrid2D.of(np.zeros((height, width), np.uint8), name="m", resolution=0.5, origin=(-1, -1, theta))


def test_keep_out_areas_are_in_the_mask() -> None:
    grid = empty()
    mask = keepout_mask(grid, [square(0.1, 0.9), square(2, 3, "other")])
    assert np.argwhere(mask).tolist() == [[4, 2], [4, 3], [5, 2], [5, 3]]
    assert set(mask[mask > 0]) == {KEEP_OUT}
    assert not grid.flags.any()
    # an area thinner than a cell leaves no gap
    line = Map2DArea("m", [Vec2D(-0.9, -0.9), Vec2D(2.9, 1.9), Vec2D(2.9, 1.901)])
    marked = keepout_mask(grid, [line]) > 0
    assert (marked.sum(axis=0)[:8] > 0).all()
    assert all((marked[:, column] & marked[:, column + 1]).any() for column in range(7))


@given(
    corners=st.lists(st.tuples(st.floats(-4, 6), st.floats(-4, 6)), min_size=3, max_size=6),
    theta=st.sampled_from([0.0, 30.0, -135.0]),
)
@settings(max_examples=60)
def test_cells_of_matches_the_polygon(corners: list[tuple[float, float]], theta: float) -> None:
    grid = empty(theta=theta)
    area = Map2DArea("m", [Vec2D(x, y) for x, y in corners])
    part, inside = cells_of(grid, area.points)
    marked = np.zeros((grid.height(), grid.width()), bool)
    marked[part] = inside
    columns, rows = np.meshgrid(np.arange(grid.width()), np.arange(grid.height()))
    middles = grid.centers_of(np.stack((columns, rows), -1))
    for (row, column), is_marked in np.ndenumerate(marked):
        x, y = middles[row, column]
        if area.contains(x + 1e-9, y + 1e-9) and area.contains(x - 1e-9, y - 1e-9):
            assert is_marked
        elif is_marked:  # the area's border is within the cell
            assert nearest(x, y, corners) <= 0.5 * math.sqrt(0.5) + 1e-6


def nearest(x: float, y: float, corners: list[tuple[float, float]]) -> float:
    """Return the distance of a point to a polygon's border."""
    point, best = np.array((x, y)), math.inf
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        side = np.subtract(end, start)
        length = float(side @ side)
        part = np.clip(float((point - start) @ side) / length, 0, 1) if length else 0.0
        best = min(best, float(np.linalg.norm(point - (start + part * side))))
    return best


def test_huge_polygons_cover_the_map_and_invalid_ones_nothing() -> None:
    grid = empty()
    assert keepout_mask(grid, [square(-1e12, 1e12)]).all()
    for points in (
        [],
        [Vec2D(math.nan, 0), Vec2D(1, 0), Vec2D(1, 1)],
        square(50, 60).points,
    ):
        assert not cells_of(grid, points)[1].any()


@pytest.mark.parametrize(
    ("corners", "cells"),
    [
        ([(0.2, 0.2)], [[5, 2]]),
        ([(0.2, 0.2), (0.2, 0.2)], [[5, 2]]),
        ([(0.2, 0.2), (1.6, 0.2)], [[5, 2], [5, 3], [5, 4], [5, 5]]),
        ([(0.2, 0.2), (0.2, 90.0)], [[0, 2], [1, 2], [2, 2], [3, 2], [4, 2], [5, 2]]),
    ],
)
def test_an_area_with_one_or_two_corners_is_a_point_or_a_line(
    corners: list[tuple[float, float]], cells: list[list[int]]
) -> None:
    """A user who draws a line across a door wants the door to be closed."""
    mask = keepout_mask(empty(), [Map2DArea("m", [Vec2D(x, y) for x, y in corners])])
    assert np.argwhere(mask).tolist() == cells


def test_a_speed_mask_encodes_the_limits() -> None:
    grid = empty()
    single = speed_mask(grid, [(square(0.1, 0.9), 0.2), (square(0, 1, "other"), 0.01)])
    assert (single.base, single.multiplier, single.type) == (0.0, 0.002, 2)
    assert set(single.values.flat) == {0, 100}
    assert single.values[4, 2] == 100
    limits = [(square(-0.9, 2.9), 1.5), (square(0.1, 0.9), 0.2), (square(1.6, 2.4), 0.7)]
    many = speed_mask(grid, limits)
    meant = many.base + many.multiplier * many.values[[7, 5, 2], [0, 2, 6]].astype(float)
    assert meant == pytest.approx([1.5, 0.2, 0.7], abs=1.3 / 99)
    assert (meant <= np.array([1.5, 0.2, 0.7]) + 1e-9).all()
    assert meant[:2] == pytest.approx([1.5, 0.2])
    assert many.values.max() == 100
    assert not speed_mask(grid, []).values.any()
    for wrong in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(ValueError, match="above 0"):
            speed_mask(grid, [(square(0, 1), wrong)])


@given(limits=st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=6))
@settings(max_examples=60)
def test_encoded_limits_are_never_higher_and_never_unlimited(limits: list[float]) -> None:
    for limit in limits:
        mask = speed_mask(empty(2, 2), [(square(-9, 9), limit), *((square(90, 99), other) for other in limits)])
        value = int(mask.values[0, 0])
        assert 1 <= value <= 100
        assert mask.base + mask.multiplier * value <= limit * (1 + 1e-5)


@pytest.mark.parametrize("theta", [15.0, 30.0, 45.0, 90.0, -77.0, 180.0])
def test_aligning_a_rotated_map_keeps_its_walls_closed(theta: float) -> None:
    flags = np.zeros((40, 50), np.uint8)
    flags[5:35, [5, 44]] = flags[[5, 34], 5:45] = MapFlag.WALL
    flags[10, 10] = MapFlag.KEEP_OUT
    grid = MapGrid2D.of(flags, name="m", resolution=0.1, origin=(1, -2, theta))
    straight = turned(grid)
    assert (straight.name, straight.resolution, straight.origin.theta) == ("m", 0.1, 0.0)
    spot = straight.cells_at(grid.centers_of((10, 10)))
    assert straight.flags[spot[1], spot[0]] == MapFlag.KEEP_OUT
    # no path of steps to neighboring cells leads from inside to outside
    free, seen = straight.flags < MapFlag.WALL, np.zeros(straight.flags.shape, bool)
    column, row = straight.cells_at(grid.centers_of((25, 20)))
    seen[row, column], before = True, 0
    while seen.sum() > before:
        before = seen.sum()
        for shift in (-1, 1):
            seen |= (np.roll(seen, shift, 0) | np.roll(seen, shift, 1)) & free
            seen |= (
                np.roll(np.roll(seen, shift, 0), -shift, 1) & free | np.roll(np.roll(seen, shift, 0), shift, 1) & free
            )
    outside = straight.cells_at(grid.centers_of((2, 2)))
    assert not seen[outside[1], outside[0]]
    assert seen.sum() == pytest.approx(28 * 38, rel=0.15)
    assert (straight.occupancy[straight.flags == MapFlag.WALL] == 100).all()


def test_cells_outside_a_rotated_map_are_unknown() -> None:
    grid = MapGrid2D.of(np.zeros((4, 4), np.uint8), [[0, 30, 0, 0]] * 4, origin=(0, 0, 45))
    straight = turned(grid)
    assert (straight.flags[0, 0], straight.occupancy[0, 0]) == (MapFlag.UNKNOWN, UNKNOWN)
    assert {0, 30, UNKNOWN} == set(straight.occupancy.flat)
    level = MapGrid2D()
    assert turned(level) is level


def test_a_map_too_large_to_align_is_rejected() -> None:
    grid = MapGrid2D.of(np.zeros((1, MAX_CELLS // 64), np.uint8), origin=(0, 0, 45))
    with pytest.raises(ValueError, match="yaw 0"):
        turned(grid)
