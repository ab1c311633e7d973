"""The program ``midspan``: finds the command, imports its module, runs it, and reports errors without a traceback.

Exit codes: 0 done, 1 failed, 2 wrong usage, 3 done in part (`midspan import` and
`midspan config migrate` only), 130 interrupted by Ctrl-C, 143 ended by SIGTERM, 129 by SIGHUP.
"""

from __future__ import annotations

import argparse
import importlib
import io
import logging
import os
import sys
from collections.abc import Collection, Sequence
from typing import NamedTuple

from bridge.cli.arguments import VerbParser

FAILED = 1
INTERRUPTED = 130


class Verb(NamedTuple):
    """One command, imported only when it is used.

    ``register`` is ``module:function``: it adds arguments to the command's parser, and sets ``run``, which returns the
    exit code.
    """

    register: str
    help: str


VERBS: dict[str, Verb] = {
    "run": Verb("bridge.cli.daemon.run:register_run", "run the daemon: start, watch and restart the workers"),
    "worker": Verb("bridge.cli.daemon.run:register_worker", "run one worker, on this machine or another"),
    "module": Verb("bridge.cli.daemon.run:register_module", "run one hosted module, on this machine or another"),
    "reload": Verb("bridge.cli.daemon.reload:register", "make the running daemon reload its configuration"),
    "sim": Verb(
        "bridge.cli.daemon.sim:register",
        "run the simulated base without a daemon; make maps and pictures of floor plans",
    ),
    "web": Verb("bridge.cli.daemon.web:register", "print or open the address of the console in the browser"),
    "status": Verb("bridge.cli.inspection.status:register_status", "show daemons, workers and routes"),
    "top": Verb("bridge.cli.inspection.status:register_top", "show a live table of all routes"),
    "explain": Verb("bridge.cli.inspection.explain:register", "show why a topic is or is not bridged"),
    "doctor": Verb("bridge.cli.inspection.doctor:register", "check for common problems and name the cures"),
    "topic": Verb("bridge.cli.graph.topic:register", "list, info, echo, hz and pub on any side's topics"),
    "service": Verb("bridge.cli.graph.calls:register_service", "list, info and call on any side's services"),
    "action": Verb("bridge.cli.graph.calls:register_action", "list, info and send on any side's actions"),
    "record": Verb("bridge.cli.daemon.record:register", "record topics of any side into MCAP files"),
    "play": Verb("bridge.cli.bags.play:register", "play bags of ROS 1, ROS 2 and MCAP onto the hub"),
    "bag": Verb("bridge.cli.bags.bag:register", "inspect, convert, cut and mend MCAP files and ROS bags"),
    "tf": Verb("bridge.cli.frames.tf:register", "list, tree, echo and monitor for the frames on /tf"),
    "map": Verb("bridge.cli.maps.map:register", "list, show, import, export, edit and choose the stored maps"),
    "location": Verb("bridge.cli.maps.location:register", "list, add, remove and export the stored locations"),
    "goto": Verb("bridge.cli.navigation.goto:register", "drive to a place or a pose"),
    "waypoints": Verb("bridge.cli.navigation.servers:register_waypoints", "follow waypoints with Nav2's server"),
    "dock": Verb("bridge.cli.navigation.servers:register_dock", "dock the robot at a stored dock, or one of Nav2's"),
    "undock": Verb("bridge.cli.navigation.servers:register_undock", "move the robot out of its dock"),
    "nav": Verb(
        "bridge.cli.navigation.nav:register", "status, stop, pause, resume, path and show for the planner in use"
    ),
    "teleop": Verb("bridge.cli.navigation.teleop:register", "drive a base with the keyboard"),
    "halt": Verb("bridge.cli.navigation.halt:register", "publish zero velocity on every side and cancel all goals"),
    "yarp": Verb("bridge.cli.yarp_network.yarp:register", "inspect and use a YARP network, as YARP's own tool does"),
    "ros1": Verb("bridge.cli.ros1.ros1:register", "run a ROS 1 master, for machines without roscore"),
    "config": Verb(
        "bridge.cli.setup.config:register_config", "check a configuration file; print its schema or an example"
    ),
    "import": Verb("bridge.cli.setup.config:register_import", "convert another bridge's configuration to Midspan's"),
    "interfaces": Verb("bridge.cli.setup.interfaces:register", "build missing ROS 2 message packages"),
    "keys": Verb("bridge.cli.setup.keys:register", "make and show the certificates of a fleet's machines"),
    "install": Verb("bridge.cli.setup.install:register_install", "install the systemd services"),
    "demo": Verb("bridge.demo.command:register", "run a simulated robot that clients of every side send to rooms"),
    "completion": Verb("bridge.cli.setup.install:register_completion", "print a shell completion script"),
}


def build_parser(loaded: Collection[str], *, others: bool = True) -> argparse.ArgumentParser:
    """Return the parser of all commands; only those in ``loaded`` are imported, with their own arguments.

    Without the ``others``, it has only those, and is made in a fifth of the time.
    """
    parser = VerbParser(
        prog="midspan",
        description="A bridge daemon for mobile robots: it joins ROS 1, ROS 2, YARP and zenoh.",
        epilog="'midspan COMMAND --help' describes each command.",
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    parser.add_argument("--debug", action="store_true", help="show tracebacks (anywhere on the command line)")
    subparsers = parser.add_subparsers(metavar="COMMAND")
    for name, verb in VERBS.items():
        if name not in loaded and not others:
            continue
        verb_parser = subparsers.add_parser(name, help=verb.help)
        if name in loaded:
            module, _, function = verb.register.partition(":")
            getattr(importlib.import_module(module), function)(verb_parser)
    return parser


def _named_verb(arguments: Sequence[str]) -> list[str]:
    first = next((argument for argument in arguments if not argument.startswith("-")), "")
    return [first] if first in VERBS else []


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.encoding.lower() != "utf-8":
        # a Windows console may lack a character: show its escape sequence
        sys.stdout.reconfigure(errors="backslashreplace")
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in arguments  # anywhere, even after the command
    arguments = [argument for argument in arguments if argument != "--debug"]
    try:
        named = _named_verb(arguments)
        # options before the command may ask for the list of all commands
        parser = build_parser(named, others=not named or arguments[0] not in named)
        args = parser.parse_args(arguments)
        if args.version:
            return _version()
        if "run" not in args:
            parser.print_help(sys.stderr)
            return 2
        return _run(args)
    except KeyboardInterrupt as err:
        return getattr(err, "code", INTERRUPTED)  # `bridge.cli.graph.goal.Interrupted` has the code of its signal
    except BrokenPipeError:
        # the reader has closed the pipe, as `| head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as err:
        if debug:
            raise
        _complain(err)
        return FAILED


def _run(args: argparse.Namespace) -> int:
    code: int = args.run(args)
    sys.stdout.flush()  # raises here if the reader has closed the pipe
    return code


def _version() -> int:
    from importlib.metadata import PackageNotFoundError, version

    try:
        print(f"midspan {version('midspan')}")
    except PackageNotFoundError:
        print("midspan (not installed)")
    return 0


def _complain(err: Exception) -> None:
    from bridge.cli.output import system_error
    from bridge.client.errors import ClientError
    from bridge.config.document import ConfigError

    logging.getLogger("midspan").debug("command failed", exc_info=err)
    if isinstance(err, ConfigError):
        print(str(err), file=sys.stderr)
    elif isinstance(err, OSError) and str(err):
        print(f"midspan: {system_error(err)}", file=sys.stderr)
    elif isinstance(err, ClientError | RuntimeError) and str(err):
        print(f"midspan: {err}", file=sys.stderr)
    else:
        print(f"midspan: {type(err).__name__}: {err} (--debug shows where)", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
