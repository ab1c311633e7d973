"""``midspan worker``: one worker, alone or under the daemon."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from bridge.daemon.workers import WORKERS, child_command, worker_kinds

if TYPE_CHECKING:
    from bridge.config.model import Config
    from bridge.daemon.workers import WorkerKind

_KEPT = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID", "JOURNAL_STREAM")


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser = subparsers.add_parser(
        "worker",
        help="run one worker alone, also on another machine",
        description="Run one worker in the foreground, without the daemon: on another machine, or as a service of its"
        " own. SIGHUP loads the configuration again.",
    )
    parser.add_argument("side", choices=[kind.name for kind in WORKERS], help="which worker")
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration file (default: where one is found)")
    parser.add_argument(
        "--control",
        action="store_true",
        help="open a control socket in the state folder, so that a daemon of the same name finds the worker",
    )
    parser.add_argument(
        "--supervised",
        action="store_true",
        help="take the configuration and commands as JSON lines from the standard input (how the daemon starts it)",
    )
    parser.add_argument("--prepared", action="store_true", help=argparse.SUPPRESS)  # the environment is already its own


def run(args: argparse.Namespace) -> int:
    """Run the worker until it is told to stop."""
    from bridge.daemon.process import Process

    kind = worker_kinds()[args.side]
    if args.supervised:
        ended = Process(kind, control=args.control).run_supervised()
        # The daemon's SIGTERM may come behind its word, when Python has taken its handlers away already.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        return ended
    config = _config(args)
    if kind.environment and not args.prepared:
        _enter_environment(kind, config, args)
    return run_alone(kind, config, lambda: _config(args), control=args.control)


def run_alone(kind: WorkerKind, config: Config, load: Callable[[], Config], *, control: bool = False) -> int:
    """Run a worker in this process without the daemon; the exit code."""
    from bridge.daemon.process import Process

    code = Process(kind, control=control).run_alone(config, load)
    if code is None:
        logging.getLogger("midspan").info("starting again")
        _go_on_as([sys.executable, *sys.orig_argv[1:]], os.environ)
    return code


def _config(args: argparse.Namespace) -> Config:
    from bridge.config.load import load
    from bridge.daemon.state import with_state

    return with_state(load(args.config))


def _enter_environment(kind: WorkerKind, config: Config, args: argparse.Namespace) -> None:
    """Start this command again in the environment that the worker needs."""
    env = kind.child_environment(config)
    env.update({name: os.environ[name] for name in _KEPT if name in os.environ})
    options = ["--prepared", *(["--control"] if args.control else [])]
    if args.config is not None:
        options += ["--config", str(args.config)]
    command = child_command(kind.name, *options)
    _go_on_as(command, env)


def _go_on_as(command: list[str], env: Mapping[str, str]) -> NoReturn:
    """Let a command of our own take this process's place."""
    if sys.platform == "win32":  # exec leaves whoever waits for this process with nobody there
        sys.exit(subprocess.call(command, env=dict(env)))
    os.execve(command[0], command, dict(env))  # noqa: S606  our own interpreter and module
