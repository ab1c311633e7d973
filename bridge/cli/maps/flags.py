"""``midspan map edit-flags``: edits the flags of a map's cells, for path planners."""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np

from bridge.cli.arguments import add_verb
from bridge.cli.maps.store import missing, named_map, open_stored
from bridge.cli.output import CliError
from bridge.client.store import StoreClient
from bridge.stores.kinds import AREA, MAP
from bridge.stores.store import Write
from bridge.text import clean
from navigation.maps.masks import cells_of
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.sig.vec2d import Vec2D

_FLAGS = {flag.name.lower().replace("_", "-"): flag for flag in MapFlag}
_CORNERS = 64  # of the polygon for a circle


def register(verbs: Any) -> None:
    parser = add_verb(
        verbs, "edit-flags", run, "flag cells of a map: keep-out, wall, free, ...",
        "Frees temporary and enlarged obstacles, then flags the cells of a shape (meters in the map's frame), then"
        " enlarges obstacles, each step if requested.",
        example="midspan map edit-flags house --flag keep-out --points 1,1 2,1 2,3 1,3",
    )  # fmt: skip
    parser.add_argument("name", nargs="?", help="name of the map (default: the one in use)")
    parser.add_argument("--flag", choices=sorted(_FLAGS), help="the new flag for the shape's cells")
    shape = parser.add_mutually_exclusive_group()
    shape.add_argument("--points", nargs="+", type=_point, metavar="X,Y", help="a polygon's corners, three or more")
    shape.add_argument("--circle", type=_circle, metavar="X,Y,RADIUS", help="a circle")
    shape.add_argument("--area", metavar="NAME", help="a stored area")
    parser.add_argument("--enlarge", type=float, metavar="METERS", help="enlarge obstacles by this distance")
    parser.add_argument("--clear-temporary", action="store_true", help="free temporary and enlarged obstacles")


def run(args: argparse.Namespace) -> int:
    """Change flags, and write the map back."""
    shaped = args.points is not None or args.circle is not None or args.area is not None
    if shaped is not (args.flag is not None):
        raise CliError("a shape (--points, --circle or --area) and a flag (--flag) go together")
    if not (shaped or args.enlarge is not None or args.clear_temporary):
        raise CliError("nothing to change: give --flag with a shape, --enlarge or --clear-temporary")
    with open_stored(args) as (_, stored):
        name, changed = "", 0

        def edited() -> list[Write[Any]]:
            nonlocal name, changed
            grid = named_map(stored, args.name)
            name, changed = grid.name, _edit(args, stored, grid)
            return [Write(MAP, name, grid)]

        stored.change(edited)
    print(f"{clean(name)}: {changed} cells changed")
    return 0


def _edit(args: argparse.Namespace, stored: StoreClient, grid: MapGrid2D) -> int:
    """Change the flags of a map as requested; return the number of changed cells."""
    before = grid.flags.copy()
    if args.clear_temporary:
        grid.clearMapTemporaryFlags()
    if args.flag is not None:
        part, inside = cells_of(grid, _corners(args, stored, grid))
        if not inside.any():
            raise CliError(f"the shape has no cell on {grid.name}")
        grid.flags[part][inside] = _FLAGS[args.flag]
    if args.enlarge is not None and not (math.isfinite(args.enlarge) and grid.enlargeObstacles(args.enlarge)):
        raise CliError(f"obstacles cannot be enlarged by {args.enlarge} m")
    return int(np.count_nonzero(before != grid.flags))


def _corners(args: argparse.Namespace, stored: StoreClient, grid: MapGrid2D) -> list[Vec2D]:
    if args.circle is not None:
        x, y, radius = args.circle
        turns = (2 * math.pi * number / _CORNERS for number in range(_CORNERS))
        return [Vec2D(x + radius * math.cos(turn), y + radius * math.sin(turn)) for turn in turns]
    if args.area is not None:
        area = stored.get(AREA, args.area)
        if area is None:
            raise CliError(missing("area", args.area, stored.names(AREA)))
        if area.map_id != grid.name:
            raise CliError(f"the area {args.area!r} is on the map {area.map_id!r}, not on {grid.name!r}")
        return list(area.points)
    if len(args.points) < 3:
        raise CliError(f"a polygon has three corners or more, not {len(args.points)}")
    return [Vec2D(x, y) for x, y in args.points]


def _numbers(text: str, count: int) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f"{text!r} is not {count} comma-separated numbers")
    return numbers


def _point(text: str) -> list[float]:
    return _numbers(text, 2)


def _circle(text: str) -> list[float]:
    numbers = _numbers(text, 3)
    if numbers[2] <= 0:
        raise argparse.ArgumentTypeError(f"a circle's radius must be above 0, not {numbers[2]:g}")
    return numbers
