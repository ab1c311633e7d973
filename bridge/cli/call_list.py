"""``midspan service list|info`` and ``midspan action list|info``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from bridge.cli.call_view import CallView, find
from bridge.cli.console import make_console, print_json
from bridge.cli.hubclient import Client, add_hub_arguments, open_client
from bridge.cli.text import clean, side_name
from bridge.cli.topic_info import endpoint_json, endpoint_text

Views = Callable[[Client], dict[str, CallView]]


def register_list(verbs: Any, word: str) -> None:
    """Add the parser of ``list``; ``word`` is ``service`` or ``action``."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "list",
        help=f"all {word}s of the hub and of its sides",
        description=f"Lists every {word} that is on the hub, and those that stay on their side (private, denied or"
        " refused).",
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="with types, sides, servers, clients and state")
    parser.add_argument("--json", action="store_true", help="print all that is known of each as JSON")
    add_hub_arguments(parser)


def register_info(verbs: Any, word: str) -> None:
    """Add the parser of ``info``."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "info",
        help=f"one {word}: type, servers, clients, decisions",
        description=f"Shows who serves a {word} and who uses it, and what each worker decided of it.",
    )
    parser.add_argument("name", help=f"the {word}'s name")
    parser.add_argument("--json", action="store_true", help="print it as JSON")
    add_hub_arguments(parser)


def run_list(args: argparse.Namespace, views: Views, word: str) -> int:
    """List them."""
    with open_client(args) as client:
        found = sorted(views(client).values(), key=lambda view: view.name)
    if args.json:
        print_json([view.as_dict(word) for view in found])
    elif args.verbose:
        make_console().print(_table(found, word))
    else:
        for view in found:
            print(clean(view.name))
    return 0


def run_info(args: argparse.Namespace, views: Views, word: str) -> int:
    """Show one."""
    with open_client(args) as client:
        view = find(views(client), args.name, word)
    if args.json:
        ends = {"servers": map(endpoint_json, view.servers), "clients": map(endpoint_json, view.clients)}
        print_json({**view.as_dict(word), **{name: list(found) for name, found in ends.items()}})
    else:
        _show(view, word)
    return 0


def _table(views: Iterable[CallView], word: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in (word, "type", "from"):
        table.add_column(name, overflow="fold")
    for name in ("servers", "clients"):
        table.add_column(name, justify="right")
    table.add_column("state")
    for view in views:
        table.add_row(
            Text(clean(view.name), style="bold"),
            Text(clean(", ".join(sorted(view.types))), style="cyan" if len(view.types) < 2 else "red"),
            Text(", ".join(side_name(side) for side in view.sides) or "-"),
            str(len(view.servers)),
            str(len(view.clients)),
            Text(view.state, style="green" if view.state == "hub" else "yellow"),
        )
    return table


def _show(view: CallView, word: str) -> None:
    print(f"{word}: {clean(view.name)}")
    print(f"type: {clean(', '.join(sorted(view.types)))}")
    for title, endpoints in (("servers", view.servers), ("clients", view.clients)):
        print(f"{title} on the hub: {len(endpoints)}")
        for endpoint in endpoints:
            print(f"  {endpoint_text(endpoint)}")
    if view.decisions:
        print("decisions:")
        for d in view.decisions:
            way = f"{side_name(d.worker)} -> hub" if d.direction == "in" else f"hub -> {side_name(d.worker)}"
            print(f"  {way}: {clean(d.decision)}: {clean(d.why)}")
