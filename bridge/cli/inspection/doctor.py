"""``midspan doctor``: checks for common problems and names their cures."""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from bridge.cli.arguments import add_hub_arguments
from bridge.cli.client import CliClient, client_config, config_file, connect, of_this_machine
from bridge.cli.inspection.namesakes import distinct
from bridge.cli.inspection.status import absent, document_of, with_silent
from bridge.cli.output import CliError, clean, make_console, print_json
from bridge.config.document import ConfigError
from bridge.config.load import find, load
from bridge.config.model import Config
from bridge.doctor import context
from bridge.doctor.check import Report, Result, examine
from bridge.doctor.checks import CHECKS
from bridge.doctor.context import CheckContext, HubSnapshot
from bridge.doctor.daemon_state import DaemonState, daemon_state

_STYLES = {Result.OK: "green", Result.WARN: "yellow", Result.FAIL: "bold red", Result.SKIP: "dim"}
_CLOCK_SECONDS = 0.5
_MAX_CLOCKS = 50


def register(parser: argparse.ArgumentParser) -> None:
    """Describe the verb and its arguments."""
    parser.description = (
        "Checks the configuration, the daemon, all sides, the network and this machine for what commonly keeps topics"
        " from crossing, and names a cure for each finding. It needs no running daemon and changes nothing; run it in"
        " the shell, and as the user, whose programs have trouble. Exit code 1 when a check fails; warnings give 0."
    )
    parser.add_argument("--json", action="store_true", help="print one entry for each finding as JSON")
    parser.add_argument("--only", metavar="ID", action="append", default=[], help="run only this check (repeatable)")
    parser.add_argument("--list", action="store_true", help="list the checks and exit")
    add_hub_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the checks."""
    if args.list:
        for check in CHECKS:
            print(f"{check.id:<18} {check.title}")
        return 0
    unknown = set(args.only) - {check.id for check in CHECKS}
    if unknown:
        raise CliError(f"no check {', '.join(sorted(unknown))}; 'midspan doctor --list' shows all")
    checks = [check for check in CHECKS if not args.only or check.id in args.only]
    reports = examine(_look_around(args), checks)
    if args.json:
        print_json(as_json(reports))
    else:
        _show(make_console(), reports)
    failed = any(finding.result is Result.FAIL for report in reports for finding in report.findings)
    return 1 if failed else 0


def _look_around(args: argparse.Namespace) -> CheckContext:
    environ = dict(os.environ)
    try:
        config = client_config(args)
    except (ConfigError, OSError) as err:
        hub = HubSnapshot("the hub was not asked: the configuration cannot be used")
        return CheckContext(config_text=str(err), config_good=False, environ=environ, hub=hub)
    config, hub = _look_at_hub(config, here=of_this_machine(args))
    state = daemon_state(config, hub.documents, config_file(args)) if of_this_machine(args) else DaemonState("")
    documents = with_silent(hub.documents, absent(state.document, looping=True))
    hub = dataclasses.replace(hub, documents=documents)
    text, good = _checked(args.config)
    return CheckContext(config, text, config_good=good, environ=environ, hub=hub, daemon=state)


def look_from(client: CliClient, file: Path | None) -> CheckContext:
    """Return what the checks examine, for a program of the daemon that is on the hub; ``file``: the configuration."""
    environ, hub, state = dict(os.environ), snapshot(client), daemon_state(client.config, file=file)
    documents = with_silent(hub.documents, absent(state.document, looping=True))
    hub = dataclasses.replace(hub, documents=documents)
    text, good = _checked(file)
    return CheckContext(client.config, text, config_good=good, environ=environ, hub=hub, daemon=state)


def _checked(file: Path | None) -> tuple[str, bool]:
    """Return what is known of a file, by default of the one that `find` finds, and whether it is good."""
    try:
        load(file)
    except ConfigError as err:
        return str(err), False
    file = file or find()
    return (f"{file} is good" if file is not None else "no configuration file: all defaults"), True


def _look_at_hub(config: Config, *, here: bool) -> tuple[Config, HubSnapshot]:
    """Return the configuration with the daemon's name, and the hub."""
    try:
        with connect(config, here=here) as client:
            return client.config, snapshot(client)
    except CliError as err:
        return config, HubSnapshot(str(err))


def snapshot(client: CliClient) -> HubSnapshot:
    """Return the hub as this client sees it."""
    documents = [document_of(answer) for answer in distinct(client, client.ask("status"))]
    client.settle()
    endpoints = [e for e in client.hub.graph.endpoints() if not e.own]
    return HubSnapshot("", documents, endpoints, _clocks(client))


def _clocks(client: CliClient) -> dict[str, context.Offset]:
    found: dict[str, context.Offset] = {}
    for answer in client.ask("time", timeout=_CLOCK_SECONDS)[:_MAX_CLOCKS]:
        if not answer.error:
            offset = context.measure(lambda to=answer: _time(client, to.daemon, to.worker))  # type: ignore[misc]
            if offset is not None:
                found[f"{answer.daemon}/{answer.worker}"] = offset
    return found


def _time(client: CliClient, daemon: str, worker: str) -> int | None:
    for answer in client.hub.ask("time", {}, daemon, worker, _CLOCK_SECONDS):
        if isinstance(answer.value, dict) and isinstance(answer.value.get("time_ns"), int):
            return int(answer.value["time_ns"])
    return None


def _show(console: Console, reports: list[Report]) -> None:
    counts = dict.fromkeys(Result, 0)
    for report in reports:
        for finding in report.findings:
            counts[finding.result] += 1
            line = Text(f"{finding.result.upper():<5}", style=_STYLES[finding.result])
            line.append(f" {report.check.id}: ", style="bold")
            line.append(clean(finding.seen), style="")
            console.print(line, soft_wrap=True)
            if finding.cure:
                console.print(Text(f"      cure: {clean(finding.cure)}"), soft_wrap=True)
    words = ", ".join(f"{count} {result}" for result, count in counts.items() if count)
    console.print(Text(f"\n{words}"))


def as_json(reports: Sequence[Report]) -> list[dict[str, str]]:
    """One entry for each finding: ``check``, ``title``, ``result``, ``seen`` and ``cure``."""
    return [
        {"check": report.check.id, "title": report.check.title, **dataclasses.asdict(finding)}
        for report in reports
        for finding in report.findings
    ]
