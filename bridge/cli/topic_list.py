"""``midspan topic list``: all topics."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from bridge.cli.console import make_console, print_json
from bridge.cli.hubclient import add_hub_arguments, open_client
from bridge.cli.text import clean, side_name
from bridge.cli.topic_view import TopicView, all_topics


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "list",
        help="all topics of the hub and of its sides",
        description="Lists every topic that is on the hub, and those that stay on their side (private, denied or"
        " refused).",
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="with types, sides, endpoints and state")
    parser.add_argument("--json", action="store_true", help="print all that is known of each as JSON")
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """List the topics."""
    with open_client(args) as client:
        views = sorted(all_topics(client).values(), key=lambda view: view.name)
    if args.json:
        print_json([_as_json(view) for view in views])
    elif args.verbose:
        make_console().print(_table(views))
    else:
        for view in views:
            print(clean(view.name))
    return 0


def _table(views: Iterable[TopicView]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in ("topic", "type", "from"):
        table.add_column(name, overflow="fold")
    table.add_column("hub pubs", justify="right")
    table.add_column("hub subs", justify="right")
    table.add_column("state")
    for view in views:
        table.add_row(
            Text(clean(view.name), style="bold"),
            Text(clean(", ".join(sorted(view.types))), style="cyan" if len(view.types) < 2 else "red"),
            Text(", ".join(side_name(side) for side in view.sides) or "-"),
            str(len(view.publishers)),
            str(len(view.subscriptions)),
            Text(view.state.replace("unseen", "nobody publishes"), style="green" if view.state == "hub" else "yellow"),
        )
    return table


def _as_json(view: TopicView) -> dict[str, Any]:
    return {
        "topic": view.name,
        "types": sorted(view.types),
        "from": view.sides,
        "publishers": len(view.publishers),
        "subscriptions": len(view.subscriptions),
        "state": view.state,
        "decisions": [decision.as_dict() for decision in view.decisions],
    }
