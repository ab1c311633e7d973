"""``midspan top``: the live table of all routes."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.live import Live
from rich.text import Text

from bridge.cli.console import make_console, print_json
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, add_hub_arguments, open_client
from bridge.cli.routes_table import Document, route_list, routes_table
from bridge.cli.status import ask_status
from bridge.cli.text import clean, plural

_INTERVAL = 1.0


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "top",
        help="live table of all routes",
        description="Shows every route of every worker on the hub and keeps the table up to date until Ctrl-C:"
        " messages a second, latency (time from the source's time stamp to the worker that delivers; between machines"
        " it holds as well as their clocks agree), messages, drops by reason, age of the last message. Without a"
        " terminal the table is printed once, or every --interval seconds where that is given.",
    )
    parser.add_argument("--once", action="store_true", help="print the table once and end")
    parser.add_argument(
        "--interval", type=_seconds, metavar="SECONDS", help=f"how often to look (default {_INTERVAL:g})"
    )
    parser.add_argument("--json", action="store_true", help="print all status documents, one JSON list a line")
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Show the table until Ctrl-C, or once."""
    live = sys.stdout.isatty()
    once = args.once or (args.interval is None and not live)
    interval = args.interval or _INTERVAL
    with open_client(args) as client:
        try:
            if live and not once and not args.json:
                _live(client, interval)
            else:
                _plain(client, 0.0 if once else interval, as_json=args.json)
        except KeyboardInterrupt:
            return 0
    return 0


def _plain(client: Client, interval: float, *, as_json: bool) -> None:
    console = make_console()
    while True:
        documents = ask_status(client)
        if as_json:
            print_json(documents, lines=True)
        else:
            console.print(_view(documents))
        if not interval:
            return
        time.sleep(interval)


def _live(client: Client, interval: float) -> None:
    console = make_console()
    with Live(console=console, screen=True, auto_refresh=False, vertical_overflow="crop") as live:
        while True:
            try:
                view = _view(ask_status(client))
            except CliError as err:
                # the daemon may come back
                view = Text(str(err), style="red")
            live.update(view, refresh=True)
            time.sleep(interval)


def _view(documents: Sequence[Document]) -> RenderableType:
    head = Text()
    for number, document in enumerate(documents):
        head.append("   " if number else "")
        head.append(f"{clean(document.get('daemon', ''))}/{clean(document.get('worker', ''))} ", style="bold")
        head.append(
            clean(document.get("state", "?")), style="green" if document.get("state") == "running" else "yellow"
        )
        routes = route_list(document)
        if routes:
            head.append(f" {plural(len(routes), 'route')}")
        refused = document.get("refused")
        if isinstance(refused, list) and refused:
            head.append(f", {len(refused)} refused", style="yellow")
    return Group(head, routes_table(documents, errors=False))


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.1 <= value <= 3600:
        msg = f"{text} is not between 0.1 and 3600 seconds"
        raise argparse.ArgumentTypeError(msg)
    return value
