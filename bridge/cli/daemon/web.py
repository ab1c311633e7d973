"""``midspan web``: the address of the console, or the console in a browser."""

from __future__ import annotations

import argparse
import re

from bridge.cli.arguments import add_config
from bridge.cli.output import CliError


def register(parser: argparse.ArgumentParser) -> None:
    """Describe the verb and its arguments."""
    parser.description = "Prints the address of the console, the page on which people watch and drive."
    parser.epilog = "Example: midspan web --open"
    add_config(parser)
    parser.add_argument("--open", action="store_true", help="open it in this machine's browser")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print or open the address; raises `CliError` where the console does not run."""
    from bridge.config.load import load
    from bridge.daemon.query import Phase, ask_daemon

    config = load(args.config)
    if not config.web.enabled:
        raise CliError("the console is switched off: set web.enabled in the configuration")
    workers = (ask_daemon(config) or {}).get("workers")
    if workers is None:
        raise CliError(f"no daemon of the name '{config.name}' runs here; start it with 'midspan run'")
    console = next((worker for worker in workers if worker["worker"] == "web"), None)
    if console is None:
        raise CliError("the daemon runs without a console: it has not taken up this configuration")
    address = re.match(r"http://[^\s,]+", console["text"])
    if console["phase"] != Phase.UP.value or address is None:
        raise CliError(f"the console is {console['phase']}: {console['text']}")
    print(address[0], flush=True)
    if args.open:
        import webbrowser

        if not webbrowser.open(address[0]):
            raise CliError("there is no browser on this machine; open the address from elsewhere over 'ssh -L'")
    return 0
