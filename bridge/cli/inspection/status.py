"""``midspan status`` and ``midspan top``: every daemon, worker and route on the hub, once or live."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import sys
import time
from collections.abc import Container, Sequence
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from bridge.cli.arguments import add_hub_arguments, number_in
from bridge.cli.client import CliClient, client_config, config_file, of_this_machine, open_client
from bridge.cli.output import CliError, print_json
from bridge.client.errors import ClientError
from bridge.client.refusals import Refusal, refusals
from bridge.client.status import ask_status
from bridge.display.documents import connected_lines, routes_table, skipped_lines
from bridge.doctor.causes import cause, grouped, one_line, shared
from bridge.doctor.daemon_state import (
    ENABLED,
    RELOAD_CURE,
    DaemonState,
    Life,
    absent,
    daemon_state,
    restarted,
    unanswered,
    with_restarts,
    with_silent,
    without_node,
)
from bridge.hub.graph.releases import NativeNodes, native_nodes
from bridge.status import EndpointStatus, MachineStatus, RouterStatus, StatusDocument, WorkerStatus, refused_routes
from bridge.text import arrow, clean, duration, listed, make_console, plural, side_name, size

_STYLES = {"running": "green", "waiting": "yellow", "standby": "cyan", "starting": "yellow", "queued": "yellow"}
DAEMON = "daemon"


def register_status(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Shows every daemon and worker on the hub, this machine's workers that are starting or cannot work, what blocks"
        " topics, and for each route the number, rate and drops of its messages. The exit code is 1 if the hub cannot"
        " be joined, if nothing answers, or if this machine's router runs without its daemon."
    )
    parser.add_argument("--json", action="store_true", help="print the workers' status documents as JSON")
    add_hub_arguments(parser)
    parser.set_defaults(run=run_status)


def run_status(args: argparse.Namespace) -> int:
    """Show the status once; show a running daemon's workers even if the hub cannot be joined."""
    documents, refused, native = list[StatusDocument](), list[Refusal](), list[NativeNodes]()
    config = client_config(args, partly=of_this_machine(args))
    state = daemon_state(config, file=config_file(args)) if of_this_machine(args) else DaemonState("")
    silent = absent(state.document, looping=True)
    unreachable: ClientError | None = None
    joined = False
    try:
        with open_client(args, warn=False, config=config) as client:
            joined = True
            documents = _ask_status(client)
            client.settle()
            refused = refusals(client, documents)
            native = native_nodes(client.endpoints(), {zid for document in documents for zid in document.hub_sessions})
    except ClientError as err:
        if state.life is not Life.RUNNING:
            raise
        silent = absent(state.document, ENABLED, looping=True)
        unreachable = None if joined else err
    if state.life is Life.UNKNOWN and of_this_machine(args):
        state = daemon_state(config, documents, config_file(args))
    documents = with_restarts(with_silent(documents, silent), state.document)
    documents += [*unanswered(state.document, documents), *without_node(state.document), *of_daemon(state)]
    documents.sort(key=lambda document: (document.daemon, document.worker != DAEMON))
    if args.json:
        print_json([{**document.document(), **_refused_commands(document, refused)} for document in documents])
    else:
        show(make_console(), documents, refused, native)
    if state.trouble:
        raise CliError(f"{state.trouble}\n{state.cure}")
    if unreachable is not None:
        raise unreachable
    return 0


def _ask_status(client: CliClient) -> list[StatusDocument]:
    try:
        return ask_status(client)
    except ClientError as err:
        state = client.daemon()
        if state.life is not Life.RUNNING:
            raise
        hint = f"The daemon {state.name} is running (process {state.pid}): 'midspan status' lists its workers."
        raise CliError(f"{str(err).partition(chr(10))[0]}\n{hint}") from None


def of_daemon(state: DaemonState) -> list[StatusDocument]:
    """Return an entry like that of a worker for a daemon that does not run or answer, or that refused a reload."""
    if not state.trouble:
        if not state.refusal:
            return []
        warning = f"{state.refusal}; {RELOAD_CURE}"
        return [StatusDocument(daemon=state.name, worker=DAEMON, state="running", pid=state.pid, warnings=[warning])]
    text = f"{state.trouble}: {state.cure}"
    return [StatusDocument(daemon=state.name, worker=DAEMON, state=state.life.value, text=text, pid=state.pid)]


def show(
    console: Console, documents: Sequence[StatusDocument], refused: Sequence[Refusal] = (),
    natives: Sequence[NativeNodes] = (),
) -> None:  # fmt: skip
    """Print a block for each daemon with its workers, then the hub's native nodes by release, then the routes."""
    for daemon in dict.fromkeys(document.daemon for document in documents):
        console.print(Text(clean(daemon), style="bold"))
        workers = [document for document in documents if document.daemon == daemon]
        common = shared({document.worker: document.warnings for document in workers})
        for document in workers:
            _show_worker(console, document, common)
            for refusal in _refusals_of(document, refused):
                console.print(Text(f"           {clean(refusal.text)}", "yellow"))
                console.print(Text(f"             cure: {clean(refusal.cure)}"))
        for warning, names in common.values():
            console.print(Text(f"  warning of {clean(', '.join(names))}: {clean(warning)}", "yellow"))
    for group in natives:
        console.print(Text(f"{clean(group)} on the hub: {clean(listed(group.nodes))}"))
    console.print()
    if any(document.routes for document in documents):
        console.print(routes_table(documents))
    else:
        console.print("no routes: no published topic would be bridged; 'midspan topic list -v' lists all topics")


def _refusals_of(document: StatusDocument, refused: Sequence[Refusal]) -> list[Refusal]:
    """Return the commands that a router's external listener refused; none for other workers."""
    return [r for r in refused if isinstance(document, RouterStatus) and document.daemon == r.daemon]


def _refused_commands(document: StatusDocument, refused: Sequence[Refusal]) -> dict[str, Any]:
    of_router = [dataclasses.asdict(refusal) for refusal in _refusals_of(document, refused)]
    return {"refused_commands": of_router} if of_router else {}


def _show_worker(console: Console, document: StatusDocument, elsewhere: Container[str]) -> None:
    """Print a worker, without the warnings whose causes are in ``elsewhere``."""
    state = clean(document.state or "?")
    line = Text(f"  {clean(document.worker or '?'):<8} ")
    line.append(f"{state:<8}", style=_STYLES.get(state, "red"))
    line.append(f" {_figures(document)}")
    console.print(line)
    if document.error:
        console.print(Text(f"           {clean(document.error)}", style="red"))
    if document.ended:
        console.print(Text(f"           {clean(restarted(document.restarts, document.ended))}"))
    for text, cure in _refusal_lines(document):
        console.print(Text(f"           {clean(text)}", "yellow"))
        if cure:
            console.print(Text(f"             cure: {clean(cure)}"))
    if isinstance(document, RouterStatus):
        for endpoint in document.endpoints:
            for line in _endpoint(endpoint):
                console.print(line)
        for machine in document.machines:
            console.print(_machine(machine))
    for connected in connected_lines(document.ports):
        console.print(Text(f"           {connected}"))
    if isinstance(document, WorkerStatus) and (why := document.lane.why):
        console.print(
            Text(f"           no local transport from it, so small messages go over zenoh: {clean(why)}", "yellow")
        )
    for group in document.middlewares if isinstance(document, WorkerStatus) else ():
        console.print(Text(f"           {clean(group)}: {clean(listed(group.nodes))}"))
    for skipped in skipped_lines(document):
        console.print(Text(f"           {skipped}"))
    for warning in grouped(text for text in document.warnings if cause(text) not in elsewhere):
        console.print(Text(f"           warning: {clean(warning)}", "yellow"))


def _refusal_lines(document: StatusDocument) -> list[tuple[str, str]]:
    """Return what a worker refused: one line for each cause, with its cure."""
    groups: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for route in refused_routes(document):
        text = f"refused {arrow(document.side, route.direction)} {route.topic} ({route.type}): {route.reason}"
        groups.setdefault((cause(text), cause(route.cure)), []).append((text, route.cure))
    return [(one_line([text for text, _ in group]), group[0][1]) for group in groups.values()]


def _endpoint(endpoint: EndpointStatus) -> list[Text]:
    """Return the lines of one endpoint of hub.open: its state, and a cure if other machines cannot join through it."""
    direction, address, state = (clean(text or "?") for text in (endpoint.way, endpoint.endpoint, endpoint.state))
    age = "" if endpoint.since is None else f" for {duration(max(time.time() - endpoint.since, 0.0))}"
    machine = f" to {clean(endpoint.machine)}" if state == "connected" and endpoint.machine else ""
    reason = f": {clean(endpoint.reason)}" if endpoint.reason else ""
    good = state in ("connected", "connecting", "listening")
    lines = [Text(f"           hub.open.{direction} {address} {state}{machine}{age}{reason}", "" if good else "yellow")]
    if endpoint.cure:
        lines.append(Text(f"             cure: {clean(endpoint.cure)}"))
    return lines


def _machine(machine: MachineStatus) -> Text:
    name, address = clean(machine.name or "a machine without a certificate"), clean(machine.address or "?")
    if machine.trusted:
        return Text(f"           {name} at {address}")
    return Text(f"           {name} may not command (hub.open.trusted), at {address}", "yellow")


def _figures(document: StatusDocument) -> str:
    parts: list[str] = []
    if isinstance(document, WorkerStatus) and document.network:
        parts.append(f"{side_name(document.side)} network {clean(document.network)}")
    elif document.state == "waiting" and document.side:  # a module waits for something else
        parts.append(f"{side_name(document.side)} is unavailable")
    if document.text:
        parts.append(clean(document.text))
    if isinstance(document, RouterStatus) and document.listen:
        parts.append(f"listens at {clean(document.listen)}, {plural(document.sessions or 0, 'session')}")
    if document.routes:
        rate = sum(route.rate or 0.0 for route in document.routes)
        parts.append(f"{plural(len(document.routes), 'route')}, {rate:.0f} msg/s")
    if document.uptime is not None:
        parts.append(f"up {duration(document.uptime)}")
    if document.cpu is not None:
        parts.append(f"cpu {document.cpu * 100:.0f} %")
    if document.rss:
        parts.append(size(document.rss))
    if document.pid:
        parts.append(f"pid {document.pid}")
    return ", ".join(parts)


_INTERVAL = 1.0


def register_top(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Shows every route of every worker on the hub until Ctrl-C: messages per second, latency (from the source's"
        " time stamp to delivery; between machines only as accurate as their clocks), messages, drops by reason, age of"
        " the last message. Without a terminal it prints the table once, or every --interval seconds."
    )
    parser.add_argument("--once", action="store_true", help="print the table once and exit")
    parser.add_argument(
        "--interval", type=number_in(0.1, 3600), metavar="SECONDS", help=f"time between updates (default {_INTERVAL:g})"
    )
    parser.add_argument("--json", action="store_true", help="print all status documents, one JSON list per line")
    add_hub_arguments(parser)
    parser.set_defaults(run=run_top)


def run_top(args: argparse.Namespace) -> int:
    """Show the table until Ctrl-C, or once."""
    live = sys.stdout.isatty()
    once = args.once or (args.interval is None and not live)
    interval = args.interval or _INTERVAL
    config = client_config(args, partly=of_this_machine(args))
    with open_client(args, config=config) as client, contextlib.suppress(KeyboardInterrupt):
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
            print_json([document.document() for document in documents], lines=True)
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


def _view(documents: Sequence[StatusDocument]) -> RenderableType:
    head = Text()
    for number, document in enumerate(documents):
        head.append("   " if number else "")
        head.append(f"{clean(document.daemon)}/{clean(document.worker)} ", style="bold")
        state = clean(document.state or "?")
        head.append(state, style="green" if state == "running" else "yellow")
        if document.routes:
            head.append(f" {plural(len(document.routes), 'route')}")
        if refused := refused_routes(document):
            head.append(f", {len(refused)} refused", style="yellow")
    return Group(head, routes_table(documents, errors=False))
