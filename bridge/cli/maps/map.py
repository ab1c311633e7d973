"""``midspan map``: list, use, show, import, export, delete and edit-flags for the maps in the store, and explore."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from rich.table import Table

from bridge.cli.arguments import add_verb, add_verbs
from bridge.cli.maps import explore, files, flags, map3d, show
from bridge.cli.maps.store import missing, open_stored
from bridge.cli.output import CliError, print_json
from bridge.stores.kinds import MAP, MAP3D
from bridge.stores.store import Write
from bridge.text import clean, make_console
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D


def register(parser: argparse.ArgumentParser) -> None:
    verbs = add_verbs(parser, "Shows and changes the maps in the store that all daemons of a deployment share.")
    listing = add_verb(verbs, "list", _list, "list the maps", "Lists the maps in the store; * marks the one in use.")
    listing.add_argument("--json", action="store_true", help="print them as JSON")
    use = add_verb(verbs, "use", _use, "choose the map that is in use", "Chooses the map in use: /map on all sides.")
    use.add_argument("name", help="the map's name")
    show.register(verbs)
    files.register_map_files(verbs)
    flags.register(verbs)
    explore.register(verbs)
    delete = add_verb(verbs, "delete", _delete, "delete a map", "Deletes a map from the store, on all machines.")
    delete.add_argument("name", help="the map's name")
    delete.add_argument("--3d", dest="three", action="store_true", help="delete the 3D map of this name")


def _list(args: argparse.Namespace) -> int:
    with open_stored(args) as (_, stored):
        maps, current = stored.all(MAP), stored.current_map()
        others = [map3d.described(name, value) for name, value in stored.all(MAP3D).items()]
    rows = [_row(name, grid, current) for name, grid in maps.items()]
    if args.json:
        rows += others
        print_json(rows)
        return 0
    for other in others:
        print(map3d.line(other))
    if not rows and others:
        return 0
    if not rows:
        print("no map is stored; 'midspan map import FILE' imports one")
        return 0
    table = Table(box=None, pad_edge=False)
    for column in ("", "map", "cells", "meters", "resolution", "origin x, y, degrees", "flags"):
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


def _use(args: argparse.Namespace) -> int:
    with open_stored(args) as (_, stored):
        stored.use_map(args.name)
    print(f"{clean(args.name)} is in use")
    return 0


def _delete(args: argparse.Namespace) -> int:
    kind = MAP3D if args.three else MAP
    with open_stored(args) as (_, stored):
        if args.name not in stored.names(kind):
            raise CliError(missing(kind.name, args.name, stored.names(kind)))
        stored.write([Write(kind, args.name, None)])
    print(f"{clean(args.name)} is deleted")
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
