"""``midspan doctor``: checks for common problems and names their cures."""

from __future__ import annotations

import argparse
import os

from rich.console import Console
from rich.text import Text

from bridge.cli.arguments import add_hub_arguments
from bridge.cli.client import client_config, config_file, of_this_machine, print_wait, router_hint
from bridge.cli.output import CliError, print_json
from bridge.client.errors import ClientError
from bridge.client.session import connect
from bridge.config.document import ConfigError
from bridge.config.model import Config
from bridge.doctor.check import Report, Result, as_json, examine
from bridge.doctor.checks import CHECKS
from bridge.doctor.context import CheckContext, HubSnapshot
from bridge.doctor.daemon_state import DaemonState, daemon_state
from bridge.doctor.examination import make_context, snapshot
from bridge.text import clean, make_console

_STYLES = {Result.OK: "green", Result.WARN: "yellow", Result.FAIL: "bold red", Result.SKIP: "dim"}


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Checks the configuration, the daemon, all sides, the network and this machine for common reasons why topics"
        " are not bridged, and names a cure for each finding. It needs no running daemon and changes nothing. Run it"
        " in the same shell and as the same user as the programs with the problem. Exit code 1 if a check fails, 0 if"
        " there are only warnings."
    )
    parser.add_argument("--json", action="store_true", help="print one entry for each finding as JSON")
    parser.add_argument("--only", metavar="ID", action="append", default=[], help="run only this check (repeatable)")
    parser.add_argument("--list", action="store_true", help="list the checks and exit")
    add_hub_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    if args.list:
        for check in CHECKS:
            print(f"{check.id:<18} {check.title}")
        return 0
    unknown = set(args.only) - {check.id for check in CHECKS}
    if unknown:
        raise CliError(f"no check {', '.join(sorted(unknown))}; 'midspan doctor --list' shows all")
    checks = [check for check in CHECKS if not args.only or check.id in args.only]
    reports = examine(_gathered_context(args), checks)
    if args.json:
        print_json(as_json(reports))
    else:
        _show(make_console(), reports)
    failed = any(finding.result is Result.FAIL for report in reports for finding in report.findings)
    return 1 if failed else 0


def _gathered_context(args: argparse.Namespace) -> CheckContext:
    try:
        config = client_config(args, partly=of_this_machine(args))
    except (ConfigError, OSError) as err:
        hub = HubSnapshot("the hub was not queried: the configuration cannot be used")
        return CheckContext(config_text=str(err), config_good=False, environ=dict(os.environ), hub=hub)
    config, hub = _hub_snapshot(config, here=of_this_machine(args))
    state = daemon_state(config, hub.documents, config_file(args)) if of_this_machine(args) else DaemonState("")
    return make_context(config, hub, state, args.config)


def _hub_snapshot(config: Config, *, here: bool) -> tuple[Config, HubSnapshot]:
    """Return the configuration with the daemon's name, and the hub."""
    try:
        with connect(config, here=here, hint=router_hint, on_wait=print_wait) as client:
            return client.config, snapshot(client)
    except ClientError as err:
        return config, HubSnapshot(str(err))


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
