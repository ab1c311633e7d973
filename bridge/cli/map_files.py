"""``midspan map import`` and ``export``: maps and places between files and the store."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from bridge.cli.errors import CliError
from bridge.cli.hubclient import add_hub_arguments
from bridge.cli.stored import named_map, open_stored
from bridge.cli.text import clean
from bridge.stores.importing import read_files
from bridge.stores.kinds import CURRENT, MAP
from bridge.stores.store import THE_MAP, Write
from yarp_compat.dev.mapcollection import save_maps


def register(verbs: Any) -> None:
    """Add the verbs' parsers."""
    come = verbs.add_parser(
        "import",
        help="bring maps and places from files into the store",
        description="Reads maps of YARP (.map) and of ROS (.yaml with its image), collections (maps_collection.ini)"
        " and files of locations, areas, paths and objects (locations.ini) with what is beside them"
        " (locations_extras.ini). All of a call comes into the store, or nothing.",
        epilog="Example: midspan map import house.yaml --use",
    )
    come.add_argument("files", nargs="+", type=Path, metavar="FILE", help="the files")
    come.add_argument("--name", help="the map's name in the store; default as the file says it")
    come.add_argument("--replace", action="store_true", help="in place of what has the same name")
    come.add_argument("--use", action="store_true", help="the first map is in use from now on")
    add_hub_arguments(come)
    go = verbs.add_parser(
        "export",
        help="write a map, or all of them, to files",
        description="Writes a map for YARP (.map, with its images beside it) or for ROS (.yaml), or all maps as YARP's"
        " collection (.ini).",
        epilog="Example: midspan map export house.yaml house --image png",
    )
    go.add_argument("file", type=Path, metavar="FILE", help="where to: .map, .yaml or .ini")
    go.add_argument("name", nargs="?", help="which map (default: the one in use)")
    go.add_argument("--image", choices=("pgm", "png", "bmp"), default="pgm", help="form of the image beside a .yaml")
    add_hub_arguments(go)


def run_import(args: argparse.Namespace) -> int:
    """Bring files into the store."""
    writes = [write for file in args.files for write in read_files(file)]
    maps = [write for write in writes if write.kind is MAP]
    if args.name is not None:
        if len(maps) != 1:
            msg = f"--name names one map, and the files have {len(maps)}"
            raise CliError(msg)
        writes[writes.index(maps[0])] = maps[0] = Write(MAP, args.name, maps[0].value)
    if args.use:
        if not maps:
            msg = "--use needs a map, and the files have none"
            raise CliError(msg)
        writes.append(Write(CURRENT, THE_MAP, maps[0].name))
    names = [(write.kind.name, write.name) for write in writes]
    twice = {key for key in names if names.count(key) > 1}
    with open_stored(args) as (_, stored):
        taken = stored.keys().intersection(names) - {(CURRENT.name, THE_MAP)} if not args.replace else set()
        if twice or taken:
            kind, name = min(twice or taken)
            where = "in the files twice" if twice else "stored already; --replace puts this one in its place"
            msg = f"{kind} {name!r} is {where}; nothing is imported"
            raise CliError(msg)
        stored.write(writes)
    for kind, name in names:
        print(f"{kind} {clean(name)}" if kind != CURRENT.name else f"{clean(maps[0].name)} is in use")
    return 0


def run_export(args: argparse.Namespace) -> int:
    """Write maps to files."""
    with open_stored(args) as (_, stored):
        if args.file.suffix.lower() == ".ini":
            if args.name is not None:
                msg = "a collection holds all maps: leave the name out, or write a .map or .yaml"
                raise CliError(msg)
            maps = stored.all(MAP)
            _save(lambda: save_maps(maps, args.file))
            print(f"{len(maps)} maps to {args.file}")
            return 0
        grid = named_map(stored, args.name)
    if args.file.suffix.lower() not in (".map", ".yaml", ".yml"):
        msg = f"{args.file} says no form: give it .map (YARP), .yaml (ROS) or .ini (a collection)"
        raise CliError(msg)
    _save(lambda: grid.save(args.file, **({} if args.file.suffix.lower() == ".map" else {"image": args.image})))
    print(f"{clean(grid.name)} to {args.file}")
    return 0


def _save(save: Any) -> None:
    try:
        save()
    except ValueError as err:
        raise CliError(str(err)) from None
