"""``midspan location add``: a pose that is given, or the one where the robot is."""

from __future__ import annotations

import argparse
import math
from typing import Any

from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, add_hub_arguments
from bridge.cli.stored import open_stored
from bridge.cli.text import clean
from bridge.cli.tf_echo import angles_of
from bridge.cli.tf_feed import Heard
from bridge.stores.kinds import LOCATION
from bridge.stores.names import check_name
from bridge.stores.store import Write
from bridge.tf.errors import TransformError
from yarp_compat.dev.locations import Map2DLocation

PATIENCE = 5.0
"""Seconds within which it is to be told where the robot is."""

_OLD = 2.0
"""Seconds; where the robot was then is not where it is."""


def register(verbs: Any) -> None:
    """Add the verb's parser."""
    parser = verbs.add_parser(
        "add",
        help="store a location",
        description="Stores a location: a pose in metres and degrees, or the robot's own by /tf.",
        epilog="Examples: midspan location add kitchen 1.5 2 90; midspan location add dock --here",
    )
    parser.add_argument("name", help="its name")
    parser.add_argument("pose", nargs="*", type=float, metavar="X Y [DEGREES]", help="where it is")
    parser.add_argument("--here", action="store_true", help="where the robot is: its base in the map's frame, by /tf")
    parser.add_argument("--map", metavar="NAME", help="on which map (default: the one in use)")
    parser.add_argument("--description", default="", help="for people")
    parser.add_argument("--replace", action="store_true", help="in place of one of the same name")
    parser.add_argument("--map-frame", default="map", metavar="FRAME", help="the map's frame, for --here")
    parser.add_argument("--base-frame", default="base_link", metavar="FRAME", help="the robot's frame, for --here")
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Store a location."""
    check_name(args.name)
    if args.here is bool(args.pose) or len(args.pose) not in (0, 2, 3):
        msg = "give X Y [DEGREES], or --here"
        raise CliError(msg)
    with open_stored(args) as (client, stored):
        map_name = args.map or stored.current_map()
        if not map_name:
            msg = "no map is in use: name one with --map, or choose one with 'midspan map use NAME'"
            raise CliError(msg)
        if not args.replace and args.name in stored.names(LOCATION):
            msg = f"location {args.name!r} is there already; --replace puts this one in its place"
            raise CliError(msg)
        x, y, theta = robot_pose(client, args.map_frame, args.base_frame) if args.here else (*args.pose, 0.0)[:3]
        place = Map2DLocation(map_name, x, y, theta, args.description)
        stored.write([Write(LOCATION, args.name, place)])
    print(f"{clean(args.name)}: {x:.3f}, {y:.3f} m, {theta:.1f} degrees on {clean(map_name)}")
    return 0


def robot_pose(client: Client, map_frame: str, base_frame: str) -> tuple[float, float, float]:
    """Where the robot is, metres and degrees; raises `CliError` where that is not known now."""
    heard = Heard(client)
    try:
        heard.open()
        heard.wait()
        found = heard.buffer.lookup_transform(map_frame, base_frame, timeout=PATIENCE)
    except TransformError as err:
        msg = f"where the robot is cannot be told: {clean(err).strip()}"
        raise CliError(msg) from None
    finally:
        heard.close()
    age = (heard.clock.now_ns() - found.stamp) / 1e9 if found.stamp else 0.0
    if age > _OLD:
        msg = f"where the robot is was told last {age:.1f} s ago; does its localisation run?"
        raise CliError(msg)
    return found.translation[0], found.translation[1], math.degrees(angles_of(found.rotation)[2])
