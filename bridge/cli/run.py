"""``midspan run``: the daemon."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import Any

from bridge.daemon.workers import WORKERS


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser = subparsers.add_parser(
        "run",
        help="run the daemon: start, watch and restart the workers",
        description="Run the daemon in the foreground. SIGHUP loads the configuration again: it is checked first, and"
        " only what changed is touched. SIGTERM or Ctrl-C stops everything in order; a second one at once.",
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration file (default: where one is found)")
    parser.add_argument(
        "--adopt",
        action="append",
        default=[],
        choices=[kind.name for kind in WORKERS],
        metavar="WORKER",
        help="a service of its own runs this worker; use it, never start or stop it (may be given again)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the daemon until it is told to stop."""
    from bridge.config.problems import ConfigError
    from bridge.daemon import log
    from bridge.daemon.protocol import EXIT_CANNOT_WORK
    from bridge.daemon.supervisor import Supervisor

    try:
        supervisor = Supervisor(args.config, standing=args.adopt)
    except ConfigError as err:
        print(err, file=sys.stderr)
        return EXIT_CANNOT_WORK  # a service must not be started again and again with it
    log.setup(supervisor.config, "midspan", log.style_for())
    signal.signal(signal.SIGTERM, lambda *_: supervisor.request_stop())
    signal.signal(signal.SIGINT, lambda *_: supervisor.request_stop())
    signal.signal(signal.SIGHUP, lambda *_: supervisor.request_reload())
    supervisor.run()
    return 0
