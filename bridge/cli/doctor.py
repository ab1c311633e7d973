"""``midspan doctor``: looks for what commonly goes wrong, and says the cure."""

from __future__ import annotations

import argparse
import dataclasses
import os
from typing import Any

from rich.console import Console
from rich.text import Text

from bridge.cli.console import make_console, print_json
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, add_hub_arguments, client_config, connect
from bridge.cli.text import clean
from bridge.config.load import find
from bridge.config.model import Config
from bridge.config.problems import ConfigError
from bridge.doctor import clock
from bridge.doctor.around import Around, HubView
from bridge.doctor.checks import CHECKS
from bridge.doctor.examine import Report, examine
from bridge.doctor.finding import Finding, Result

_STYLES = {Result.OK: "green", Result.WARN: "yellow", Result.FAIL: "bold red", Result.SKIP: "dim"}
_CLOCK_SECONDS = 0.5
_MAX_CLOCKS = 50


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "doctor",
        help="look for what commonly goes wrong, and say the cure",
        description="Looks at the configuration, the daemon, both ROS worlds, the network and this machine for what"
        " commonly keeps topics from crossing, and says for each finding what helps. Works with and without a running"
        " daemon; run it in the shell, and as the user, whose programs have trouble. It changes nothing. Exit code 1"
        " when something fails; warnings alone give 0.",
    )
    parser.add_argument("--json", action="store_true", help="print one entry for each finding as JSON")
    parser.add_argument(
        "--only", metavar="ID", action="append", default=[], help="run this check only (may be repeated)"
    )
    parser.add_argument("--list", action="store_true", help="list the checks and end")
    add_hub_arguments(parser)


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
        print_json([_as_json(report, finding) for report in reports for finding in report.findings])
    else:
        _show(make_console(), reports)
    failed = any(finding.result is Result.FAIL for report in reports for finding in report.findings)
    return 1 if failed else 0


def _look_around(args: argparse.Namespace) -> Around:
    environ = dict(os.environ)
    try:
        config = client_config(args)
    except (ConfigError, OSError) as err:
        hub = HubView("the hub was not asked: the configuration cannot be used")
        return Around(config_text=str(err), config_good=False, environ=environ, hub=hub)
    file = args.config or find()
    text = f"{file} is good" if file is not None else "no configuration file: all defaults"
    return Around(config, text, environ=environ, hub=_look_at_hub(config))


def _look_at_hub(config: Config) -> HubView:
    try:
        with connect(config) as client:
            documents = []
            for answer in client.ask("status"):
                value = answer.value if isinstance(answer.value, dict) else {"error": answer.error or "no status"}
                documents.append({**value, "daemon": answer.daemon, "worker": answer.worker})
            client.settle()
            endpoints = [e for e in client.hub.graph.endpoints() if not e.own]
            return HubView("", documents, endpoints, _clocks(client))
    except CliError as err:
        return HubView(str(err))


def _clocks(client: Client) -> dict[str, clock.Offset]:
    """The clock of each worker that tells it."""
    found: dict[str, clock.Offset] = {}
    for answer in client.ask("time", timeout=_CLOCK_SECONDS)[:_MAX_CLOCKS]:
        if not answer.error:
            offset = clock.measure(lambda to=answer: _time(client, to.daemon, to.worker))  # type: ignore[misc]
            if offset is not None:
                found[f"{answer.daemon}/{answer.worker}"] = offset
    return found


def _time(client: Client, daemon: str, worker: str) -> int | None:
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


def _as_json(report: Report, finding: Finding) -> dict[str, str]:
    return {"check": report.check.id, "title": report.check.title, **dataclasses.asdict(finding)}
