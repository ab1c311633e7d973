"""``midspan halt``: stops every base and cancels every goal."""

from __future__ import annotations

import argparse

from bridge.cli.arguments import add_hub_arguments, span
from bridge.cli.client import client_config, open_client, warn_of_daemon, warn_of_refusals
from bridge.cli.output import CliError, print_json
from bridge.client.halt import DEFAULT_SECONDS, GoalCancellation, halt
from bridge.client.types import Types
from bridge.text import clean, plural


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Publishes zero on every velocity topic on the hub (the rules decide which sides it reaches), clears the"
        " commands of each BaseControl and the goals of the gateway and Midspan's planners, and cancels every goal of"
        " every action. It is not an emergency stop: later commands are executed. Exit code 1 if something did not"
        " answer, or if it is not confirmed that the robot stands still."
    )
    parser.epilog = "Example: midspan halt"
    parser.add_argument(
        "--seconds",
        type=span,
        default=DEFAULT_SECONDS,
        help=f"repeat zero for this long (default {DEFAULT_SECONDS:g})",
    )
    parser.add_argument("--json", action="store_true", help="print what was halted as JSON")
    add_hub_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Halt everything; return 1 if something did not answer."""
    with open_client(args, warn=False, config=client_config(args, partly=True)) as client:
        client.settle()
        result = halt(client, Types(client), args.seconds)
        refused = warn_of_refusals(client, result.published)
        warn_of_daemon(args, client.config, workers=False)  # last, because a daemon that hangs delays it by a second
    if args.json:
        errors = {cancel.name: cancel.error for cancel in result.failed}
        errors |= {base: reason for base, reason in result.bases.items() if reason}
        errors |= {"navigation": result.trouble} if result.trouble else {}
        goals = {cancel.name: cancel.found for cancel in result.cancels}
        stands = {base: not reason for base, reason in result.bases.items()}
        print_json({"topics": result.topics, "goals": goals, "bases": stands, "errors": errors})
    else:
        _print_result(result.topics, result.cancels, result.bases)
    if result.trouble:
        raise CliError(result.trouble)
    if not (result.topics or result.cancels or result.bases):
        raise CliError("nothing to halt: the hub has no velocity topic, no action and no BaseControl")
    return 1 if result.failed or any(result.bases.values()) or refused else 0


def _print_result(topics: dict[str, int], cancels: list[GoalCancellation], bases: dict[str, str]) -> None:
    for topic, subscribers in topics.items():
        print(f"{clean(topic)}: zero velocity, {plural(subscribers, 'subscriber')} on the hub")
    for base, reason in bases.items():
        print(f"{clean(base)}: {clean(reason) or 'stands still'}")
    for cancel in cancels:
        text = f"not canceled: {clean(cancel.error)}" if cancel.error else f"{plural(cancel.found, 'goal')} canceled"
        print(f"{clean(cancel.name)}: {text}")
