"""``midspan nav``: status, stop, pause, resume, path, show and the lifecycle of the planner in use."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from bridge.cli.arguments import add_verb, add_verbs
from bridge.cli.client import CliClient, client_config, open_client
from bridge.cli.maps.show import add_drawing_arguments, draw
from bridge.cli.navigation.gateway import gateway_caller, gateway_status, planner_away, published_status
from bridge.cli.navigation.lifecycle import add_lifecycle_verbs
from bridge.cli.output import CliError, print_json
from bridge.client.errors import ClientError
from bridge.client.halt import actions, stop
from bridge.client.navigation import ANSWER_SECONDS, Navigation, place_of, place_text, state_text
from bridge.client.types import Types
from bridge.config.sections.navigation import ACTION
from bridge.module_keys import GatewayKeys
from bridge.text import clean, plural

_ZERO_SECONDS = 1.0  # for which zero velocity is published
_DONE = {"stop": "stopped: no goal is active", "pause": "paused", "resume": "resumed"}


def register(parser: argparse.ArgumentParser) -> None:
    verbs = add_verbs(parser, "Shows and controls the planner that drives the robot.", dest="nav_verb")
    for verb, text in (
        ("status", "show the planner's state, its reason and the goal"),
        ("path", "show the remaining waypoints"),
        ("stop", "cancel the goal, whichever client sent it"),
        ("pause", "stand still; the client's goal stays active"),
        ("resume", "continue after a pause"),
    ):
        added = add_verb(verbs, verb, run, text, example=f"midspan nav {verb}")
        if verb in ("status", "path"):
            added.add_argument("--json", action="store_true", help="print JSON")
    add_lifecycle_verbs(verbs)
    show = add_verb(
        verbs, "show", run, "draw the map with the robot, its goal and its path",
        "Draws the map in use with the robot, its goal and its path: in the terminal, as plain text into a pipe, or as"
        " a PNG.",
        example="midspan nav show --png way.png",
    )  # fmt: skip
    add_drawing_arguments(show)


def run(args: argparse.Namespace) -> int:
    config = client_config(args, partly=args.nav_verb in ("stop", "pause", "status"))
    with open_client(args, warn=args.nav_verb != "stop", config=config) as client:
        types = Types(client)
        if args.nav_verb == "status":
            return _status(client, types, args)
        if args.nav_verb == "path":
            return _path(client, types, args)
        if args.nav_verb == "show":
            status, path = published_status(client, types), _waypoints(client, types)
            return _draw(client, status, path, args)
        return _ask(client, types, args.nav_verb)


def _ask(client: CliClient, types: Types, verb: str) -> int:
    try:
        reply = gateway_caller(client, types, verb).ask({}, ANSWER_SECONDS)
    except ClientError as err:
        if verb != "stop":
            raise
        return _stop_without_gateway(client, types, str(err))
    if not reply["success"]:
        raise CliError(clean(reply["message"]) or f"the gateway refused the command: {verb}")
    print(clean(reply["message"]) or _DONE[verb])
    return 0


def _stop_without_gateway(client: CliClient, types: Types, why: str) -> int:
    """Stop the base and cancel the planner's goals without the gateway; raises `CliError` if that is impossible."""
    planner = client.config.navigation.planner
    action = client.config.navigation.at(planner)
    if not planner:
        raise CliError(why)
    client.settle()
    stopped = stop(client, types, [action] if action in actions(client) else [], _ZERO_SECONDS)
    unsure = f"\n{clean(stopped.trouble)}" if stopped.trouble else ""
    if not stopped.cancels:
        raise CliError(f"{why}\nNor is the planner {planner} on the hub: the robot may still be moving{unsure}")
    (cancel,) = stopped.cancels
    if cancel.error:
        text = f"{planner} did not accept the stop ({clean(cancel.error)}): the robot may still be moving"
        raise CliError(f"{why}\n{text}{unsure}")
    if unsure:
        raise CliError(f"{why}{unsure}")
    print(f"the gateway is not running; {planner} itself was asked: {plural(cancel.found, 'goal')} canceled")
    return 0


def _status(client: CliClient, types: Types, args: argparse.Namespace) -> int:
    status, document = published_status(client, types), gateway_status(client)
    away, gateway = planner_away(client, document), document.other(GatewayKeys)
    goal = status["goal"] if status["goal"]["header"]["frame_id"] else None
    if args.json:
        place = None if goal is None else dict(zip(("frame", "x", "y", "theta_deg"), place_of(goal), strict=True))
        shown = {
            key: getattr(gateway, key)
            for key in ("planner", "pending", "goals", "client", "goals_of_others", "served_by")
        }
        waits = {"waits": "" if away is None else away.text, "cure": "" if away is None else away.cure}
        print_json(
            {
                "state": status["state"],
                "reason": status["reason"],
                "error_code": status["error_code"],
                "goal": place,
                **shown,
                **waits,
            }
        )
        return 0
    print(clean(state_text(status)))
    if goal is not None and gateway.goals:
        print(f"goal     {clean(place_text(goal))}" + (f", of {clean(gateway.client)}" if gateway.client else ""))
        if gateway.goals > 1:
            print(f"         and {plural(gateway.goals - 1, 'more place')} after it")
    print(f"planner  {clean(gateway.planner or '?')}")
    if away is not None:
        print(f"         {clean(away.text)}" + (f"\n         cure: {clean(away.cure)}" if away.cure else ""))
    if gateway.pending:
        print(f"         {clean(gateway.pending)} once the robot stands")
    if gateway.goals_of_others:
        print(f"         it has {plural(gateway.goals_of_others, 'goal')} from clients that bypass the gateway")
    if gateway.served_by:
        print(f"action   {ACTION} is served by {clean(gateway.served_by)}, not by the gateway")
    return 0


def _path(client: CliClient, types: Types, args: argparse.Namespace) -> int:
    path = _waypoints(client, types)
    rows = [dict(zip(("frame", "x", "y", "theta_deg"), place_of(pose), strict=True)) for pose in path]
    if args.json:
        print_json(rows)
        return 0
    if not rows:
        raise CliError("no path: the robot has no goal now, or the planner publishes none")
    for number, row in enumerate(rows, 1):
        print(f"{number:>4}  {row['x']:>8.2f} {row['y']:>8.2f} m  {row['theta_deg']:>6.0f} degrees")
    return 0


def _waypoints(client: CliClient, types: Types) -> list[dict[str, Any]]:
    """Return the path of the planner in use as ``PoseStamped``; raises `CliError` without a gateway."""
    return Navigation(client, types).path(gateway_status(client).other(GatewayKeys).planner)


def _draw(client: CliClient, status: dict[str, Any], path: list[dict[str, Any]], args: argparse.Namespace) -> int:
    """Draw the map, given the newest ``NavigationStatus`` and the path as ``PoseStamped``."""
    # the other commands of navigation need no maps
    from bridge.cli.maps.location import robot_pose
    from bridge.cli.maps.store import named_map, store_of
    from yarp_compat.dev.locations import Map2DLocation

    navigation = client.config.navigation
    grid = named_map(store_of(client), None)
    places: dict[str, Map2DLocation] = {}
    frame, x, y, theta = place_of(status["goal"])
    if frame in (navigation.frame, grid.name):
        places["goal"] = Map2DLocation(grid.name, round(x, 2), round(y, 2), round(theta))
    try:
        x, y, theta = robot_pose(client, navigation.frame, navigation.base_frame)
    except ClientError as err:
        print(f"# {err}", file=sys.stderr)
    else:
        places["robot"] = Map2DLocation(grid.name, round(x, 2), round(y, 2), round(theta))
    line = [(x, y) for _, x, y, _ in map(place_of, path)]
    if line and "robot" in places:
        line.insert(0, (places["robot"].x, places["robot"].y))
    draw(grid, places, {}, args, path=line)
    if args.png is None:
        print(clean(state_text(status)))
    return 0
