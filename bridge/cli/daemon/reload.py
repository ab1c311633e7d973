"""``midspan reload``: makes the running daemon load its changed configuration."""

from __future__ import annotations

import argparse

from bridge.cli.arguments import add_config
from bridge.cli.output import CliError


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Makes the running daemon check and load its configuration file again, as SIGHUP does; only the workers that"
        " a change affects reload. If the file has a problem, the daemon keeps its running configuration."
    )
    add_config(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Reload the daemon; raises `CliError` if it does not run, or rejects its file."""
    from bridge.config.load import load
    from bridge.daemon.query import reload_daemon
    from bridge.doctor.daemon_state import daemon_state, state_candidates
    from bridge.state_file import named

    config = named(load(args.config))
    for candidate in state_candidates(config):
        rejected = reload_daemon(candidate)
        if rejected:
            raise CliError(f"the daemon {config.name} keeps its running configuration:\n{rejected}")
        if rejected is not None:
            print(f"the daemon {config.name} has loaded its configuration")
            return 0
    state = daemon_state(config)
    raise CliError(
        state.trouble or f"no daemon named {config.name} runs with the state folder {state_candidates(config)[0].state}"
    )
