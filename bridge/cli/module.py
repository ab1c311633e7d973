"""``midspan module``: one hosted module, alone."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from bridge.cli.errors import CliError
from bridge.cli.worker import run_alone
from bridge.daemon.workers import worker_kinds


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser = subparsers.add_parser(
        "module",
        help="run one module alone, also on another machine",
        description="Run one hosted module in the foreground, without the daemon: on another machine, or as a service"
        " of its own. The configuration switches it on; SIGHUP loads that again. Where a daemon runs the same module,"
        " switch it off there.",
    )
    parser.add_argument("name", help="its name in the configuration's section modules")
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration file (default: where one is found)")


def run(args: argparse.Namespace) -> int:
    """Run the module until it is told to stop."""
    from bridge.config.load import load
    from bridge.daemon.state import with_state

    config = with_state(load(args.config))
    sections = config.hosted
    if args.name not in sections:
        known = ", ".join(sections) or "none"
        msg = f"modules.{args.name} is not switched on in the configuration; those that are: {known}"
        raise CliError(msg)
    kind = replace(worker_kinds()["modules"], arguments=(args.name,))
    return run_alone(kind, config, lambda: with_state(load(args.config)))
