"""``midspan ros1``: a ROS 1 master for machines without roscore."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

from bridge.cli.arguments import add_config, add_verb, add_verbs
from bridge.cli.output import CliError

if TYPE_CHECKING:
    from bridge.config.model import Config


def register(parser: argparse.ArgumentParser) -> None:
    actions = add_verbs(parser, "Runs parts of a ROS 1 system on machines without ROS 1.")
    master = add_verb(
        actions, "master", run_master, "run a ROS 1 master with parameters, as roscore does",
        "Runs a ROS 1 master in the foreground, until Ctrl-C; the options here override the configuration's ros1"
        " section. With 'ros1: {master: embedded}' the daemon runs a master itself.", hub=False,
    )  # fmt: skip
    add_config(master)
    master.add_argument(
        "-p", "--port", type=int, metavar="PORT", help="port, on the configured address (default 11311)"
    )
    master.add_argument(
        "--listen", metavar="ADDRESS:PORT", help="address to listen on; with 0.0.0.0, other machines can connect"
    )
    master.add_argument("--purge", type=float, metavar="SECONDS", help="remove a dead node after this time; 0: never")
    master.add_argument("--forget", action="store_true", help="forget the nodes and parameters of the previous run")


def run_master(args: argparse.Namespace) -> int:
    """Run the master until it is asked to stop."""
    from bridge.adapters.ros1.master.worker import state_file
    from bridge.cli.daemon.run import run_alone
    from bridge.daemon.workers import worker_kinds

    config = _config(args)
    if args.forget:
        state_file(config).unlink(missing_ok=True)
    kind = replace(worker_kinds()["ros1_master"], factory="bridge.adapters.ros1.master.worker:create_stoppable")
    print(f"ROS_MASTER_URI={config.ros1.embedded_uri}", flush=True)
    return run_alone(kind, config, lambda: _config(args))


def _config(args: argparse.Namespace) -> Config:
    from bridge.config.load import load
    from bridge.config.sections.ros import Ros1Section
    from bridge.state_file import with_state

    config = with_state(load(args.config))
    listen = args.listen or config.ros1.listen
    if args.port is not None:
        listen = f"{listen.rpartition(':')[0]}:{args.port}"
    purge = config.ros1.purge if args.purge is None else args.purge
    options = {"master": "embedded", "listen": listen, "purge": purge}
    try:
        section = Ros1Section.model_validate({**config.ros1.model_dump(), **options})
    except ValueError as err:
        raise CliError(str(err)) from None
    return config.model_copy(update={"ros1": section})
