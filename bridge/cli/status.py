"""``midspan status``: every daemon and worker on the hub, and every route."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from bridge.cli.console import make_console, print_json
from bridge.cli.doors import Refusal, refusals
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, add_hub_arguments, open_client
from bridge.cli.port_text import connected_lines, port_list
from bridge.cli.routes_table import Document, arrow, dicts, route_list, routes_table
from bridge.cli.text import clean, duration, is_number, plural, side_name, size
from bridge.hub.control import Answer

_STYLES = {"running": "green", "waiting": "yellow", "standby": "cyan"}


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "status",
        help="show daemons, workers and routes",
        description="Shows every daemon and worker that answers on the hub, what stands in the way of topics, and one"
        " line for each route: how much crosses, how fast, and what was dropped. Exit code 1 where nothing answers.",
    )
    parser.add_argument("--json", action="store_true", help="print the workers' status documents as JSON")
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Show the status once."""
    with open_client(args) as client:
        documents = ask_status(client)
        client.settle()
        refused = refusals(client, documents)
    if args.json:
        print_json([_with_refusals(document, refused) for document in documents])
    else:
        show(make_console(), documents, refused)
    return 0


def ask_status(client: Client) -> list[Document]:
    """The status documents of all workers; raises `CliError` where none answers."""
    answers = client.ask("status")
    if not answers:
        msg = (
            f"a router answers, but no worker of Midspan does on {client.where}.\n"
            "Is the daemon running ('midspan run'), and is this its domain (hub.domain)?"
        )
        raise CliError(msg)
    return [_document(answer) for answer in answers]


def show(console: Console, documents: Sequence[Document], refused: Sequence[Refusal] = ()) -> None:
    """One block for each worker, then the routes."""
    daemon = None
    for document in documents:
        if document.get("daemon") != daemon:
            daemon = document.get("daemon")
            console.print(Text(clean(daemon), style="bold"))
        _show_worker(console, document)
        for refusal in _of(document, refused):
            console.print(Text(f"           {clean(refusal.text)}", "yellow"))
            console.print(Text(f"             cure: {clean(refusal.cure)}"))
    console.print()
    if any(route_list(document) for document in documents):
        console.print(routes_table(documents))
    else:
        console.print("no routes: nothing is published that would cross; 'midspan topic list -v' shows what there is")


def _of(document: Document, refused: Sequence[Refusal]) -> list[Refusal]:
    """Those of a router's door."""
    return [r for r in refused if document.get("side") == "router" and document.get("daemon") == r.daemon]


def _with_refusals(document: Document, refused: Sequence[Refusal]) -> Document:
    found = [dataclasses.asdict(refusal) for refusal in _of(document, refused)]
    return {**document, "refused_commands": found} if found else document


def _document(answer: Answer) -> Document:
    if isinstance(answer.value, dict) and not answer.error:
        return {**answer.value, "daemon": answer.daemon, "worker": answer.worker}
    error = answer.error or "the answer is no status document"
    return {"daemon": answer.daemon, "worker": answer.worker, "side": answer.worker, "state": "failed", "error": error}


def _show_worker(console: Console, document: Document) -> None:
    state = clean(document.get("state", "?"))
    line = Text(f"  {clean(document.get('worker', '?')):<8} ")
    line.append(f"{state:<8}", style=_STYLES.get(state, "red"))
    line.append(f" {_figures(document)}")
    console.print(line)
    if document.get("error"):
        console.print(Text(f"           {clean(document['error'])}", style="red"))
    for refused in dicts(document.get("refused")):
        way = arrow(document.get("side"), refused.get("direction"))
        topic, type_name = clean(refused.get("topic", "")), clean(refused.get("type", ""))
        console.print(
            Text(f"           refused {way} {topic} ({type_name}): {clean(refused.get('reason', ''))}", "yellow")
        )
        if refused.get("cure"):
            console.print(Text(f"             cure: {clean(refused['cure'])}"))
    for machine in dicts(document.get("machines")):
        console.print(_machine(machine))
    for told in connected_lines(port_list(document)):
        console.print(Text(f"           {told}"))
    warnings = document.get("warnings")
    for warning in warnings if isinstance(warnings, list) else ():
        console.print(Text(f"           warning: {clean(warning)}", "yellow"))


def _machine(machine: Document) -> Text:
    """Another machine that is connected."""
    name, address = clean(machine.get("name") or "a machine without a certificate"), clean(machine.get("address", "?"))
    if machine.get("trusted"):
        return Text(f"           {name} at {address}")
    return Text(f"           {name} may not command (hub.open.trusted), at {address}", "yellow")


def _figures(document: Document) -> str:
    parts: list[str] = []
    if document.get("network"):
        parts.append(f"{side_name(document.get('side'))} network {clean(document['network'])}")
    elif document.get("state") == "waiting" and document.get("side"):  # a module waits for something else
        parts.append(f"{side_name(document.get('side'))} is away")
    if document.get("text"):
        parts.append(clean(document["text"]))
    if document.get("listen"):
        parts.append(f"listens at {clean(document['listen'])}, {_sessions(document)}")
    routes = route_list(document)
    if routes:
        rate = sum(r["rate"] for r in routes if is_number(r.get("rate")))
        parts.append(f"{plural(len(routes), 'route')}, {rate:.0f} msg/s")
    if is_number(document.get("uptime")):
        parts.append(f"up {duration(document['uptime'])}")
    if is_number(document.get("cpu")):
        parts.append(f"cpu {document['cpu'] * 100:.0f} %")
    if document.get("rss"):
        parts.append(size(document["rss"]))
    if document.get("pid"):
        parts.append(f"pid {clean(document['pid'])}")
    return ", ".join(parts)


def _sessions(document: Document) -> str:
    count = document.get("sessions")
    return plural(count if isinstance(count, int) else 0, "session")
