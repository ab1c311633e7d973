"""A map as a picture or as lines for a terminal: its flags, the occupancy of free cells, and the places on it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from rich.style import Style
from rich.text import Text

from bridge.text import clean
from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.dev.mapflag import GRAYS, picture_of_flags
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

LOCATION_COLOR, AREA_COLOR, PATH_COLOR = (0, 110, 0), (0, 90, 200), (200, 0, 120)

_WANTED = 1200
"""Maximum pixels of the longer side of a picture that is enlarged; a larger map has one pixel per cell."""

_ARROW = 14  # length of a location's arrow, pixels
_FONT = 14  # size of texts, pixels


def draw(
    grid: MapGrid2D, locations: Mapping[str, Map2DLocation], areas: Mapping[str, Map2DArea], scale: int = 0,
    path: Sequence[tuple[float, float]] = (),
) -> Image.Image:  # fmt: skip
    """Return the picture of a map, with locations as arrows and areas as outlines.

    ``scale`` is in pixels per cell, 0 to fit the size of the map; ``path`` is positions in meters, joined by a line.
    """
    scale = scale or max(1, min(16, _WANTED // max(grid.width(), grid.height())))
    size = grid.width() * scale, grid.height() * scale
    image = Image.fromarray(colors(grid)).resize(size, Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(image)
    font = ImageFont.load_default(_FONT)
    for name, area in areas.items():
        corners = [_pixel(grid, point.x, point.y, scale) for point in area.points]
        if len(corners) > 1:
            pen.line([*corners, corners[0]], fill=AREA_COLOR, width=2)
            x, y = (sum(part) / len(corners) for part in zip(*corners, strict=True))
            pen.text((x, y), name, fill=AREA_COLOR, font=font, anchor="mm")
    if len(path) > 1:
        pen.line([_pixel(grid, x, y, scale) for x, y in path], fill=PATH_COLOR, width=3, joint="curve")
    for name, location in locations.items():
        x, y = _pixel(grid, location.x, location.y, scale)
        dx, dy = heading(grid, location)
        pen.ellipse((x - 4, y - 4, x + 4, y + 4), outline=LOCATION_COLOR, width=2)
        pen.line((x, y, x + _ARROW * dx, y + _ARROW * dy), fill=LOCATION_COLOR, width=2)
        pen.text((x + 7, y + 7), name, fill=LOCATION_COLOR, font=font)
    return image


def colors(grid: MapGrid2D) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Return the color of each cell, (height, width, 3): of its flag, or a gray for the occupancy of a free cell."""
    picture = picture_of_flags(grid.flags)
    doubtful = (grid.flags == MapFlag.FREE) & (grid.occupancy > 0)
    picture[doubtful] = GRAYS[grid.occupancy[doubtful]][:, None]
    return picture


def heading(grid: MapGrid2D, location: Map2DLocation) -> tuple[float, float]:
    """Return the direction of a location on the picture: right and down, of length 1."""
    theta = math.radians(location.theta)
    ends = grid.in_cells([(location.x, location.y), (location.x + math.cos(theta), location.y + math.sin(theta))])
    dx, dy = (ends[1] - ends[0]) * grid.resolution
    return float(dx), float(dy)


def _pixel(grid: MapGrid2D, x: float, y: float, scale: int) -> tuple[float, float]:
    """Return the pixel of a position, clipped to a million pixels from the corner."""
    column, row = np.clip(grid.in_cells((x, y)) * scale, -1e6, 1e6)
    return float(column), float(row)


_RANK = {
    MapFlag.UNKNOWN: 0,
    MapFlag.FREE: 1,
    MapFlag.ENLARGED_OBSTACLE: 2,
    MapFlag.TEMPORARY_OBSTACLE: 3,
    MapFlag.KEEP_OUT: 4,
    MapFlag.WALL: 5,
}
"""If one dot stands for several cells, the highest rank is shown, so that thin walls are not lost."""

_LETTERS = {
    MapFlag.UNKNOWN: "?",
    MapFlag.FREE: " ",
    MapFlag.ENLARGED_OBSTACLE: "+",
    MapFlag.TEMPORARY_OBSTACLE: "t",
    MapFlag.KEEP_OUT: "x",
    MapFlag.WALL: "#",
}
_ARROWS = "→↗↑↖←↙↓↘"
_MARKS = "abcdefghijklmnopqrstuvwxyz"


def lines(
    grid: MapGrid2D, locations: Mapping[str, Map2DLocation], areas: Mapping[str, Map2DArea], width: int, *,
    colored: bool, path: Sequence[tuple[float, float]] = (),
) -> list[Text]:  # fmt: skip
    """Return the map as lines of at most ``width`` columns, with a legend of the marks.

    With ``colored``, it is drawn in half blocks, else with a letter for each flag; ``path`` is positions in meters.
    """
    step = max(1, math.ceil(grid.width() / width))
    shown = _reduced(grid, step)
    chosen: NDArray[np.uint8] = colors(grid).reshape(grid.width() * grid.height(), 3)[shown]
    marks = _area_marks(grid, areas, step) | _line_marks(grid, path, step, "o", PATH_COLOR)
    marks |= _location_marks(grid, locations, step)
    rows = []
    for row in range(0, shown.shape[0], 2):
        line = Text()
        for column in range(shown.shape[1]):
            mark = marks.get((row // 2, column))
            flags = [grid.flags.reshape(-1)[shown[at, column]] for at in range(row, min(row + 2, shown.shape[0]))]
            if colored:
                dots = [chosen[at, column] for at in range(row, min(row + 2, shown.shape[0]))]
                line.append_text(_dots(dots, mark))
            else:
                flag = max((MapFlag(int(value)) for value in flags), key=_RANK.__getitem__)
                line.append(mark[0] if mark else _LETTERS[flag])
        rows.append(line if colored else Text(line.plain.rstrip()))
    return [*rows, *_legend(grid, locations, areas, colored=colored)]


def _reduced(grid: MapGrid2D, step: int) -> NDArray[np.intp]:
    """Return the cell, as a flat index, that each dot of ``step`` by ``step`` cells shows."""
    height, width = math.ceil(grid.height() / step), math.ceil(grid.width() / step)
    table = np.array([_RANK[flag] for flag in MapFlag], np.int8)
    rank = np.full((height * step, width * step), -1, np.int8)
    rank[: grid.height(), : grid.width()] = table[grid.flags]
    blocks = rank.reshape(height, step, width, step).swapaxes(1, 2).reshape(height, width, step * step)
    rows, columns = np.divmod(blocks.argmax(axis=2), step)
    rows = rows + np.arange(height)[:, None] * step
    columns = columns + np.arange(width)[None, :] * step
    indexes: NDArray[np.intp] = rows * grid.width() + columns
    return indexes


def _dots(dots: list[NDArray[np.uint8]], mark: tuple[str, tuple[int, int, int]] | None) -> Text:
    upper, lower = dots[0], dots[-1]
    if mark is not None:
        return Text(mark[0], Style(color=_rgb(mark[1]), bgcolor=_rgb(upper), bold=True))
    return Text("▀", Style(color=_rgb(upper), bgcolor=_rgb(lower) if len(dots) > 1 else None))


def _rgb(color: object) -> str:
    red, green, blue = (int(part) for part in color)  # type: ignore[attr-defined]
    return f"rgb({red},{green},{blue})"


Marks = dict[tuple[int, int], tuple[str, tuple[int, int, int]]]


def _location_marks(grid: MapGrid2D, locations: Mapping[str, Map2DLocation], step: int) -> Marks:
    marks: Marks = {}
    for number, location in enumerate(locations.values()):
        column, row = np.clip(grid.in_cells((location.x, location.y)) / step, -1e6, 1e6)
        right, down = heading(grid, location)
        arrow = _ARROWS[round(math.atan2(-down, right) / (math.pi / 4)) % 8]
        at = (int(row // 2), int(column))
        marks[at] = (arrow, LOCATION_COLOR)
        marks[at[0], at[1] + 1] = (_MARKS[number % len(_MARKS)], LOCATION_COLOR)
    return marks


def _area_marks(grid: MapGrid2D, areas: Mapping[str, Map2DArea], step: int) -> Marks:
    marks: Marks = {}
    for area in areas.values():
        corners = [(point.x, point.y) for point in area.points]
        marks |= _line_marks(grid, [*corners, *corners[:1]], step, "·", AREA_COLOR)
    return marks


def _line_marks(
    grid: MapGrid2D, points: Sequence[tuple[float, float]], step: int, sign: str, color: tuple[int, int, int]
) -> Marks:
    marks: Marks = {}
    size = np.array([grid.width(), grid.height()]) / step
    corners = grid.in_cells(list(points) or np.zeros((0, 2))) / step
    for start, end in pairwise(corners):
        # at most as many dots as the map can show, however far away a corner is
        count = int(min(2 * np.abs(end - start).max() + 2, 4 * size.sum()))
        for column, row in start + np.linspace(0, 1, count)[:, None] * (end - start):
            if 0 <= column < size[0] and 0 <= row < size[1]:
                marks[int(row // 2), int(column)] = (sign, color)
    return marks


def _legend(
    grid: MapGrid2D, locations: Mapping[str, Map2DLocation], areas: Mapping[str, Map2DArea], *, colored: bool
) -> list[Text]:
    present = [flag for flag in MapFlag if (grid.flags == flag).any()]
    names = [flag.name.lower().replace("_", " ") for flag in present]
    entries = [] if colored else [Text(", ".join(f"'{_LETTERS[f]}' {w}" for f, w in zip(present, names, strict=True)))]
    for number, (name, location) in enumerate(locations.items()):
        mark = _MARKS[number % len(_MARKS)]
        entries.append(Text(f"{mark} {clean(name)}: {location.x:g}, {location.y:g} m, {location.theta:g} degrees"))
    entries += [Text(f"· {clean(name)}: area of {len(area.points)} corners") for name, area in areas.items()]
    return entries
