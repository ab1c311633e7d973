"""``midspan map show``: a map with its flags, locations and areas, in the terminal or as PNG."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bridge.cli import map_terminal
from bridge.cli.console import make_console
from bridge.cli.errors import CliError
from bridge.cli.hubclient import add_hub_arguments
from bridge.cli.stored import named_map, open_stored
from bridge.cli.text import clean
from bridge.stores.kinds import AREA, LOCATION
from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D

_PLAIN_WIDTH = 120
_MOST_SCALE = 64


def register(verbs: Any) -> None:
    """Add the verb's parser."""
    parser = verbs.add_parser(
        "show",
        help="draw a map with its flags, locations and areas",
        description="Draws a map with its flags, locations and areas: in the terminal, in letters where the output is"
        " none, or as a PNG.",
        epilog="Example: midspan map show house --png house.png",
    )
    parser.add_argument("name", nargs="?", help="which map (default: the one in use)")
    add_drawing_arguments(parser)


def add_drawing_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of verbs that draw a map."""
    parser.add_argument("--png", type=Path, metavar="FILE", help="write a picture instead")
    parser.add_argument("--scale", type=int, default=0, metavar="PIXELS", help="pixels of a cell in the picture")
    parser.add_argument("--width", type=int, metavar="COLUMNS", help="columns in the terminal")
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Draw a map."""
    with open_stored(args) as (_, stored):
        grid = named_map(stored, args.name)
        locations = {name: place for name, place in stored.all(LOCATION).items() if place.map_id == grid.name}
        areas = {name: area for name, area in stored.all(AREA).items() if area.map_id == grid.name}
    draw(grid, locations, areas, args)
    return 0


def draw(
    grid: MapGrid2D,
    locations: Mapping[str, Map2DLocation],
    areas: Mapping[str, Map2DArea],
    args: argparse.Namespace,
    path: Sequence[tuple[float, float]] = (),
) -> None:
    """Draw a map as the command line says; raises `CliError` where it cannot be drawn so.

    Args:
        grid: the map.
        locations: those on it.
        areas: those on it.
        args: of `add_drawing_arguments`.
        path: places, metres, that a line joins.
    """
    if not 0 <= args.scale <= _MOST_SCALE or (args.width is not None and not 0 < args.width <= 1000):
        msg = f"--scale is 1 to {_MOST_SCALE}, --width 1 to 1000"
        raise CliError(msg)
    if args.png is not None:
        from bridge.cli.map_picture import draw as picture

        if grid.width() * grid.height() * max(args.scale, 1) ** 2 > 1 << 28:
            msg = "the picture would have more than 268 million pixels; give a smaller --scale"
            raise CliError(msg)
        picture(grid, locations, areas, args.scale, path).save(args.png, "PNG")
        print(f"{clean(grid.name)} to {args.png}")
        return
    console = make_console()
    width = args.width or (console.width if console.is_terminal else _PLAIN_WIDTH)
    for line in map_terminal.lines(grid, locations, areas, width, coloured=console.is_terminal, path=path):
        console.print(line, soft_wrap=True)
