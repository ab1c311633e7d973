"""Turned maps made straight: Nav2 needs grids whose yaw is 0."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev.mapflag import MAX_CELLS, UNKNOWN, MapFlag, looked_up, too_large
from yarp_compat.dev.mapgrid import MapGrid2D

_ROWS = 64  # at once
_PLACES = ((0.0, 0.0), (-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25))
_RANK = np.array([MapFlag.UNKNOWN, MapFlag.FREE, MapFlag.ENLARGED_OBSTACLE, MapFlag.TEMPORARY_OBSTACLE,
                  MapFlag.KEEP_OUT, MapFlag.WALL], np.uint8)  # fmt: skip
"""Flags from what gives way to the others to what stays, where cells meet in one."""


def turned(grid: MapGrid2D) -> MapGrid2D:
    """A map of the same places whose theta is 0; the same object where that is so already.

    A cell becomes the worst of those that it lies on at its middle and half way to its corners, so that walls stay
    closed. What lies beyond the map is unknown.

    Raises:
        ValueError: it would have too many cells.
    """
    if not grid.origin.theta:
        return grid
    left, bottom, width, height = _bounds(grid)
    straight = MapGrid2D.of(
        np.full((height, width), MapFlag.UNKNOWN, np.uint8),
        name=grid.name, resolution=grid.resolution, origin=(left, bottom, 0.0),
    )  # fmt: skip
    straight.enable_map_compression_over_network(grid.compressed)
    order = np.zeros(256, np.uint8)
    order[_RANK] = np.arange(len(_RANK))
    ranks, cells = looked_up(grid.flags, order).reshape(-1), np.ascontiguousarray(grid.occupancy).reshape(-1)
    for top in range(0, height, _ROWS):
        rows = slice(top, min(top + _ROWS, height))
        worst, occupancy = _seen(grid, ranks, cells, straight, rows)
        straight.flags[rows], straight.occupancy[rows] = _RANK[worst], occupancy
    return straight


def _bounds(grid: MapGrid2D) -> tuple[float, float, int, int]:
    """The left and lower end of what a map covers, metres, and how many cells wide and high that is."""
    ends = np.array([(x, y) for x in (0, grid.m_width) for y in (0, grid.m_height)]) * grid.resolution
    ends += (grid.origin.x, grid.origin.y)
    ca, sa = grid.origin.get_ca(), grid.origin.get_sa()
    x, y = ends[:, 0] * ca + ends[:, 1] * sa, ends[:, 1] * ca - ends[:, 0] * sa
    width, height = (max(math.ceil(float(np.ptp(v)) / grid.resolution - 1e-6), 1) for v in (x, y))
    if width * height > MAX_CELLS:
        raise ValueError(f"turned to yaw 0, it is {too_large(width, height)}")
    return float(x.min()), float(y.min()), width, height


def _seen(
    grid: MapGrid2D, ranks: NDArray[np.uint8], cells: NDArray[np.uint8], straight: MapGrid2D, rows: slice
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """What rows of the straight map lie on: the highest rank, and the occupancy there."""
    start, right, down = grid.in_cells(straight.centers_of([(0, rows.start), (1, rows.start), (0, rows.start + 1)]))
    columns, lines = np.arange(straight.m_width), np.arange(rows.stop - rows.start)[:, None]
    middles = [start[axis] + columns * (right - start)[axis] + lines * (down - start)[axis] for axis in (0, 1)]
    shape = len(lines), len(columns)
    worst, occupancy = np.zeros(shape, np.uint8), np.full(shape, UNKNOWN, np.uint8)
    for place in _PLACES:
        shift = place[0] * (right - start) + place[1] * (down - start)
        column, row = (np.floor(middle + by).astype(np.int32) for middle, by in zip(middles, shift, strict=True))
        there = (column >= 0) & (column < grid.m_width) & (row >= 0) & (row < grid.m_height)
        at = np.where(there, row * np.int64(grid.m_width) + column, 0)
        rank, found = np.where(there, ranks[at], 0), np.where(there, cells[at], UNKNOWN)
        # of two of one rank, the more surely occupied; 255 wraps to 0, below all that is known
        higher = (rank > worst) | (rank == worst) & (found + np.uint8(1) > occupancy + np.uint8(1))
        worst, occupancy = np.where(higher, rank, worst), np.where(higher, found, occupancy)
    return worst, occupancy
