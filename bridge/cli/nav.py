"""``midspan nav``: status, stop, pause, resume, path and show of what drives the robot."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.cli import nav_show
from bridge.cli.console import print_json
from bridge.cli.decode import Types
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, add_hub_arguments, open_client
from bridge.cli.nav_feed import Latest, gateway_caller, gateway_status, place_of, place_text, state_text, told_status
from bridge.cli.text import clean, plural
from bridge.config.sections.navigation import OURS

PATH = "nav_msgs/msg/Path"
_ASK_SECONDS = 10.0
_PATH_SECONDS = 1.0
_DONE = {"stop": "stopped: no goal is under way", "pause": "paused", "resume": "resumed"}


def register(subparsers: Any) -> None:
    """Add the verb's parser, and one for each of its own verbs."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "nav",
        help="status, stop, pause, resume, path and show of what drives the robot",
        description="Looks at the planner that drives the robot, whichever that is, and holds it.",
    )
    verbs = parser.add_subparsers(dest="nav_verb", metavar="VERB", required=True)
    status = verbs.add_parser("status", help="what it does, why, and where to")
    status.add_argument("--json", action="store_true", help="print it as JSON")
    path = verbs.add_parser("path", help="the waypoints that are left")
    path.add_argument("--json", action="store_true", help="print them as JSON")
    for verb, text in (
        ("stop", "give up the goal, whoever gave it"),
        ("pause", "stand still; the client's goal stays active"),
        ("resume", "go on after a pause"),
    ):
        add_hub_arguments(verbs.add_parser(verb, help=text, epilog=f"Example: midspan nav {verb}"))
    add_hub_arguments(status)
    add_hub_arguments(path)
    nav_show.register(verbs)


def run(args: argparse.Namespace) -> int:
    """Run one of the verbs."""
    with open_client(args) as client:
        types = Types(client)
        if args.nav_verb == "status":
            return _status(client, types, args)
        if args.nav_verb == "path":
            return _path(client, types, args)
        if args.nav_verb == "show":
            told, way = told_status(client, types), waypoints(client, types)
            return nav_show.show(client, told, way, args)
        return _ask(client, types, args.nav_verb)


def _ask(client: Client, types: Types, verb: str) -> int:
    reply = gateway_caller(client, types, f"/navigation/{verb}").ask({}, _ASK_SECONDS)
    if not reply["success"]:
        raise CliError(clean(reply["message"]) or f"it cannot be done: {verb}")
    print(clean(reply["message"]) or _DONE[verb])
    return 0


def _status(client: Client, types: Types, args: argparse.Namespace) -> int:
    told, gateway = told_status(client, types), gateway_status(client)
    goal = told["goal"] if told["goal"]["header"]["frame_id"] else None
    if args.json:
        place = None if goal is None else dict(zip(("frame", "x", "y", "theta_deg"), place_of(goal), strict=True))
        shown = {key: gateway.get(key) for key in ("planner", "pending", "goals", "client", "goals_of_others")}
        print_json({"state": told["state"], "reason": told["reason"], "goal": place, **shown})
        return 0
    print(clean(state_text(told)))
    if goal is not None and gateway.get("goals"):
        who = gateway.get("client")
        print(f"goal     {clean(place_text(goal))}" + (f", of {clean(who)}" if who else ""))
        more = int(gateway["goals"]) - 1
        if more > 0:
            print(f"         and {plural(more, 'more place')} after it")
    print(f"planner  {clean(gateway.get('planner', '?'))}")
    if gateway.get("pending"):
        print(f"         {clean(gateway['pending'])} once the robot stands")
    others = gateway.get("goals_of_others")
    if others:
        print(f"         it has {plural(int(others), 'goal')} that did not come through the gateway")
    return 0


def _path(client: Client, types: Types, args: argparse.Namespace) -> int:
    way = waypoints(client, types)
    rows = [dict(zip(("frame", "x", "y", "theta_deg"), place_of(pose), strict=True)) for pose in way]
    if args.json:
        print_json(rows)
        return 0
    if not rows:
        raise CliError("no path is told: nothing is driven now, or the planner tells none")
    for number, row in enumerate(rows, 1):
        print(f"{number:>4}  {row['x']:>8.2f} {row['y']:>8.2f} m  {row['theta_deg']:>6.0f} degrees")
    return 0


def waypoints(client: Client, types: Types) -> list[dict[str, Any]]:
    """The chosen planner's path: a ``PoseStamped`` each; none where it tells no path. Raises `CliError`."""
    planner = str(gateway_status(client).get("planner", ""))
    other = client.config.navigation.others.get(planner)
    topic = other.path if other is not None and other.path else f"/planner/{planner}/path"
    client.settle()
    if planner not in OURS and not client.hub.graph.publishers(topic):
        return []
    latest = Latest(client, types, topic, PATH)
    try:
        found = latest.wait(_PATH_SECONDS)
    finally:
        latest.close()
    return [] if found is None else list(found["poses"])
