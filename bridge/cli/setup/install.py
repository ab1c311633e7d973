"""``midspan install`` puts the systemd services in place; ``midspan completion`` prints a shell's script."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from bridge.cli.output import CliError

DEFAULT_USER = "midspan"


def register_install(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Puts the systemd units, a first configuration and the services' user in place: midspan, and midspan@NAME for"
        " further daemons with /etc/midspan/NAME.yaml. Never overwrites or removes your files in /etc/midspan. Runs no"
        " command, and prints what to do next."
    )
    parser.add_argument(
        "--root", "--prefix", type=Path, default=Path("/"), metavar="DIR", help="install below this folder (default: /)"
    )
    parser.add_argument(
        "--user", default=DEFAULT_USER, metavar="NAME", help=f"user of the services (default: {DEFAULT_USER}, created)"
    )
    parser.add_argument("--dry-run", action="store_true", help="print what would be done, and do nothing")
    parser.add_argument("--uninstall", action="store_true", help="remove the services")
    parser.set_defaults(run=run_install)


def run_install(args: argparse.Namespace) -> int:
    from bridge.daemon.install import Installation

    if not sys.platform.startswith("linux"):
        raise CliError("systemd exists only on Linux; start 'midspan run' with this system's own service manager")
    if not re.fullmatch(r"[a-z_][a-z0-9_-]{0,31}", args.user):
        raise CliError(f"'{args.user}' is not a user name")
    installation = Installation(args.root, args.user, dry_run=args.dry_run)
    try:
        lines = installation.uninstall() if args.uninstall else installation.install()
    except PermissionError as err:
        raise CliError(f"{err.filename}: permission denied; run it as root (sudo)") from err
    print("\n".join(lines))
    return 0


SHELLS = ("bash", "zsh", "fish")


def register_completion(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Prints a completion script for a shell. bash: midspan completion bash >"
        " ~/.local/share/bash-completion/completions/midspan; zsh: into a folder of $fpath as _midspan; fish: into"
        " ~/.config/fish/completions/midspan.fish"
    )
    parser.add_argument("shell", choices=SHELLS, help="the shell")
    parser.set_defaults(run=run_completion)


def run_completion(args: argparse.Namespace) -> int:
    import shtab

    from bridge.cli.main import VERBS, build_parser

    parser = build_parser(VERBS)
    sys.stdout.write(shtab.complete(parser, shell=args.shell) + "\n")
    return 0
