"""``midspan map show``: draws a map with flags, locations and areas, or a slice of a 3D map, on the terminal or as PNG.

The drawing code loads slowly and is imported only when needed, because commands that do not draw import this file too.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.cli.arguments import add_verb
from bridge.cli.output import CliError
from bridge.text import clean

if TYPE_CHECKING:
    from yarp_compat.dev.locations import Map2DArea, Map2DLocation
    from yarp_compat.dev.mapgrid import MapGrid2D


_PLAIN_WIDTH = 120
_MAX_SCALE = 64


def register(verbs: Any) -> None:
    parser = add_verb(
        verbs, "show", run, "draw a map with its flags, locations and areas",
        "Draws a map with its flags, locations and areas: in the terminal, as plain text into a pipe, or as a PNG. An"
        " octomap is drawn as the slice at a height, with occupied, free and unknown cells.",
        example="midspan map show house --png house.png",
    )  # fmt: skip
    parser.add_argument("name", nargs="?", help="name of the map (default: the one in use)")
    parser.add_argument("--3d", dest="three", action="store_true", help="describe the 3D map of that name")
    parser.add_argument("--layer", type=float, metavar="METERS", help="draw the octomap's slice at this height")
    add_drawing_arguments(parser)


def add_drawing_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of commands that draw a map."""
    parser.add_argument("--png", type=Path, metavar="FILE", help="write a picture instead")
    parser.add_argument("--scale", type=int, default=0, metavar="PIXELS", help="pixels of a cell in the picture")
    parser.add_argument("--width", type=int, metavar="COLUMNS", help="columns in the terminal")


def run(args: argparse.Namespace) -> int:
    from bridge.cli.maps.store import named_map, open_stored
    from bridge.stores.kinds import AREA, LOCATION

    sliced = args.layer is not None
    if args.three or sliced:
        from bridge.cli.maps import map3d
    if args.three and not sliced:
        return map3d.show(args)
    with open_stored(args) as (_, stored):
        if sliced:
            grid = map3d.layer(*map3d.named_map3d(stored, args.name), args.layer)
        else:
            grid = named_map(stored, args.name)
        locations = {name: place for name, place in stored.all(LOCATION).items() if place.map_id == grid.name}
        areas = {name: area for name, area in stored.all(AREA).items() if area.map_id == grid.name}
    draw(grid, locations, areas, args)
    return 0


def draw(
    grid: MapGrid2D, locations: Mapping[str, Map2DLocation], areas: Mapping[str, Map2DArea], args: argparse.Namespace,
    path: Sequence[tuple[float, float]] = (),
) -> None:  # fmt: skip
    """Draw a map, with a line along ``path`` (meters); ``args`` has the arguments of `add_drawing_arguments`.

    Raises `CliError` if they are invalid.
    """
    if not 0 <= args.scale <= _MAX_SCALE or (args.width is not None and not 0 < args.width <= 1000):
        raise CliError(f"--scale must be from 0 to {_MAX_SCALE}, --width from 1 to 1000")
    if args.png is not None:
        from bridge.display.drawing import draw as picture

        if grid.width() * grid.height() * max(args.scale, 1) ** 2 > 1 << 28:
            raise CliError("the picture would have more than 268 million pixels; give a smaller --scale")
        picture(grid, locations, areas, args.scale, path).save(args.png, "PNG")
        print(f"{clean(grid.name)} drawn in {args.png}")
        return
    from bridge.display import drawing
    from bridge.text import make_console

    console = make_console()
    width = args.width or (console.width if console.is_terminal else _PLAIN_WIDTH)
    for line in drawing.lines(grid, locations, areas, width, colored=console.is_terminal, path=path):
        console.print(line, soft_wrap=True)
