"""``midspan location``: lists, adds, removes and exports locations, areas, paths, objects and links."""

from __future__ import annotations

import argparse
import math
from typing import Any

from rich.table import Table

from bridge.cli.arguments import add_verb, add_verbs
from bridge.cli.frames.listener import listening
from bridge.cli.maps import files
from bridge.cli.maps.store import missing, open_stored
from bridge.cli.output import CliError, print_json
from bridge.client.session import Client
from bridge.client.store import StoreClient
from bridge.stores import kinds
from bridge.stores.entry import check_name
from bridge.stores.store import Write
from bridge.text import clean, make_console, plural
from bridge.tf.errors import TransformError
from bridge.tf.transform import angles_of
from yarp_compat.dev.docks import Dock, dock_of
from yarp_compat.dev.locations import Map2DLocation


def register(parser: argparse.ArgumentParser) -> None:
    verbs = add_verbs(
        parser,
        "Shows and changes the locations, areas, paths, objects and links in the store that all daemons of a deployment"
        " share. 'midspan map import' imports them from files.",
    )
    _register_list_and_remove(verbs)
    _register_add(verbs)
    files.register_location_export(verbs)


KINDS: dict[str, kinds.ValueKind[Any]] = {
    kind.name: kind for kind in (kinds.LOCATION, kinds.AREA, kinds.PATH, kinds.OBJECT, kinds.LINK)
}
_JSON: dict[str, Any] = {
    "location": kinds.location_json,
    "area": kinds.area_json,
    "path": kinds.path_json,
    "object": kinds.object_json,
    "link": kinds.link_json,
}


def _register_list_and_remove(verbs: Any) -> None:
    listing = add_verb(verbs, "list", _list, "list locations, areas with their behavior, paths, objects and links")
    listing.add_argument("--map", metavar="NAME", help="only those on this map")
    listing.add_argument("--kind", choices=sorted(KINDS), help="only those of this kind")
    listing.add_argument("--json", action="store_true", help="print them as JSON")
    remove = add_verb(verbs, "remove", _remove, "remove a location, or an entry of another kind")
    remove.add_argument("name", help="the entry's name")
    remove.add_argument(
        "--kind", choices=sorted(KINDS), default="location", help="the entry's kind (default: location)"
    )


def _list(args: argparse.Namespace) -> int:
    with open_stored(args) as (_, stored):
        rows = [row for row in _rows(stored, args.kind) if args.map is None or args.map in row["maps"]]
    if args.json:
        print_json(rows)
        return 0
    if not rows:
        chosen = f"no {args.kind or 'entry'} is stored" + ("" if args.map is None else f" on the map {clean(args.map)}")
        print(f"{chosen}; 'midspan location add' adds a location, 'midspan map import' imports files")
        return 0
    table = Table(box=None, pad_edge=False)
    for column in ("kind", "name", "map", "where", "", "description"):
        table.add_column(column, overflow="fold")
    for row in rows:
        value = row["value"]
        table.add_row(
            row["kind"],
            clean(row["name"]),
            clean(", ".join(row["maps"])),
            clean(_where(row["kind"], value)),
            _behavior(row),
            clean(value.get("description", "")),
        )
    make_console().print(table)
    return 0


def _remove(args: argparse.Namespace) -> int:
    with open_stored(args) as (_, stored):
        names = stored.names(KINDS[args.kind])
        if args.name not in names:
            raise CliError(missing(args.kind, args.name, names))
        stored.write([Write(KINDS[args.kind], args.name, None)])
    print(f"removed {args.kind} {clean(args.name)}")
    return 0


def _rows(stored: StoreClient, only: str | None) -> list[dict[str, Any]]:
    rows = []
    locations = stored.all(kinds.LOCATION) if only in (None, "location", "link") else {}
    behaviors = stored.all(kinds.BEHAVIOR) if only in (None, "area") else {}
    for name, kind in KINDS.items():
        if only not in (None, name):
            continue
        for key, value in (locations if kind is kinds.LOCATION else stored.all(kind)).items():
            entry = dict(_JSON[name](value))
            row: dict[str, Any] = {"kind": name, "name": key, "maps": _maps(name, entry, locations), "value": entry}
            if isinstance(value, Map2DLocation) and (dock := dock_of(value)) is not None:
                row["dock"] = {"type": dock.type}
            if name == "area" and key in behaviors:
                row["behaviour"] = dict(kinds.behavior_json(behaviors[key]))
            rows.append(row)
    return rows


def _maps(kind: str, value: dict[str, Any], locations: dict[str, Any]) -> list[str]:
    if kind == "path":
        return sorted({point["map"] for point in value["waypoints"]})
    if kind == "link":
        return [locations[end].map_id for end in (value["from"], value["to"]) if end in locations]
    return [value["map"]]


def _where(kind: str, value: dict[str, Any]) -> str:
    if kind == "location":
        return f"{value['x']:g}, {value['y']:g} m, {value['theta_deg']:g} degrees"
    if kind == "object":
        return f"{value['x']:g}, {value['y']:g}, {value['z']:g} m"
    if kind == "area":
        return plural(len(value["points"]), "corner")
    if kind == "path":
        return plural(len(value["waypoints"]), "waypoint")
    return f"{value['from']} to {value['to']}, cost {value['cost']:g}"


def _behavior(row: dict[str, Any]) -> str:
    if "dock" in row:
        return clean(f"dock {row['dock']['type']}".strip())
    behavior = row.get("behaviour")
    if behavior is None:
        return ""
    parts = [] if behavior["max_speed"] is None else [f"up to {behavior['max_speed']:g} m/s"]
    if behavior["on_obstacle"]:
        parts.append(f"obstacle: {behavior['on_obstacle']}")
    if behavior["keep_out"]:
        parts.append("keep out")
    return ", ".join(parts)


PATIENCE = 5.0
"""Seconds to wait for the robot's pose."""

_OLD = 2.0
"""Maximum age of the robot's pose in seconds."""


def _register_add(verbs: Any) -> None:
    parser = add_verb(
        verbs, "add", _add, "store a location",
        "Stores a location: a pose in meters and degrees, or the robot's current pose from /tf.",
        example="midspan location add kitchen 1.5 2 90; midspan location add dock --here",
    )  # fmt: skip
    parser.add_argument("name", help="the location's name")
    parser.add_argument("pose", nargs="*", type=float, metavar="X Y [DEGREES]", help="the location's pose")
    parser.add_argument("--here", action="store_true", help="the robot's pose: its base in the map's frame, from /tf")
    parser.add_argument("--map", metavar="NAME", help="the location's map (default: the map in use)")
    parser.add_argument("--description", default="", help="a description for people")
    parser.add_argument(
        "--dock", nargs="?", const="", metavar="TYPE", help="mark it as a dock of this type, for 'midspan dock'"
    )
    parser.add_argument("--replace", action="store_true", help="replace an existing location of this name")
    for option, whose, key in (("--map-frame", "map", "frame"), ("--base-frame", "robot", "base_frame")):
        parser.add_argument(
            option, metavar="FRAME", help=f"the {whose}'s frame, for --here (default: navigation.{key})"
        )


def _add(args: argparse.Namespace) -> int:
    check_name(args.name)
    if args.here is bool(args.pose) or len(args.pose) not in (0, 2, 3):
        raise CliError("give X Y [DEGREES], or --here")
    description: str = args.description
    if args.dock is not None:
        try:
            description = " ".join(filter(None, (description, Dock(args.dock).to_text())))
        except ValueError as err:
            raise CliError(str(err)) from None
    with open_stored(args) as (client, stored):
        map_name = args.map or stored.current_map()
        if not map_name:
            raise CliError("no map is in use: name one with --map, or choose one with 'midspan map use NAME'")
        if not args.replace and args.name in stored.names(kinds.LOCATION):
            raise CliError(f"location {args.name!r} already exists; --replace replaces it")
        x, y, theta = _pose_here(client, args) if args.here else (*args.pose, 0.0)[:3]
        place = Map2DLocation(map_name, x, y, theta, description)
        stored.write([Write(kinds.LOCATION, args.name, place)])
    print(f"{clean(args.name)}: {x:.3f}, {y:.3f} m, {theta:.1f} degrees on {clean(map_name)}")
    return 0


def _pose_here(client: Client, args: argparse.Namespace) -> tuple[float, float, float]:
    navigation = client.config.navigation
    return robot_pose(client, args.map_frame or navigation.frame, args.base_frame or navigation.base_frame)


def robot_pose(client: Client, map_frame: str, base_frame: str) -> tuple[float, float, float]:
    """Return the robot's pose in meters and degrees; raises `CliError` if it is unknown or too old."""
    try:
        with listening(client) as transforms:
            transforms.wait()
            pose = transforms.buffer.lookup_transform(map_frame, base_frame, timeout=PATIENCE)
    except TransformError as err:
        raise CliError(f"the robot's pose is unknown: {clean(err).strip()}") from None
    age = (transforms.clock.now_ns() - pose.stamp) / 1e9 if pose.stamp else 0.0
    if age > _OLD:
        raise CliError(f"the robot's pose was last published {age:.1f} s ago; is its localizer running?")
    return pose.translation[0], pose.translation[1], math.degrees(angles_of(pose.rotation)[2])
