"""``midspan nav show``: the map with the robot, its goal and its path, in the terminal or as PNG."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from bridge.cli import map_show
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client
from bridge.cli.location_add import robot_pose
from bridge.cli.nav_feed import place_of, state_text
from bridge.cli.stored import named_map
from bridge.cli.text import clean
from bridge.stores.client import StoreClient
from bridge.stores.wire import prefix
from yarp_compat.dev.locations import Map2DLocation


def register(verbs: Any) -> None:
    """Add the verb's parser."""
    parser = verbs.add_parser(
        "show",
        help="draw the map with the robot, its goal and its path",
        description="Draws the map in use with the robot, its goal and its path: in the terminal, in letters where the"
        " output is none, or as a PNG.",
        epilog="Example: midspan nav show --png way.png",
    )
    map_show.add_drawing_arguments(parser)


def show(client: Client, told: dict[str, Any], way: list[dict[str, Any]], args: argparse.Namespace) -> int:
    """Draw it.

    Args:
        client: the session.
        told: the newest ``NavigationStatus``.
        way: the path, a ``PoseStamped`` each.
        args: of the command line.
    """
    navigation = client.config.navigation
    stored = StoreClient(client.hub.keyspace(prefix(client.config.hub.domain)), client.config.name)
    grid = named_map(stored, None)
    places: dict[str, Map2DLocation] = {}
    frame, x, y, theta = place_of(told["goal"])
    if frame in (navigation.frame, grid.name):
        places["goal"] = Map2DLocation(grid.name, round(x, 2), round(y, 2), round(theta))
    try:
        x, y, theta = robot_pose(client, navigation.frame, navigation.base_frame)
    except CliError as err:
        print(f"# {err}", file=sys.stderr)
    else:
        places["robot"] = Map2DLocation(grid.name, round(x, 2), round(y, 2), round(theta))
    line = [(x, y) for _, x, y, _ in map(place_of, way)]
    if line and "robot" in places:
        line.insert(0, (places["robot"].x, places["robot"].y))
    map_show.draw(grid, places, {}, args, path=line)
    if args.png is None:
        print(clean(state_text(told)))
    return 0
