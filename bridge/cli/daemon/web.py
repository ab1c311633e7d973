"""``midspan web``: prints or opens the console's address, and creates tokens for other machines."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING

from bridge.cli.arguments import add_config
from bridge.cli.output import CliError

if TYPE_CHECKING:
    from bridge.config.model import Config

_EPILOG = """\
examples:
  midspan web --open
  midspan web --token anna                # may drive
  midspan web --token hall --role watch   # may only watch
"""


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = "Prints the address of the console, the page on which people watch and drive the robot."
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add_config(parser)
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--open", action="store_true", help="open the console in this machine's browser")
    group.add_argument("--token", metavar="NAME", help="create a token for a person or a program, and print it once")
    parser.add_argument("--role", choices=["watch", "drive"], default="drive", help="role of the token (default drive)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print or open the address, or create a token; raises `CliError` if the console does not run."""
    if args.token is not None:
        return _make_token(args.token, args.role)
    from bridge.config.load import load
    from bridge.state_file import named

    config = named(load(args.config, client=True))
    address = _address(config)
    print(address, flush=True)
    if address.startswith("https:"):
        print(_access_hints(config), flush=True)
    if args.open:
        import webbrowser

        if not webbrowser.open(address):
            raise CliError("no browser found on this machine; open the address from another machine over 'ssh -L'")
    return 0


def _address(config: Config) -> str:
    from bridge.daemon.query import Phase, ask_daemon
    from bridge.web.section import WebSection

    if not config.section(WebSection).enabled:
        raise CliError("the console is disabled: set web.enabled in the configuration")
    daemon = ask_daemon(config)
    if daemon is None:
        raise CliError(f"no daemon named '{config.name}' runs here; start it with 'midspan run'")
    console = next((worker for worker in daemon.workers if worker.worker == "web"), None)
    if console is None:
        raise CliError("the daemon runs without a console: it has not loaded this configuration")
    address = re.match(r"https?://[^\s,]+", console.text)
    if console.phase != Phase.UP.value or address is None:
        raise CliError(f"the console is {console.phase}: {console.text}")
    return address[0]


def _access_hints(config: Config) -> str:
    from bridge.hub.security.external_router import key_files
    from bridge.web.section import WebSection

    section = config.section(WebSection)
    people = ", ".join(f"{name} ({token.role})" for name, token in section.tokens.items())
    hints = [
        f"- the browser must trust the authority: import {key_files(config).ca} there",
        f"- log in with a token of {people}" if people else "",
        "- or show a certificate of that authority" + _drivers(section.trusted),
        "- another token: midspan web --token NAME",
    ]
    return "\n".join(["To get in:", *filter(None, hints)])


def _drivers(trusted: tuple[str, ...]) -> str:
    return f"; these may drive: {', '.join(trusted)}" if trusted else ", to watch"


def _make_token(name: str, role: str) -> int:
    from pydantic import ValidationError

    from bridge.hub.security.tokens import new_token
    from bridge.web.section import WebSection

    token, digest = new_token()
    try:
        WebSection.model_validate({"tokens": {name: {"role": role, "sha256": digest}}})
    except ValidationError:
        raise CliError(f"{name!r} is not a name: letters, digits, '_' and '-', at most 63") from None
    print(f"The token of {name}; keep it like a password, it is shown only once:\n\n  {token}\n")
    print("In the configuration, which contains only its hash:\n")
    print(f'web:\n  tokens:\n    {name}: {{role: {role}, sha256: "{digest}"}}')
    return 0
