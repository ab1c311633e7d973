"""A command's session on the hub, with reports of this machine's daemon about what is missing."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from bridge.cli.output import CliError
from bridge.client.errors import ClientError, UnreachableHubError
from bridge.client.refusals import refusals_of_own
from bridge.client.session import DOWN, HELD, Client, connect, unreachable_hint
from bridge.config.document import ConfigError
from bridge.config.load import find, load
from bridge.config.model import Config
from bridge.config.partial import load_partly
from bridge.daemon import units
from bridge.doctor.daemon_state import DaemonState, Life, daemon_state, describe, unresponsive_router
from bridge.state_file import named
from bridge.status import StatusDocument, WorkerReport
from bridge.stores.entry import StoreError
from bridge.text import clean


@dataclass(frozen=True, slots=True)
class CliClient(Client):
    """A command's session on the hub; ``file`` is the configuration's file."""

    file: Path | None = None

    def daemon(self, documents: Iterable[StatusDocument] = ()) -> DaemonState:
        """Return the state of this machine's daemon, given the hub's status documents; unknown on another hub."""
        return daemon_state(self.config, documents, self.file) if self.here else DaemonState(self.config.name)


def config_file(args: argparse.Namespace) -> Path | None:
    """Return the configuration file that a command uses, or None."""
    file: Path | None = args.config or find()
    return file


def client_config(args: argparse.Namespace, *, partly: bool = False) -> Config:
    """Return the configuration, overridden by the command line.

    A broken file that the command line does not name is ignored, with a warning, if ``--router`` names the hub.
    ``partly``: use the valid parts of any broken file, because the daemon may run regardless; for commands that stop
    the robot or show what runs.
    """
    try:
        config = named(load(args.config, client=True), os.environ, units.STATE)
    except ConfigError as err:
        file = config_file(args)
        if partly and file is not None and file.exists():
            config, how = named(load_partly(file), os.environ, units.STATE), "the rest of the file is used"
        elif args.config is None and args.router is not None:
            config, how = Config(), "the file is ignored, because --router names the hub"
        else:
            raise
        more = f" (and {len(err.problems) - 1} more)" if len(err.problems) > 1 else ""
        print(f"midspan: warning: {err.problems[0]}{more}; {how}", file=sys.stderr)
    hub = config.hub
    if args.router is not None:
        hub = hub.model_copy(update={"listen": args.router})
    if args.hub_domain is not None:
        hub = hub.model_copy(update={"domain": args.hub_domain})
    return config.model_copy(update={"hub": hub})


@contextmanager
def open_client(
    args: argparse.Namespace, *, warn: bool = True, watches: bool = False, config: Config | None = None
) -> Iterator[CliClient]:
    """Join the hub; raises `CliError` if no router answers.

    On the hub of this machine's daemon, it reports on stderr if only the daemon's router runs, and each error names the
    daemon's workers that do not run. ``warn`` is False for commands that report the daemon themselves, or have
    something more urgent to do. ``watches`` reports missing workers at once, for commands that would otherwise only
    wait or print less. ``config``: by default that of `client_config`.
    """
    config = config or client_config(args)
    with _join_hub(args, config) as session:
        client = CliClient(session.hub, session.config, session.where, of_this_machine(args), config_file(args))
        reported = warn_of_daemon(args, config, workers=watches) if warn else []
        try:
            yield client
        except (ClientError, StoreError) as err:
            absences = client.daemon().absences()
            absences = [line for line in absences if line not in (*reported, str(err)) and line not in str(err)]
            if not absences:
                raise
            raise CliError("\n".join([str(err), *absences])) from None


@contextmanager
def _join_hub(args: argparse.Namespace, config: Config) -> Iterator[Client]:
    """Join the hub; the error includes what this machine's daemon reports about its router."""
    with ExitStack() as stack:
        try:
            client = stack.enter_context(
                connect(config, here=of_this_machine(args), hint=router_hint, on_wait=print_wait)
            )
        except UnreachableHubError as err:
            state = daemon_state(config, file=config_file(args)) if of_this_machine(args) else DaemonState("")
            missing = state.why_missing("router", config) or _report(state)
            if not missing:
                raise
            hint = "" if err.hint == DOWN or (HELD in err.hint and "is held by" in missing) else err.hint
            raise CliError("\n".join(filter(None, (err.text, missing, state.cure, hint)))) from None
        yield client


def print_wait(text: str) -> None:
    """Print on stderr what a command waits for."""
    print(f"midspan: {text}", file=sys.stderr, flush=True)


def router_hint(config: Config) -> str:
    """Return a probable reason why no router answers at the hub's endpoint, such as that this machine's hangs."""
    unresponsive = unresponsive_router(config)
    if unresponsive:
        return f"{unresponsive}; 'midspan doctor' names the cause, and the router's log may, too"
    return unreachable_hint(config)


def _report(state: DaemonState) -> str:
    """Return the state of a running daemon's router; "" if the daemon does not run."""
    if state.life is not Life.RUNNING:
        return ""
    reports = (report for report in state.workers if report.worker == "router")
    router = next(reports, WorkerReport(phase="missing"))
    how = ": ".join(filter(None, (router.phase, describe(router))))
    return f"the daemon {state.name} is running (process {state.pid}); its worker 'router' is {how}"


def warn_of_daemon(args: argparse.Namespace, config: Config, *, workers: bool = True) -> list[str]:
    """Report on stderr that this machine's daemon, or some of its workers, do not run; return the lines."""
    if not of_this_machine(args):
        return []
    state = daemon_state(config, file=config_file(args))
    lines = [f"{state.trouble}; {state.cure}"] if state.trouble else []
    lines += state.absences() if workers else []
    for line in lines:
        print(f"midspan: warning: {line}", file=sys.stderr)
    return lines


def warn_of_refusals(client: Client, published: Iterable[tuple[str, str, str]]) -> bool:
    """Report on stderr which machines refuse this program's topics (name, type, type hash); return whether any does."""
    refused = refusals_of_own(client, published)
    for refusal in refused:
        print(f"midspan: warning: {clean(refusal.text)}; {clean(refusal.cure)}", file=sys.stderr)
    return bool(refused)


def of_this_machine(args: argparse.Namespace) -> bool:
    """Whether the command line names no hub other than that of this machine's daemon."""
    return args.router is None and args.hub_domain is None
