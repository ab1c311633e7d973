"""``midspan status`` and ``midspan top``: every daemon, worker and route on the hub, once or live."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import sys
import time
from collections.abc import Container, Sequence

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from bridge.cli.arguments import add_hub_arguments, number_in
from bridge.cli.client import CliClient, client_config, config_file, of_this_machine, open_client
from bridge.cli.inspection.refusals import Refusal, refusals
from bridge.cli.output import CliError, print_json
from bridge.client.errors import ClientError
from bridge.client.status import Document, ask_status, dicts, port_list, route_list, texts
from bridge.daemon.query import Phase
from bridge.display.documents import connected_lines, routes_table
from bridge.doctor.causes import cause, grouped, one_line, shared
from bridge.doctor.daemon_state import ABSENT, DaemonState, Life, absent, daemon_state, with_silent
from bridge.text import arrow, clean, duration, is_number, make_console, plural, side_name, size

_STYLES = {"running": "green", "waiting": "yellow", "standby": "cyan", "starting": "yellow", "queued": "yellow"}
DAEMON = "daemon"
_ENABLED = {*ABSENT, Phase.UP.value, Phase.STOPPING.value}


def register_status(parser: argparse.ArgumentParser) -> None:
    """Describe the verb and its arguments."""
    parser.description = (
        "Shows every daemon and worker on the hub, this machine's workers that start or cannot work, what blocks"
        " topics, and for each route what crosses, how fast, and what was dropped. Exit code 1 if the hub cannot be"
        " joined, if nothing answers, and if this machine's daemon does not run although its router does."
    )
    parser.add_argument("--json", action="store_true", help="print the workers' status documents as JSON")
    add_hub_arguments(parser)
    parser.set_defaults(run=run_status)


def run_status(args: argparse.Namespace) -> int:
    """Show the status once; a running daemon's workers also if the hub cannot be joined."""
    documents, refused = list[Document](), list[Refusal]()
    state = daemon_state(client_config(args), file=config_file(args)) if of_this_machine(args) else DaemonState("")
    silent = absent(state.document, looping=True)
    unreachable: ClientError | None = None
    joined = False
    try:
        with open_client(args, warn=False) as client:
            joined = True
            documents = _ask_status(client)
            client.settle()
            refused = refusals(client, documents)
    except ClientError as err:
        if state.life is not Life.RUNNING:
            raise
        silent = absent(state.document, _ENABLED, looping=True)
        unreachable = None if joined else err
    if state.life is Life.UNKNOWN and of_this_machine(args):
        state = daemon_state(client_config(args), documents, config_file(args))
    documents = [*with_silent(documents, silent), *of_daemon(state)]
    documents.sort(key=lambda document: (str(document["daemon"]), document["worker"] != DAEMON))
    if args.json:
        print_json([_with_refusals(document, refused) for document in documents])
    else:
        show(make_console(), documents, refused)
    if state.trouble:
        raise CliError(f"{state.trouble}\n{state.cure}")
    if unreachable is not None:
        raise unreachable
    return 0


def _ask_status(client: CliClient) -> list[Document]:
    try:
        return ask_status(client)
    except ClientError as err:
        state = client.daemon()
        if state.life is not Life.RUNNING:
            raise
        hint = f"The daemon {state.name} is running (process {state.pid}): 'midspan status' lists its workers."
        raise CliError(f"{str(err).partition(chr(10))[0]}\n{hint}") from None


def of_daemon(state: DaemonState) -> list[Document]:
    """Return an entry for a daemon that does not run or does not answer, in the form of a worker's document."""
    if not state.trouble:
        return []
    text = f"{state.trouble}: {state.cure}"
    return [{"daemon": state.name, "worker": DAEMON, "state": state.life.value, "text": text, "pid": state.pid}]


def show(console: Console, documents: Sequence[Document], refused: Sequence[Refusal] = ()) -> None:
    """Print a block for each daemon with its workers, then the routes."""
    for daemon in dict.fromkeys(str(document.get("daemon")) for document in documents):
        console.print(Text(clean(daemon), style="bold"))
        workers = [document for document in documents if str(document.get("daemon")) == daemon]
        common = shared({str(document.get("worker")): texts(document.get("warnings")) for document in workers})
        for document in workers:
            _show_worker(console, document, common)
            for refusal in _refusals_of(document, refused):
                console.print(Text(f"           {clean(refusal.text)}", "yellow"))
                console.print(Text(f"             cure: {clean(refusal.cure)}"))
        for warning, names in common.values():
            console.print(Text(f"  warning of {clean(', '.join(names))}: {clean(warning)}", "yellow"))
    console.print()
    if any(route_list(document) for document in documents):
        console.print(routes_table(documents))
    else:
        console.print("no routes: nothing is published that would cross; 'midspan topic list -v' shows what there is")


def _refusals_of(document: Document, refused: Sequence[Refusal]) -> list[Refusal]:
    """Return the refusals of a router's external listener."""
    return [r for r in refused if document.get("side") == "router" and document.get("daemon") == r.daemon]


def _with_refusals(document: Document, refused: Sequence[Refusal]) -> Document:
    found = [dataclasses.asdict(refusal) for refusal in _refusals_of(document, refused)]
    return {**document, "refused_commands": found} if found else document


def _show_worker(console: Console, document: Document, elsewhere: Container[str]) -> None:
    """Print a worker, without the warnings whose causes are in ``elsewhere``."""
    state = clean(document.get("state", "?"))
    line = Text(f"  {clean(document.get('worker', '?')):<8} ")
    line.append(f"{state:<8}", style=_STYLES.get(state, "red"))
    line.append(f" {_figures(document)}")
    console.print(line)
    if document.get("error"):
        console.print(Text(f"           {clean(document['error'])}", style="red"))
    for text, cure in _refused(document):
        console.print(Text(f"           {clean(text)}", "yellow"))
        if cure:
            console.print(Text(f"             cure: {clean(cure)}"))
    for endpoint in dicts(document.get("endpoints")):
        for line in _endpoint(endpoint):
            console.print(line)
    for machine in dicts(document.get("machines")):
        console.print(_machine(machine))
    for connected in connected_lines(port_list(document)):
        console.print(Text(f"           {connected}"))
    lane = document.get("lane")
    if isinstance(lane, dict) and lane.get("why"):
        console.print(Text(f"           no lane from it, small messages go over zenoh: {clean(lane['why'])}", "yellow"))
    for warning in grouped(text for text in texts(document.get("warnings")) if cause(text) not in elsewhere):
        console.print(Text(f"           warning: {clean(warning)}", "yellow"))


def _refused(document: Document) -> list[tuple[str, str]]:
    """What a worker refused, as one line for each cause and cure."""
    groups: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for entry in dicts(document.get("refused")):
        way = arrow(document.get("side"), entry.get("direction"))
        topic, type_name, reason, cure = (str(entry.get(key, "")) for key in ("topic", "type", "reason", "cure"))
        text = f"refused {way} {topic} ({type_name}): {reason}"
        groups.setdefault((cause(text), cause(cure)), []).append((text, cure))
    return [(one_line([text for text, _ in group]), group[0][1]) for group in groups.values()]


def _endpoint(endpoint: Document) -> list[Text]:
    """Return the lines of one endpoint of hub.open: its state, and the cure if other machines cannot join by it."""
    way, place, state = (clean(endpoint.get(key, "?")) for key in ("way", "endpoint", "state"))
    since = endpoint.get("since")
    age = f" for {duration(max(time.time() - since, 0.0))}" if is_number(since) else ""
    machine = f" to {clean(endpoint['machine'])}" if state == "connected" and endpoint.get("machine") else ""
    reason = f": {clean(endpoint['reason'])}" if endpoint.get("reason") else ""
    good = state in ("connected", "connecting", "listening")
    lines = [Text(f"           hub.open.{way} {place} {state}{machine}{age}{reason}", "" if good else "yellow")]
    if endpoint.get("cure"):
        lines.append(Text(f"             cure: {clean(endpoint['cure'])}"))
    return lines


def _machine(machine: Document) -> Text:
    name, address = clean(machine.get("name") or "a machine without a certificate"), clean(machine.get("address", "?"))
    if machine.get("trusted"):
        return Text(f"           {name} at {address}")
    return Text(f"           {name} may not command (hub.open.trusted), at {address}", "yellow")


def _figures(document: Document) -> str:
    parts: list[str] = []
    if document.get("network"):
        parts.append(f"{side_name(document.get('side'))} network {clean(document['network'])}")
    elif document.get("state") == "waiting" and document.get("side"):  # a module waits for something else
        parts.append(f"{side_name(document.get('side'))} is unavailable")
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


_INTERVAL = 1.0


def register_top(parser: argparse.ArgumentParser) -> None:
    """Describe the verb and its arguments."""
    parser.description = (
        "Shows every route of every worker on the hub until Ctrl-C: messages a second, latency (from the source's time"
        " stamp to the worker that delivers; between machines as good as their clocks agree), messages, drops by"
        " reason, age of the last message. Without a terminal it prints the table once, or every --interval seconds."
    )
    parser.add_argument("--once", action="store_true", help="print the table once and end")
    parser.add_argument(
        "--interval", type=number_in(0.1, 3600), metavar="SECONDS", help=f"how often to look (default {_INTERVAL:g})"
    )
    parser.add_argument("--json", action="store_true", help="print all status documents, one JSON list a line")
    add_hub_arguments(parser)
    parser.set_defaults(run=run_top)


def run_top(args: argparse.Namespace) -> int:
    """Show the table until Ctrl-C, or once."""
    live = sys.stdout.isatty()
    once = args.once or (args.interval is None and not live)
    interval = args.interval or _INTERVAL
    with open_client(args) as client, contextlib.suppress(KeyboardInterrupt):
        if live and not once and not args.json:
            _live(client, interval)
        else:
            _plain(client, 0.0 if once else interval, as_json=args.json)
    return 0


def _plain(client: CliClient, interval: float, *, as_json: bool) -> None:
    console = make_console()
    while True:
        documents = _ask_status(client)
        if as_json:
            print_json(documents, lines=True)
        else:
            console.print(_view(documents))
        if not interval:
            return
        time.sleep(interval)


def _live(client: CliClient, interval: float) -> None:
    console = make_console()
    with Live(console=console, screen=True, auto_refresh=False, vertical_overflow="crop") as live:
        while True:
            try:
                view = _view(_ask_status(client))
            except ClientError as err:
                # the daemon may come back
                view = Text(str(err), style="red")
            live.update(view, refresh=True)
            time.sleep(interval)


def _view(documents: Sequence[Document]) -> RenderableType:
    head = Text()
    for number, document in enumerate(documents):
        head.append("   " if number else "")
        head.append(f"{clean(document.get('daemon', ''))}/{clean(document.get('worker', ''))} ", style="bold")
        state = clean(document.get("state", "?"))
        head.append(state, style="green" if state == "running" else "yellow")
        routes = route_list(document)
        if routes:
            head.append(f" {plural(len(routes), 'route')}")
        if refused := texts(document.get("refused")):
            head.append(f", {len(refused)} refused", style="yellow")
    return Group(head, routes_table(documents, errors=False))
