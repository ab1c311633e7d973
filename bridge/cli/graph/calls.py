"""``midspan service`` and ``midspan action``: list, info, call and send, whichever side they are served on."""

from __future__ import annotations

import argparse
import re
import shlex
from typing import Any

from bridge.cli.arguments import add_verb, add_verbs, seconds
from bridge.cli.client import open_client
from bridge.cli.graph import listing
from bridge.cli.graph.goal import FollowedGoal, Interrupt
from bridge.cli.messages import message_text, yaml_fields
from bridge.cli.output import CliError, print_json
from bridge.client.goals import STATES, SUCCEEDED
from bridge.client.graph import absolute, all_actions, all_services
from bridge.client.services import ServiceCaller
from bridge.client.types import Types, ros2_spelling

_TYPE = re.compile(r"[A-Za-z]\w*(?:/\w+){1,2}", re.ASCII)
_VALUES = re.compile(r"[{\[]|\w+:")


def type_and_values(words: list[str]) -> tuple[str, str]:
    """Split ``[TYPE] [VALUES]`` into type ("" if missing) and text of the values; raises `CliError` for other words."""
    has_type = bool(words) and _TYPE.fullmatch(words[0]) is not None
    values = words[1:] if has_type else words
    if len(values) > 1:
        if not has_type and (_TYPE.fullmatch(words[1]) or not _VALUES.match(words[0])):
            raise CliError(f"{words[0]!r} is not a type: it should look like std_srvs/SetBool or std_srvs/srv/SetBool")
        quoted = shlex.quote(" ".join(values))
        raise CliError(f"too many words: expected NAME [TYPE] [VALUES]; quote the values: {quoted}")
    return (words[0] if has_type else ""), (values[0] if values else "{}")


def register_service(parser: argparse.ArgumentParser) -> None:
    verbs = add_verbs(parser, "Lists and calls the services of all sides.")
    listing.register(verbs, "service", all_services)
    call = add_verb(
        verbs, "call", _call, "call a service",
        "Calls a service once and prints its reply. Checks the request against its type; missing fields are zero or"
        " empty. Waits 5 s for a server. Exit code 1 if the call failed.",
        example="midspan service call /static_map --timeout 10",
    )  # fmt: skip
    call.add_argument("name", help="the service's name")
    call.add_argument("request", nargs="*", metavar="[TYPE] REQUEST", help="the fields as YAML or JSON: '{data: true}'")
    call.add_argument("--timeout", type=seconds, metavar="SECONDS", help="time limit of the call (default: none)")
    call.add_argument("--full", action="store_true", help="print long arrays and texts in full")
    call.add_argument("--json", action="store_true", help="print the reply as JSON")


def _call(args: argparse.Namespace) -> int:
    type_name, values = type_and_values(args.request)
    request = yaml_fields(values)
    with open_client(args) as client:
        caller = ServiceCaller(client, Types(client), absolute(args.name), ros2_spelling(type_name, "srv"))
        reply = caller.ask(request, args.timeout)
    if args.json:
        print_json(reply)
    else:
        print(message_text(reply, full=args.full) if reply else "done", end="" if reply else "\n")
    return 0


def register_action(parser: argparse.ArgumentParser) -> None:
    verbs = add_verbs(parser, "Lists the actions of all sides and sends goals to them.")
    listing.register(verbs, "action", all_actions)
    goal = add_verb(
        verbs, "send", _send, "send a goal",
        "Sends a goal, shows its feedback, and waits for its result. Ctrl-C cancels the goal and waits until it has"
        " ended; press it again to exit at once. SIGTERM and SIGHUP cancel it too. Exit code 0 if the goal succeeded,"
        " 130, 143 or 129 after these signals, else 1.",
        example="midspan action send /move_base"
        " '{pose: {header: {frame_id: map}, pose: {position: {x: 1.0}, orientation: {w: 1.0}}}}'",
    )  # fmt: skip
    goal.add_argument("name", help="the action's name")
    goal.add_argument("goal", nargs="*", metavar="[TYPE] GOAL", help="the fields as YAML or JSON: '{order: 5}'")
    goal.add_argument(
        "--timeout", type=seconds, metavar="SECONDS", help="cancel the goal after this time (default: never)"
    )
    goal.add_argument("--no-feedback", action="store_true", help="show only the result")
    goal.add_argument("--full", action="store_true", help="print long arrays and texts in full")
    goal.add_argument(
        "--json", action="store_true", help="print JSON, one object per line: each feedback message, then the result"
    )


def _send(args: argparse.Namespace) -> int:
    type_name, values = type_and_values(args.goal)
    goal = yaml_fields(values)
    with open_client(args) as client, Interrupt() as interrupt:
        sent = FollowedGoal(client, absolute(args.name), ros2_spelling(type_name, "action"), interrupt)
        end, code = sent.run(goal, args.timeout, lambda feedback: _show_feedback(feedback, args))
    state = STATES.get(end.status, "unknown")
    if args.json:
        print_json({"status": state, "result": end.result}, lines=True)
    else:
        result = message_text(end.result, full=args.full) if end.result else ""
        print(f"{state}\n{result}", end="")
    return code or (0 if end.status == SUCCEEDED else 1)


def _show_feedback(feedback: dict[str, Any], args: argparse.Namespace) -> None:
    if args.no_feedback:
        return
    if args.json:
        print_json({"feedback": feedback}, lines=True)
    else:
        print(f"feedback:\n{message_text(feedback, full=args.full)}---", flush=True)
