"""Masks on a map's cells: polygons, keep-out areas and speed limits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapflag import MapFlag, lookup
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.mapinfo import MapGrid2DInfo
from yarp_compat.sig.vec2d import Vec2D

Part = tuple[slice, slice]


def cells_of(info: MapGrid2DInfo, points: Sequence[Vec2D]) -> tuple[Part, NDArray[np.bool_]]:
    """Return the part of a map (rows and columns) around a polygon, and which of its cells the polygon touches.

    A polygon touches the cells whose center is inside, and those that its border crosses, so that even a polygon
    thinner than a cell leaves no gap. Corners are in meters; two make a line, one makes a point, none touch no cell.
    """
    corners = info.in_cells(np.array([(point.x, point.y) for point in points], float).reshape(-1, 2))
    low = np.clip(np.floor(np.min(corners, axis=0, initial=np.inf)), 0, None)
    high = np.max(corners, axis=0, initial=-np.inf)
    high = np.minimum(np.floor(high) + 1, (info.m_width, info.m_height))
    if not (np.isfinite(corners).all() and (low < high).all()):
        return (slice(0, 0), slice(0, 0)), np.zeros((0, 0), np.bool_)
    (left, top), (right, bottom) = low.astype(int), high.astype(int)
    shifted = corners - low
    inside = _inside(shifted, bottom - top, right - left)
    for start, end in zip(shifted, np.roll(shifted, -1, axis=0), strict=True):
        _draw(inside, start, end)
    return (slice(top, bottom), slice(left, right)), inside


def _inside(corners: NDArray[np.float64], height: int, width: int) -> NDArray[np.bool_]:
    """Return the cells whose center has an odd number of borders to its left."""
    odd = np.zeros((height, width + 1), np.bool_)
    for (x, y), (to_x, to_y) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        first, last = (int(np.clip(np.ceil(v - 0.5), 0, height)) for v in sorted((y, to_y)))
        rows = np.arange(first, last)
        if len(rows):
            crossing = x + (rows + 0.5 - y) * ((to_x - x) / (to_y - y))
            odd[rows, np.clip(np.ceil(crossing - 0.5), 0, width).astype(int)] ^= True
    inside: NDArray[np.bool_] = np.logical_xor.accumulate(odd, axis=1)[:, :width]
    return np.ascontiguousarray(inside)


def _draw(cells: NDArray[np.bool_], start: NDArray[np.float64], end: NDArray[np.float64]) -> None:
    """Mark the cells that a line crosses, at points on it a quarter of a cell apart."""
    size = np.array(cells.shape[::-1], float)
    line = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.sort(np.stack(((0 - start) / line, (size - start) / line)), axis=0)
    # a line along one axis has no bounds on the other
    enter = max(0.0, *np.where(line != 0, bounds[0], -np.inf))
    leave = min(1.0, *np.where(line != 0, bounds[1], np.inf))
    if not enter <= leave:
        return
    count = int(np.ceil(np.abs(line).max() * (leave - enter) * 4)) + 2
    places = start + np.linspace(enter, leave, count)[:, None] * line
    columns, rows = np.floor(places).astype(int).T
    fits = (columns >= 0) & (columns < cells.shape[1]) & (rows >= 0) & (rows < cells.shape[0])
    cells[rows[fits], columns[fits]] = True


def keep_out_cells(grid: MapGrid2D, areas: Iterable[Map2DArea]) -> NDArray[np.bool_]:
    """Return the mask (rows, columns) of a map's keep-out cells, and of those in keep-out areas on it."""
    kept: NDArray[np.bool_] = grid.flags == MapFlag.KEEP_OUT
    for area in areas:
        if area.map_id == grid.name:
            part, inside = cells_of(grid, area.points)
            kept[part] |= inside
    return kept


KEEP_OUT = 100  # planners must not enter
TEMPORARY_OBSTACLE = 90  # 229 in a costmap, where a wall has 254
ENLARGED_OBSTACLE = 60  # the costmap's inflation covers this area, too
_WEIGHTS = {
    MapFlag.KEEP_OUT: KEEP_OUT,
    MapFlag.TEMPORARY_OBSTACLE: TEMPORARY_OBSTACLE,
    MapFlag.ENLARGED_OBSTACLE: ENLARGED_OBSTACLE,
}


def _by_flag() -> NDArray[np.uint8]:
    table = np.zeros(256, np.uint8)
    table[list(_WEIGHTS)] = list(_WEIGHTS.values())
    return table


_TABLE = _by_flag()


def keepout_mask(grid: MapGrid2D, areas: Iterable[Map2DArea] = ()) -> NDArray[np.int8]:
    """Return the mask (height, width), from the top row down: 100 in keep-out areas and cells, elsewhere 0 to 90.

    Temporary and enlarged obstacles of the map have the weights above; all other cells have 0.
    """
    mask = lookup(grid.flags, _TABLE).view(np.int8)
    for area in areas:
        if area.map_id == grid.name:
            part, inside = cells_of(grid, area.points)
            mask[part][inside] = KEEP_OUT
    return mask


def binary_mask(keepout: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return the mask for Nav2's BinaryFilter from a keep-out mask: 100 in keep-out areas and cells, 0 elsewhere."""
    return np.where(keepout == KEEP_OUT, np.int8(KEEP_OUT), np.int8(0))


ABSOLUTE = 2  # CostmapFilterInfo's type for limits in m/s


@dataclass(frozen=True, eq=False)
class SpeedMask:
    """A speed mask, and the meaning of its values."""

    # (height, width), rows from the top down: 1 to 100, or 0 without a limit
    values: NDArray[np.int8]
    base: float  #: m/s
    multiplier: float  #: m/s per unit of a value
    type: int = ABSOLUTE  #: the type in CostmapFilterInfo


def speed_mask(info: MapGrid2DInfo, limits: Sequence[tuple[Map2DArea, float]]) -> SpeedMask:
    """Return the mask of areas with limits (m/s); the lowest applies if areas overlap.

    The lowest and the highest limit are exact; the limits between may be lower by up to a 99th of the difference,
    never higher. Areas on other maps are ignored. Raises `ValueError` for a limit that is not above 0 (0: no limit).
    """
    on_map = [(area, limit) for area, limit in limits if area.map_id == info.name]
    for area, limit in on_map:
        if not (math.isfinite(limit) and limit > 0):
            raise ValueError(f"invalid speed limit {limit} m/s of an area ({area.description!r}): it must be above 0")
    values = np.zeros((info.m_height, info.m_width), np.int8)
    low, high = min((limit for _, limit in on_map), default=1.0), max((limit for _, limit in on_map), default=1.0)
    multiplier = high / 100 if low == high else (high - low) / 99
    base = 0.0 if low == high else low - multiplier
    for area, limit in sorted(on_map, key=lambda pair: -pair[1]):
        part, inside = cells_of(info, area.points)
        values[part][inside] = min(max(math.floor((limit - base) / multiplier + 1e-6), 1), 100)
    return SpeedMask(values, base, multiplier)
