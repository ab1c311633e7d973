"""``midspan map list`` and ``use``: which maps there are, and which one is in use."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from rich.table import Table

from bridge.cli.console import make_console, print_json
from bridge.cli.hubclient import add_hub_arguments
from bridge.cli.stored import open_stored
from bridge.cli.text import clean
from bridge.stores.kinds import MAP
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D


def register(verbs: Any) -> None:
    """Add the verbs' parsers."""
    listing = verbs.add_parser(
        "list", help="list the maps", description="Lists the maps in the store; * marks the one that is in use."
    )
    listing.add_argument("--json", action="store_true", help="print them as JSON")
    add_hub_arguments(listing)
    use = verbs.add_parser(
        "use",
        help="choose the map that is in use",
        description="Chooses the map that is in use: what is published as /map, everywhere.",
    )
    use.add_argument("name", help="the map's name")
    add_hub_arguments(use)


def run_list(args: argparse.Namespace) -> int:
    """List the maps."""
    with open_stored(args) as (_, stored):
        maps, current = stored.all(MAP), stored.current_map()
    rows = [_row(name, grid, current) for name, grid in maps.items()]
    if args.json:
        print_json(rows)
        return 0
    if not rows:
        print("no map is stored; 'midspan map import FILE' brings one in")
        return 0
    table = Table(box=None, pad_edge=False)
    for column in ("", "map", "cells", "metres", "resolution", "origin x, y, degrees", "flags"):
        table.add_column(column)
    for row in rows:
        width, height = row["width"], row["height"]
        table.add_row(
            "*" if row["current"] else "",
            clean(row["name"]),
            f"{width} x {height}",
            f"{width * row['resolution']:.1f} x {height * row['resolution']:.1f}",
            f"{row['resolution']:g}",
            ", ".join(f"{part:g}" for part in row["origin"]),
            ", ".join(f"{flag} {share}" for flag, share in row["flags"].items()),
        )
    make_console().print(table)
    return 0


def run_use(args: argparse.Namespace) -> int:
    """Choose the map that is in use."""
    with open_stored(args) as (_, stored):
        stored.use_map(args.name)
    print(f"{clean(args.name)} is in use")
    return 0


def _row(name: str, grid: MapGrid2D, current: str) -> dict[str, Any]:
    counts = np.bincount(grid.flags.reshape(-1), minlength=len(MapFlag))
    return {
        "name": name,
        "current": name == current,
        "width": grid.width(),
        "height": grid.height(),
        "resolution": grid.resolution,
        "origin": list(grid.origin),
        "flags": {flag.name.lower(): int(counts[flag]) for flag in MapFlag if counts[flag]},
    }
