"""``midspan run``, ``midspan worker`` and ``midspan module``: the daemon, one worker, one hosted module."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn

from bridge.cli.arguments import add_config
from bridge.cli.output import CliError
from bridge.daemon.workers import child_command, worker_kinds

if TYPE_CHECKING:
    from bridge.config.model import Config
    from bridge.daemon.workers import WorkerKind


def register_run(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Runs the daemon in the foreground. SIGHUP or 'midspan reload' checks and reloads the configuration; only"
        " the workers that a change affects reload. SIGTERM or Ctrl-C stops everything in order, a second one at once."
    )
    add_config(parser)
    parser.add_argument(
        "--adopt",
        action="append",
        default=[],
        choices=list(worker_kinds({})),
        metavar="WORKER",
        help="use this worker, which a separate service runs; never start or stop it (may be repeated)",
    )
    parser.set_defaults(run=run_run)


def run_run(args: argparse.Namespace) -> int:
    """Run the daemon until it is asked to stop."""
    from bridge.config.document import ConfigError
    from bridge.daemon import log
    from bridge.daemon.protocol import EXIT_CANNOT_WORK
    from bridge.daemon.supervisor import Supervisor

    try:
        supervisor = Supervisor(args.config, standing=args.adopt)
    except ConfigError as err:
        print(err, file=sys.stderr)
        return EXIT_CANNOT_WORK  # so that systemd does not restart the service
    log.setup(supervisor.config, "midspan", log.style_for(), log.StderrHandler())
    for name in ("SIGTERM", "SIGINT", "SIGBREAK"):  # Windows sends the last one as it closes a console or a session
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda *_: supervisor.request_stop())
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, lambda *_: supervisor.request_reload())
    supervisor.run()
    return 0


_KEPT = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID", "JOURNAL_STREAM")  # systemd's variables for a service


def register_worker(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Runs one worker in the foreground, without the daemon: on another machine, or as a separate service."
        " SIGHUP reloads the configuration."
    )
    parser.add_argument("side", choices=list(worker_kinds({})), help="which worker")
    add_config(parser)
    parser.add_argument(
        "--control",
        action="store_true",
        help="open a control socket in the state folder, through which a daemon of the same name adopts the worker",
    )
    parser.add_argument(
        "--supervised",
        action="store_true",
        help="read the configuration and commands as JSON lines from standard input (used by the daemon)",
    )
    parser.add_argument("--prepared", action="store_true", help=argparse.SUPPRESS)  # the environment is already right
    parser.set_defaults(run=run_worker)


def run_worker(args: argparse.Namespace) -> int:
    """Run the worker until it is asked to stop."""
    from bridge.daemon.worker_main import WorkerMain
    from bridge.metrics.on_demand import DiagnosticsOnDemand

    kind = worker_kinds()[args.side]
    if args.supervised:
        ended = WorkerMain(kind, DiagnosticsOnDemand, control=args.control).run_supervised()
        # The daemon's SIGTERM may arrive after its stop command, when Python has already removed its handlers.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        return ended
    config = _config(args)
    if not args.prepared and (reason := kind.missing(config)):
        raise CliError(reason)
    if kind.environment and not args.prepared:
        _enter_environment(kind, config, args)
    return run_alone(kind, config, lambda: _config(args), control=args.control)


def run_alone(kind: WorkerKind, config: Config, load: Callable[[], Config], *, control: bool = False) -> int:
    """Run a worker in this process without the daemon; return the exit code."""
    from bridge.daemon.worker_main import WorkerMain
    from bridge.metrics.on_demand import DiagnosticsOnDemand

    code = WorkerMain(kind, DiagnosticsOnDemand, control=control).run_alone(config, load)
    if code is None:
        logging.getLogger("midspan").info("restarting")
        _go_on_as([sys.executable, *sys.orig_argv[1:]], os.environ)
    return code


def _config(args: argparse.Namespace) -> Config:
    from bridge.config.load import load
    from bridge.state_file import with_state

    return with_state(load(args.config))


def _enter_environment(kind: WorkerKind, config: Config, args: argparse.Namespace) -> None:
    """Restart this command in the environment that the worker needs."""
    env = kind.child_environment(config)
    env.update({name: os.environ[name] for name in _KEPT if name in os.environ})
    options = ["--prepared", *(["--control"] if args.control else [])]
    if args.config is not None:
        options += ["--config", str(args.config)]
    command = child_command(kind.name, *options)
    _go_on_as(command, env)


def _go_on_as(command: list[str], env: Mapping[str, str]) -> NoReturn:
    """Replace this process with another Midspan command."""
    if sys.platform == "win32":  # exec would end this process for the programs that wait for its end
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the new process also gets a Ctrl-C; its exit code is used
        sys.exit(subprocess.call(command, env=dict(env)))
    os.execve(command[0], command, dict(env))  # noqa: S606  our own interpreter and module


def register_module(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Runs one hosted module in the foreground, without the daemon: on another machine, or as a separate service."
        " The configuration must enable the module; SIGHUP reloads the configuration. Disable the module in the"
        " configurations of daemons that would run it too."
    )
    parser.add_argument("name", help="the module's name in the configuration's modules section")
    add_config(parser)
    parser.set_defaults(run=run_module)


def run_module(args: argparse.Namespace) -> int:
    """Run the module until it is asked to stop."""
    from bridge.config.load import load
    from bridge.state_file import with_state

    config = with_state(load(args.config))
    sections = config.hosted
    if args.name not in sections:
        known = ", ".join(sections) or "none"
        raise CliError(f"modules.{args.name} is not enabled in the configuration; enabled modules: {known}")
    kind = replace(worker_kinds()["modules"], arguments=(args.name,))
    return run_alone(kind, config, lambda: with_state(load(args.config)))
