"""``midspan location export``: what is stored, as files of YARP, GeoJSON or waypoints for Nav2."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from bridge.cli.errors import CliError
from bridge.cli.hubclient import add_hub_arguments
from bridge.cli.stored import open_stored
from bridge.stores.kinds import AREA, BEHAVIOUR, LINK, LOCATION, OBJECT, PATH
from yarp_compat.dev.exports import to_geojson, to_waypoints
from yarp_compat.dev.extras import Extras, extras_file
from yarp_compat.dev.mapfile import MapFileError, write
from yarp_compat.dev.places import Places


def register(verbs: Any) -> None:
    """Add the verb's parser."""
    parser = verbs.add_parser(
        "export",
        help="write locations, areas, paths and objects to a file",
        description="Writes what is stored: .ini for YARP's map storage (all maps; behaviours and links go into a file"
        " beside it), .geojson, or .yaml: the locations as waypoints for Nav2.",
        epilog="Example: midspan location export house.geojson --map house",
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="where to: .ini, .geojson or .yaml")
    parser.add_argument("--map", metavar="NAME", help="only what is on this map; for .yaml default the one in use")
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Write what is stored."""
    form = args.file.suffix.lower()
    if form not in (".ini", ".geojson", ".yaml", ".yml") or (form == ".ini" and args.map is not None):
        msg = f"{args.file}: give it .ini (YARP, all maps), .geojson or .yaml (waypoints for Nav2)"
        raise CliError(msg)
    with open_stored(args) as (_, stored):
        places = Places(stored.all(LOCATION), stored.all(OBJECT), stored.all(AREA), stored.all(PATH))
        extras = Extras(stored.all(BEHAVIOUR), stored.all(LINK))
        map_name = args.map or (stored.current_map() if form in (".yaml", ".yml") else "")
    try:
        if form == ".ini":
            places.save(args.file)
            extras.save(extras_file(args.file))
        elif form == ".geojson":
            write(args.file, to_geojson(places, extras.behaviours, extras.links, map_name))
        else:
            chosen = {name: each for name, each in places.locations.items() if map_name in ("", each.map_id)}
            write(args.file, to_waypoints(chosen))
    except MapFileError as err:
        raise CliError(str(err)) from None
    print(f"to {args.file}" + (f" and {extras_file(args.file)}" if form == ".ini" else ""))
    return 0
