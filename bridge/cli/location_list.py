"""``midspan location list`` and ``remove``."""

from __future__ import annotations

import argparse
from typing import Any

from rich.table import Table

from bridge.cli.console import make_console, print_json
from bridge.cli.errors import CliError
from bridge.cli.hubclient import add_hub_arguments
from bridge.cli.stored import missing, open_stored
from bridge.cli.text import clean, plural
from bridge.stores.client import StoreClient
from bridge.stores.kinds import AREA, BEHAVIOUR, LINK, LOCATION, OBJECT, PATH, Kind
from bridge.stores.places import area_json, behaviour_json, link_json, location_json, object_json, path_json
from bridge.stores.store import Write

KINDS: dict[str, Kind[Any]] = {kind.name: kind for kind in (LOCATION, AREA, PATH, OBJECT, LINK)}
_JSON: dict[str, Any] = {
    "location": location_json,
    "area": area_json,
    "path": path_json,
    "object": object_json,
    "link": link_json,
}


def register(verbs: Any) -> None:
    """Add the verbs' parsers."""
    listing = verbs.add_parser(
        "list",
        help="list locations, areas, paths, objects and links",
        description="Lists what is stored, with an area's behaviour.",
    )
    listing.add_argument("--map", metavar="NAME", help="only what is on this map")
    listing.add_argument("--kind", choices=sorted(KINDS), help="only these")
    listing.add_argument("--json", action="store_true", help="print them as JSON")
    add_hub_arguments(listing)
    remove = verbs.add_parser("remove", help="remove a location", description="Removes a location, or another kind.")
    remove.add_argument("name", help="its name")
    remove.add_argument("--kind", choices=sorted(KINDS), default="location", help="what it is (default: location)")
    add_hub_arguments(remove)


def run_list(args: argparse.Namespace) -> int:
    """List what is stored."""
    with open_stored(args) as (_, stored):
        rows = [row for row in _rows(stored, args.kind) if args.map is None or args.map in row["maps"]]
    if args.json:
        print_json(rows)
        return 0
    if not rows:
        print("nothing is stored; 'midspan location add' adds one, 'midspan map import' brings them in from a file")
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
            _behaviour(row.get("behaviour")),
            clean(value.get("description", "")),
        )
    make_console().print(table)
    return 0


def run_remove(args: argparse.Namespace) -> int:
    """Remove one."""
    with open_stored(args) as (_, stored):
        names = stored.names(KINDS[args.kind])
        if args.name not in names:
            raise CliError(missing(args.kind, args.name, names))
        stored.write([Write(KINDS[args.kind], args.name, None)])
    print(f"{args.kind} {clean(args.name)} is removed")
    return 0


def _rows(stored: StoreClient, only: str | None) -> list[dict[str, Any]]:
    rows = []
    locations = stored.all(LOCATION) if only in (None, "location", "link") else {}
    behaviours = stored.all(BEHAVIOUR) if only in (None, "area") else {}
    for name, kind in KINDS.items():
        if only not in (None, name):
            continue
        for each, value in (locations if kind is LOCATION else stored.all(kind)).items():
            told = dict(_JSON[name](value))
            row: dict[str, Any] = {"kind": name, "name": each, "maps": _maps(name, told, locations), "value": told}
            if name == "area" and each in behaviours:
                row["behaviour"] = dict(behaviour_json(behaviours[each]))
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


def _behaviour(found: dict[str, Any] | None) -> str:
    if found is None:
        return ""
    words = [] if found["max_speed"] is None else [f"up to {found['max_speed']:g} m/s"]
    if found["on_obstacle"]:
        words.append(f"obstacle: {found['on_obstacle']}")
    if found["keep_out"]:
        words.append("keep out")
    return ", ".join(words)
