"""``list`` and ``info`` for topics, services and actions."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from bridge.cli.arguments import add_verb
from bridge.cli.client import open_client
from bridge.cli.output import print_json
from bridge.client.graph import GraphView, Kind, Views, endpoint_json, endpoint_text, find
from bridge.client.session import Client
from bridge.text import clean, make_console, side_name

_INFO = (
    "show type, servers, clients and decisions",
    "Shows the servers and clients of a service or action, and each worker's decision on it.",
)
_TOPIC_INFO = (
    "show types, publishers, subscriptions and QoS",
    "Shows a topic's types, and its publishers and subscriptions on the hub with their QoS and side.",
)


def register(verbs: Any, kind: Kind, views: Callable[[Client], Views]) -> None:
    """Add the commands ``list`` and ``info``; ``views`` returns all topics, services or actions."""
    is_topic = kind == "topic"
    listing = add_verb(
        verbs, "list", lambda args: _list(args, views, kind), f"list all {kind}s of the hub and of its sides",
        f"Lists every {kind} on the hub, and those that stay on their side (private, denied or refused).",
    )  # fmt: skip
    ends = "endpoints" if is_topic else "servers, clients"
    listing.add_argument("-v", "--verbose", action="store_true", help=f"add types, sides, {ends} and state")
    listing.add_argument("--json", action="store_true", help="print everything that is known about each as JSON")
    info = add_verb(verbs, "info", lambda args: _info(args, views, kind), *(_TOPIC_INFO if is_topic else _INFO))
    info.add_argument("name", metavar="topic" if is_topic else None, help=f"the {kind}'s name")
    info.add_argument("--json", action="store_true", help="print the information as JSON")


def _list(args: argparse.Namespace, views: Callable[[Client], Views], kind: Kind) -> int:
    with open_client(args, watches=True) as client:
        topics = sorted(views(client).values(), key=lambda view: view.name)
    if args.json:
        print_json([view.as_dict() for view in topics])
    elif args.verbose:
        make_console().print(_table(topics, kind))
    else:
        for view in topics:
            print(clean(view.name))
    return 0


def _info(args: argparse.Namespace, views: Callable[[Client], Views], kind: Kind) -> int:
    with open_client(args, watches=True) as client:
        view = find(views(client), args.name, kind)
    if args.json:
        print_json(_as_json(view))
        return 0
    print(f"{kind}: {clean(view.name)}")
    print(f"type: {clean(', '.join(sorted(view.types)))}")
    for role, endpoints in view.ends.items():
        print(f"{role} on the hub: {len(endpoints)}")
        for endpoint in endpoints:
            print(f"  {endpoint_text(endpoint)}")
    if view.decisions:
        print("decisions:")
        for decision in view.decisions:
            print(f"  {decision}")
    return 0


def _as_json(view: GraphView) -> dict[str, Any]:
    document = view.as_dict() | {role: [endpoint_json(e) for e in ends] for role, ends in view.ends.items()}
    left_out = ("from", "state") if view.kind == "topic" else ()
    return {name: value for name, value in document.items() if name not in left_out}


def _table(views: Iterable[GraphView], kind: Kind) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in (kind, "type", "from"):
        table.add_column(name, overflow="fold")
    for name in ("hub pubs", "hub subs") if kind == "topic" else ("servers", "clients"):
        table.add_column(name, justify="right")
    table.add_column("state")
    for view in views:
        state = view.state.replace("unseen", "not published") if kind == "topic" else view.state
        table.add_row(
            Text(clean(view.name), style="bold"),
            Text(clean(", ".join(sorted(view.types))), style="cyan" if len(view.types) < 2 else "red"),
            Text(", ".join(side_name(side) for side in view.sides) or "-"),
            str(len(view.providers)),
            str(len(view.users)),
            Text(state, style="green" if state == "hub" else "yellow"),
        )
    return table
