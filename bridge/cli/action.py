"""``midspan action``: list, info and send on any action, whichever side it is served on."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.cli.action_send import send
from bridge.cli.call_list import register_info, register_list, run_info, run_list
from bridge.cli.call_view import all_actions
from bridge.cli.hubclient import add_hub_arguments


def register(subparsers: Any) -> None:
    """Add the verb's parser, and one for each of its own verbs."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "action",
        help="list, info and send on any side's actions",
        description="Looks at actions and sends goals to them, whichever side they are served on.",
    )
    verbs = parser.add_subparsers(dest="action_verb", metavar="VERB", required=True)
    register_list(verbs, "action")
    register_info(verbs, "action")
    goal: argparse.ArgumentParser = verbs.add_parser(
        "send",
        help="send a goal",
        description="Sends a goal, shows the feedback as it comes, and waits for the result. Ctrl-C cancels the goal"
        " and waits for its end; a second one does not wait. Exit code 0 where the goal succeeded, 1 where it did not.",
        epilog="Example: midspan action send /move_base"
        " '{pose: {header: {frame_id: map}, pose: {position: {x: 1.0}, orientation: {w: 1.0}}}}'",
    )
    goal.add_argument("name", help="the action's name")
    goal.add_argument(
        "goal", nargs="*", metavar="[TYPE] GOAL", help="the fields as YAML or JSON, for example '{order: 5}'"
    )
    goal.add_argument("--timeout", type=float, metavar="SECONDS", help="cancel the goal after so long (default: never)")
    goal.add_argument("--no-feedback", action="store_true", help="show the result alone")
    goal.add_argument("--full", action="store_true", help="print long arrays and texts whole")
    goal.add_argument("--json", action="store_true", help="print one JSON object a line: each feedback, then the end")
    add_hub_arguments(goal)


def run(args: argparse.Namespace) -> int:
    """Run one of the action verbs."""
    if args.action_verb == "list":
        return run_list(args, all_actions, "action")
    if args.action_verb == "info":
        return run_info(args, all_actions, "action")
    return send(args)
