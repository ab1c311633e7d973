"""Polygons as cells of a map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev.mapinfo import MapGrid2DInfo
from yarp_compat.sig.vec2d import Vec2D

Part = tuple[slice, slice]


def cells_of(info: MapGrid2DInfo, points: Sequence[Vec2D]) -> tuple[Part, NDArray[np.bool_]]:
    """The cells that a polygon touches: those whose middle is inside, and those that its border crosses.

    So even a polygon that is thinner than a cell leaves no gap.

    Args:
        info: the map.
        points: the corners, metres; fewer than three are no polygon.

    Returns:
        the part of the map (rows and columns) that it reaches over, and which cells of that part.
    """
    corners = info.in_cells(np.array([(point.x, point.y) for point in points], float).reshape(-1, 2))
    low = np.clip(np.floor(np.min(corners, axis=0, initial=np.inf)), 0, None) if len(corners) > 2 else np.zeros(2)
    high = np.max(corners, axis=0, initial=-np.inf) if len(corners) > 2 else np.full(2, -1.0)
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
    """The cells whose middle has an odd number of borders to its left."""
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
    """Mark the cells that a line crosses, by places on it a quarter of a cell apart."""
    size = np.array(cells.shape[::-1], float)
    way = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.sort(np.stack(((0 - start) / way, (size - start) / way)), axis=0)
    # where it runs along an axis, the other axis says nothing
    enter = max(0.0, *np.where(way != 0, bounds[0], -np.inf))
    leave = min(1.0, *np.where(way != 0, bounds[1], np.inf))
    if not enter <= leave:
        return
    count = int(np.ceil(np.abs(way).max() * (leave - enter) * 4)) + 2
    places = start + np.linspace(enter, leave, count)[:, None] * way
    columns, rows = np.floor(places).astype(int).T
    fits = (columns >= 0) & (columns < cells.shape[1]) & (rows >= 0) & (rows < cells.shape[0])
    cells[rows[fits], columns[fits]] = True
