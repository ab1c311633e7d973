"""``midspan install``: puts the systemd services in place, or takes them away."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from typing import Any

from bridge.cli.errors import CliError

DEFAULT_USER = "midspan"


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser = subparsers.add_parser(
        "install",
        help="put the systemd services in place",
        description="Put the systemd units, a first configuration and the services' user in place. Files of your own in"
        " /etc/midspan are never overwritten or removed. No command is run: what to do next is printed.",
    )
    parser.add_argument(
        "--root", "--prefix", type=Path, default=Path("/"), metavar="DIR", help="install below this folder (default: /)"
    )
    parser.add_argument(
        "--user", default=DEFAULT_USER, metavar="NAME", help=f"user of the services (default: {DEFAULT_USER}, made new)"
    )
    parser.add_argument("--dry-run", action="store_true", help="say what would be done, and do nothing")
    parser.add_argument("--uninstall", action="store_true", help="take the services away again")


def run(args: argparse.Namespace) -> int:
    """Install or uninstall."""
    from bridge.daemon.install import Installation

    if not sys.platform.startswith("linux"):
        raise CliError("systemd services are Linux's; here, start 'midspan run' by what this system has for services")
    if not re.fullmatch(r"[a-z_][a-z0-9_-]{0,31}", args.user):
        msg = f"'{args.user}' is not a user's name"
        raise CliError(msg)
    installation = Installation(args.root, args.user, dry_run=args.dry_run)
    try:
        lines = installation.uninstall() if args.uninstall else installation.install()
    except PermissionError as err:
        msg = f"{err.filename}: permission denied; run it as root (sudo)"
        raise CliError(msg) from err
    print("\n".join(lines))
    return 0
