"""Copies maps and places between files and the store: ``map import``, ``map export`` and ``location export``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from bridge.cli.arguments import add_verb
from bridge.cli.maps.store import named_map, open_stored
from bridge.cli.output import CliError
from bridge.stores.kinds import AREA, BEHAVIOR, CURRENT, LINK, LOCATION, MAP, MAP3D, OBJECT, PATH
from bridge.stores.service import FORMS_3D, read_files
from bridge.stores.store import THE_MAP, Write
from bridge.text import clean
from yarp_compat.dev.exports import to_geojson, to_waypoints
from yarp_compat.dev.extras import Extras, extras_file
from yarp_compat.dev.mapfile import MapFileError, write
from yarp_compat.dev.places import Places, save_maps


def register_map_files(verbs: Any) -> None:
    come = add_verb(
        verbs, "import", _import_maps, "import maps and places from files into the store",
        "Reads maps of YARP (.map) and of ROS (.yaml with its image), collections (maps_collection.ini), and locations,"
        " areas, paths and objects (locations.ini) with their extras (locations_extras.ini), and maps in three"
        " dimensions: octomaps (.bt, .ot) and clouds (.pcd, .ply). Either all of them are imported, or none.",
        example="midspan map import house.yaml --use",
    )  # fmt: skip
    come.add_argument("files", nargs="+", type=Path, metavar="FILE", help="the files")
    come.add_argument("--name", help="the map's name in the store (default: that of the file)")
    come.add_argument("--replace", action="store_true", help="replace existing entries of the same name")
    come.add_argument("--use", action="store_true", help="use the first map from now on")
    go = add_verb(
        verbs, "export", _export_maps, "write a map, or all of them, to files",
        "Writes a map for YARP (.map, with its images) or for ROS (.yaml), or all maps as YARP's collection (.ini); a"
        " map in three dimensions as .bt, .ot, .pcd or .ply. A cloud written from an octomap has the centers of the"
        " occupied leaves.",
        example="midspan map export house.yaml house --image png",
    )  # fmt: skip
    go.add_argument("file", type=Path, metavar="FILE", help="a .map, .yaml, .ini, .bt, .ot, .pcd or .ply file")
    go.add_argument("name", nargs="?", help="name of the map (default: the one in use)")
    go.add_argument("--image", choices=("pgm", "png", "bmp"), default="pgm", help="format of the image of a .yaml")
    go.add_argument("--resolution", type=float, metavar="METERS", default=0.05, help="cell size for converting a cloud")


def _import_maps(args: argparse.Namespace) -> int:
    writes = [write for file in args.files for write in read_files(file)]
    if args.name is not None:
        named = [index for index, write in enumerate(writes) if write.kind in (MAP, MAP3D)]
        if len(named) != 1:
            raise CliError(f"--name names one map, but the files have {len(named)}")
        writes[named[0]] = replace(writes[named[0]], name=args.name)
    maps = [write for write in writes if write.kind is MAP]
    if args.use:
        if not maps:
            raise CliError("--use needs a map, but the files have none")
        writes.append(Write(CURRENT, THE_MAP, maps[0].name))
    names = [(write.kind.name, write.name) for write in writes]
    twice = {key for key in names if names.count(key) > 1}
    with open_stored(args) as (_, stored):
        existing = stored.keys().intersection(names) - {(CURRENT.name, THE_MAP)} if not args.replace else set()
        if twice or existing:
            kind, name = min(twice or existing)
            where = "twice in the files" if twice else "already stored; --replace replaces it"
            raise CliError(f"nothing imported: {kind} {name!r} is {where}")
        stored.write(writes)
    for kind, name in names:
        print(f"{kind} {clean(name)}" if kind != CURRENT.name else f"{clean(maps[0].name)} is in use")
    return 0


def _export_maps(args: argparse.Namespace) -> int:
    if args.file.suffix.lower() in FORMS_3D:
        from bridge.cli.maps.map3d import export

        return export(args)
    with open_stored(args) as (_, stored):
        if args.file.suffix.lower() == ".ini":
            if args.name is not None:
                raise CliError("a collection has all maps: omit the name, or write a .map or .yaml")
            maps = stored.all(MAP)
            _save(lambda: save_maps(maps, args.file))
            print(f"{len(maps)} maps exported to {args.file}")
            return 0
        grid = named_map(stored, args.name)
    if args.file.suffix.lower() not in (".map", ".yaml", ".yml"):
        raise CliError(f"{args.file} has an unknown extension: use .map (YARP), .yaml (ROS), .ini or one for 3D")
    _save(lambda: grid.save(args.file, **({} if args.file.suffix.lower() == ".map" else {"image": args.image})))
    print(f"{clean(grid.name)} exported to {args.file}")
    return 0


def _save(save: Any) -> None:
    try:
        save()
    except ValueError as err:
        raise CliError(str(err)) from None


def register_location_export(verbs: Any) -> None:
    parser = add_verb(
        verbs, "export", _export_locations, "write locations, areas, paths and objects to a file",
        "Writes .ini for YARP's map storage (all maps; behaviors and links go into a second file), .geojson, or"
        " .yaml: the locations as waypoints for Nav2.",
        example="midspan location export house.geojson --map house",
    )  # fmt: skip
    parser.add_argument("file", type=Path, metavar="FILE", help="a .ini, .geojson or .yaml file")
    parser.add_argument("--map", metavar="NAME", help="only those on this map (default for .yaml: the one in use)")


def _export_locations(args: argparse.Namespace) -> int:
    form = args.file.suffix.lower()
    if form not in (".ini", ".geojson", ".yaml", ".yml") or (form == ".ini" and args.map is not None):
        raise CliError(f"{args.file}: use the extension .ini (YARP, all maps), .geojson or .yaml (waypoints for Nav2)")
    with open_stored(args) as (_, stored):
        places = Places(stored.all(LOCATION), stored.all(OBJECT), stored.all(AREA), stored.all(PATH))
        extras = Extras(stored.all(BEHAVIOR), stored.all(LINK))
        map_name = args.map or (stored.current_map() if form in (".yaml", ".yml") else "")
    try:
        if form == ".ini":
            places.save(args.file)
            extras.save(extras_file(args.file))
        elif form == ".geojson":
            write(args.file, to_geojson(places, extras.behaviors, extras.links, map_name))
        else:
            chosen = {
                name: location for name, location in places.locations.items() if map_name in ("", location.map_id)
            }
            write(args.file, to_waypoints(chosen))
    except MapFileError as err:
        raise CliError(str(err)) from None
    print(f"exported to {args.file}" + (f" and {extras_file(args.file)}" if form == ".ini" else ""))
    return 0
