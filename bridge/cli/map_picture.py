"""A map as a picture: its flags' colours, how surely free cells are occupied, and the places on it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.dev.mapcolours import GREYS, picture_of_flags
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

LOCATION_COLOUR, AREA_COLOUR, PATH_COLOUR = (0, 110, 0), (0, 90, 200), (200, 0, 120)

_WANTED = 1200
"""Pixels that the longer side of a small map is drawn with."""

_ARROW = 14
_FONT = 14


def draw(
    grid: MapGrid2D,
    locations: Mapping[str, Map2DLocation],
    areas: Mapping[str, Map2DArea],
    scale: int = 0,
    path: Sequence[tuple[float, float]] = (),
) -> Image.Image:
    """The picture of a map.

    Args:
        grid: the map.
        locations: those on it, by name: an arrow that points as they do.
        areas: those on it, by name: their outline.
        scale: pixels of a cell; 0 for what makes a small map large enough.
        path: places, metres, that a line joins.
    """
    scale = scale or max(1, min(16, _WANTED // max(grid.width(), grid.height())))
    image = Image.fromarray(colours(grid)).resize(
        (grid.width() * scale, grid.height() * scale), Image.Resampling.NEAREST
    )
    pen = ImageDraw.Draw(image)
    font = ImageFont.load_default(_FONT)
    for name, area in areas.items():
        corners = [_pixel(grid, point.x, point.y, scale) for point in area.points]
        if len(corners) > 1:
            pen.line([*corners, corners[0]], fill=AREA_COLOUR, width=2)
            x, y = (sum(part) / len(corners) for part in zip(*corners, strict=True))
            pen.text((x, y), name, fill=AREA_COLOUR, font=font, anchor="mm")
    if len(path) > 1:
        pen.line([_pixel(grid, x, y, scale) for x, y in path], fill=PATH_COLOUR, width=3, joint="curve")
    for name, place in locations.items():
        x, y = _pixel(grid, place.x, place.y, scale)
        dx, dy = heading(grid, place)
        pen.ellipse((x - 4, y - 4, x + 4, y + 4), outline=LOCATION_COLOUR, width=2)
        pen.line((x, y, x + _ARROW * dx, y + _ARROW * dy), fill=LOCATION_COLOUR, width=2)
        pen.text((x + 7, y + 7), name, fill=LOCATION_COLOUR, font=font)
    return image


def colours(grid: MapGrid2D) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """A colour for each cell, of shape (height, width, 3): its flag's, or the grey of a free one's occupancy."""
    picture = picture_of_flags(grid.flags)
    doubtful = (grid.flags == MapFlag.FREE) & (grid.occupancy > 0)
    picture[doubtful] = GREYS[grid.occupancy[doubtful]][:, None]
    return picture


def heading(grid: MapGrid2D, place: Map2DLocation) -> tuple[float, float]:
    """Where a location looks on the picture: right and down, of length 1."""
    theta = math.radians(place.theta)
    ends = grid.in_cells([(place.x, place.y), (place.x + math.cos(theta), place.y + math.sin(theta))])
    dx, dy = (ends[1] - ends[0]) * grid.resolution
    return float(dx), float(dy)


def _pixel(grid: MapGrid2D, x: float, y: float, scale: int) -> tuple[float, float]:
    """A place's pixel; far outside it is somewhere far outside."""
    column, row = np.clip(grid.in_cells((x, y)) * scale, -1e6, 1e6)
    return float(column), float(row)
