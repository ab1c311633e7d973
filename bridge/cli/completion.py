"""``midspan completion``: prints a shell completion script."""

from __future__ import annotations

import argparse
import sys
from typing import Any

SHELLS = ("bash", "zsh", "fish")


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser = subparsers.add_parser(
        "completion",
        help="print a shell completion script",
        description="Print a completion script for a shell. bash: midspan completion bash >"
        " ~/.local/share/bash-completion/completions/midspan; zsh: into a folder of $fpath as _midspan; fish: into"
        " ~/.config/fish/completions/midspan.fish",
    )
    parser.add_argument("shell", choices=SHELLS, help="which shell")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    import shtab

    from bridge.cli.main import build_parser
    from bridge.cli.verbs import VERBS

    parser = build_parser(VERBS)
    sys.stdout.write(shtab.complete(parser, shell=args.shell) + "\n")
    return 0
