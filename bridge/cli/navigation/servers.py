"""``midspan dock``, ``undock`` and ``waypoints``: goals for a planner's other servers, such as Nav2's."""

from __future__ import annotations

import argparse
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bridge.cli.arguments import add_hub_arguments, seconds
from bridge.cli.client import CliClient, open_client
from bridge.cli.graph.goal import FollowedGoal, Interrupt
from bridge.cli.maps.store import store_of
from bridge.cli.navigation.gateway import check_daemon, gateway_caller, gateway_status, no_answer
from bridge.cli.navigation.goto import report_end
from bridge.cli.output import CliError, print_json
from bridge.client.errors import ClientError
from bridge.client.feed import LatestMessage
from bridge.client.goals import SUCCEEDED
from bridge.client.navigation import PATIENCE, STATUS, STATUS_TOPIC, place_goal, state_text
from bridge.client.types import Types
from bridge.module_keys import GatewayKeys
from bridge.stores.kinds import LOCATION
from bridge.text import clean
from navigation.status import has_ended
from yarp_compat.dev.docks import Dock, dock_of

DOCK, UNDOCK, WAYPOINTS = "dock_robot", "undock_robot", "follow_waypoints"
TYPES = {
    DOCK: "nav2_msgs/action/DockRobot",
    UNDOCK: "nav2_msgs/action/UndockRobot",
    WAYPOINTS: "nav2_msgs/action/FollowWaypoints",
}
_STAGING_SECONDS, _UNDOCKING_SECONDS = 1000.0, 30.0
"""The actions' own defaults."""

_SETTLING_SECONDS = 3.0
"""Time for which a goal waits until the robot is known to be idle."""

_DOCKING = (
    "",
    "driving to the staging pose",
    "detecting the dock",
    "approaching",
    "waiting for the charge",
    "retrying",
)
"""Texts for the ``state`` in the feedback, whose values begin at 1."""


def register_dock(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Docks the robot at a stored dock (a location), or at a dock of the planner's own database, with the planner's"
        " action dock_robot (Nav2's docking_server). Ctrl-C, SIGTERM and SIGHUP cancel the goal, as does every stop."
    )
    parser.epilog = "Examples: midspan location add charger 1.5 2 90 --dock; midspan dock charger; midspan dock"
    parser.add_argument("place", nargs="?", metavar="PLACE", help="the dock; default: the only one that is stored")
    parser.add_argument("--type", default="", help="the dock's type for the planner; default: the stored one")
    _add_common(parser)
    parser.set_defaults(run=run_dock)


def register_undock(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Moves the robot out of its dock with the planner's action undock_robot (Nav2's docking_server)."
    )
    parser.epilog = "Example: midspan undock"
    parser.add_argument("--type", default="", help="the dock's type; default: that of the last docking")
    _add_common(parser)
    parser.set_defaults(run=run_undock)


def register_waypoints(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Drives to locations or areas of the store in turn with the planner's action follow_waypoints (Nav2's"
        " waypoint_follower), which stops at each, may execute a task there, and continues if one cannot be reached."
        " 'midspan goto A B C' drives through them with any planner. Exit code 1 if a place was missed."
    )
    parser.epilog = "Example: midspan waypoints hall office kitchen"
    parser.add_argument("places", nargs="+", metavar="PLACE", help="names of locations or areas")
    parser.add_argument("--repeat", type=int, default=0, metavar="N", help="repeat the round N times (default 0)")
    _add_common(parser)
    parser.set_defaults(run=run_waypoints)


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--timeout", type=seconds, metavar="SECONDS", help="cancel the goal if it takes longer")
    parser.add_argument("--json", action="store_true", help="print each change, and the end, as one line of JSON")
    add_hub_arguments(parser)


def run_dock(args: argparse.Namespace) -> int:
    def goal_of(client: CliClient) -> dict[str, Any]:
        name, dock = _dock(client, args.place)
        goal = {"max_staging_time": _STAGING_SECONDS, "navigate_to_staging_pose": True}
        if dock is None:
            _announce(args, f"to the planner's own dock {clean(name)}")
            return {**goal, "use_dock_id": True, "dock_id": name, "dock_type": args.type}
        (pose,) = _poses(client, [name])
        _announce(args, f"to the dock {clean(name)}")
        return {**goal, "use_dock_id": False, "dock_pose": pose, "dock_type": args.type or dock.type}

    def step(feedback: Mapping[str, Any]) -> str:
        state = int(feedback.get("state", 0))
        return _DOCKING[state] if 0 < state < len(_DOCKING) else ""

    return _run(args, DOCK, goal_of, step, "docked")


def run_undock(args: argparse.Namespace) -> int:
    goal = {"dock_type": args.type, "max_undocking_time": _UNDOCKING_SECONDS}
    return _run(args, UNDOCK, lambda _client: goal, lambda _feedback: "", "undocked")


def run_waypoints(args: argparse.Namespace) -> int:
    if not 0 <= args.repeat < 2**32:
        raise CliError(f"--repeat must be from 0 to {2**32 - 1}, not {args.repeat}")
    places: list[str] = args.places

    def step(feedback: Mapping[str, Any]) -> str:
        at = int(feedback.get("current_waypoint", 0))
        return f"to {clean(places[at])} ({at + 1} of {len(places)})" if at < len(places) else ""

    def goal_of(client: CliClient) -> dict[str, Any]:
        return {"poses": _poses(client, places), "number_of_loops": args.repeat, "goal_index": 0}

    return _run(args, WAYPOINTS, goal_of, step, "arrived", lambda result: missed_places(result, places))


def missed_places(result: Mapping[str, Any], places: Sequence[str]) -> str:
    """Return the places that a result of ``FollowWaypoints`` names as missed, in the form of any release of Nav2."""
    entries = result.get("missed_waypoints", [])
    # nav2_msgs/MissedWaypoint, or from Kilted on nav2_msgs/WaypointStatus
    indexes = [int(entry["waypoint_index"] if "waypoint_index" in entry else entry["index"]) for entry in entries]
    return ", ".join(places[index] for index in indexes if index < len(places))


def _run(
    args: argparse.Namespace,
    name: str,
    goal_of: Callable[[CliClient], dict[str, Any]],
    step: Callable[[Mapping[str, Any]], str],
    done: str,
    missed: Callable[[Mapping[str, Any]], str] = lambda _result: "",
) -> int:
    """Send a goal to one of the planner's actions, and print each step until the goal ends; return the exit code."""
    with open_client(args) as client, Interrupt() as interrupt:
        check_daemon(client)
        action = _action(client, name)
        goal = goal_of(client)
        try:
            sent = FollowedGoal(client, action, TYPES[name], interrupt)
        except ClientError as err:
            raise CliError(
                f"{err}\nstart that server of the planner; 'midspan nav status' shows inactive ones"
            ) from None
        last = ""

        def show(feedback: Mapping[str, Any]) -> None:
            nonlocal last
            text = step(feedback)
            if text and text != last:
                last = text
                print_json({"state": text}, lines=True) if args.json else print(text, flush=True)

        end, signaled = sent.run(goal, args.timeout, show)
        skipped = missed(end.result) if end.status == SUCCEEDED else ""
        return report_end(end, signaled, done, f"not reached: {skipped}" if skipped else "", as_json=args.json)


def _action(client: CliClient, name: str) -> str:
    """Return the planner's action ``name``; raises `CliError` if a stop cannot cancel it, or the robot is not idle."""
    planner_name = gateway_status(client).other(GatewayKeys).planner
    planner = client.config.navigation.other(planner_name)
    motion = () if planner is None else planner.motion
    action = next((action for action in motion if action.endswith(f"/{name}")), "")
    if not action:
        raise CliError(
            f"the planner {clean(planner_name)} has no action {name} that a stop cancels; choose nav2, or list the"
            " action in 'motion_actions' of its entry in navigation.planners"
        )
    _wait_until_idle(client)
    return action


def _wait_until_idle(client: CliClient) -> None:
    """Wait a moment for the previous motion to end; raises `CliError` if the robot may still be moving then."""
    idle = threading.Event()

    def update(status: dict[str, Any]) -> None:
        (idle.set if has_ended(status["state"]) else idle.clear)()

    status = LatestMessage(client, Types(client), STATUS_TOPIC, STATUS, update)
    try:
        first = status.wait(PATIENCE)
        if first is None:
            raise CliError(no_answer(client))
        if not idle.wait(_SETTLING_SECONDS):
            text = clean(state_text(status.wait(0.0) or first))
            raise CliError(f"the robot is not idle ({text}): stop it first ('midspan nav stop')")
    finally:
        status.close()


def _dock(client: CliClient, name: str | None) -> tuple[str, Dock | None]:
    """Return the dock's name and its stored settings, or None for a dock of the planner's own database."""
    locations = store_of(client).all(LOCATION)
    docks = {key: dock for key, location in locations.items() if (dock := dock_of(location)) is not None}
    if name is None:
        if len(docks) != 1:
            known = f"name one of {clean(', '.join(sorted(docks)[:20]))}" if docks else "none is stored"
            raise CliError(
                f"which dock? {known}, or one of the planner's own; 'midspan location add NAME X Y DEGREES --dock'"
                " stores one"
            )
        (name,) = docks
    elif name in locations and name not in docks:
        raise CliError(
            f"the location {clean(name)} is not a dock; 'midspan location add {clean(name)} --here --dock --replace'"
            " makes it one where the docked robot stands"
        )
    return name, docks.get(name)


def _poses(client: CliClient, names: list[str]) -> list[dict[str, Any]]:
    """Return the stored places as ``PoseStamped``; raises `CliError` if a place is on another map."""
    locate = gateway_caller(client, Types(client), "get_location")
    poses = [place_goal(locate, name)["pose"] for name in names]
    frame = client.config.navigation.frame
    for name, pose in zip(names, poses, strict=True):
        if pose["header"]["frame_id"] != frame:
            raise CliError(f"{clean(name)} is on the map {clean(pose['header']['frame_id'])}, not on the one in use")
    return poses


def _announce(args: argparse.Namespace, text: str) -> None:
    if not args.json:
        print(text, flush=True)
