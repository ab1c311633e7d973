"""``midspan demo``: real programs of every side, bridged, with a live table."""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import sys
from pathlib import Path
from typing import Any

from bridge.cli.errors import CliError


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser = subparsers.add_parser(
        "demo",
        help="real programs of every side, bridged, with a live table",
        description="Starts a real roscore and a ROS 1 robot (simulated: laser, odometry, tf, map, camera, obeys"
        " /cmd_vel), the daemon, a real rclpy program and a zenoh program; these listen and drive. Shows every route"
        " and checks by what the programs report that everything crossed. All on ports and a ROS domain of its own;"
        " nothing is left behind. Exit code 1 where something did not cross.",
    )
    parser.add_argument(
        "--stay",
        action="store_true",
        default=os.environ.get("STAY", "") not in ("", "0"),
        help="go on until Ctrl-C instead of ending after the checks (or STAY=1)",
    )
    parser.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        default=os.environ.get("JSON") or None,
        help="also write checks and routes to a file (or JSON=FILE)",
    )
    parser.add_argument(
        "--seconds", type=float, metavar="N", default=20.0, help="how long to run at least (default 20)"
    )
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="configuration with the daemon's rules (default configs/demo.yaml)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the demo; 0 where everything crossed."""
    from bridge.demo import place, requirements
    from bridge.demo.scenario import Demo, DemoError, Result
    from bridge.demo.view import View

    logging.basicConfig(format="%(message)s", level=logging.WARNING)
    template = args.config or (place.CONFIG if place.CONFIG.is_file() else None)
    signal.signal(signal.SIGTERM, _interrupt)
    signal.signal(signal.SIGHUP, _interrupt)
    with place.Place(template) as here:
        lacking = requirements.missing(here.config)
        if lacking:
            raise CliError("\n".join(["the demo needs more than this machine has:", *lacking]))
        result = Result()
        with View(here) as view:
            try:
                with Demo(here, view.tick) as demo:
                    result = demo.run(args.seconds)
                    view.look()
                    view.ask_why(result.checks)
                    view.say(f"checked after {result.seconds:.0f} s")
                    if args.stay:
                        view.show(result.checks)
                        demo.stay()
            except DemoError as err:
                raise CliError(str(err)) from None
            except KeyboardInterrupt:
                if not args.stay or not result.checks:
                    raise
        view.show(result.checks)
        if args.json is not None:
            _write(args.json, {**result.as_dict(), "routes": view.routes()})
    return 0 if result.ok else 1


def _interrupt(_number: int, _frame: object) -> None:
    raise KeyboardInterrupt


def _write(file: Path, document: dict[str, Any]) -> None:
    try:
        Path(file).write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as err:
        msg = f"cannot write {file}: {err.strerror}"
        raise CliError(msg) from None
    print(f"written to {file}", file=sys.stderr)
