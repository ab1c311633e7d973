"""One way for all verbs to describe themselves, and the arguments that many of them share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

Run = Callable[[argparse.Namespace], int]


def add_verb(
    verbs: Any, name: str, run: Run | None, text: str, description: str = "", *, example: str = "", hub: bool = True
) -> argparse.ArgumentParser:
    """Add a verb below another one, by default with the arguments that find the hub.

    ``text`` stands in the list of verbs, and is the description where there is no longer one.
    """
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=text,
        description=description or f"{text[0].upper()}{text[1:]}.",
        epilog=f"Example: {example}" if example else None,
    )
    if run is not None:
        parser.set_defaults(run=run)
    if hub:
        add_hub_arguments(parser)
    return parser


def add_verbs(parser: argparse.ArgumentParser, description: str, metavar: str = "VERB", **more: Any) -> Any:
    """Describe a verb that has verbs of its own; returns where they are added."""
    parser.description = description
    return parser.add_subparsers(metavar=metavar, required=True, **more)


def add_config(parser: argparse._ActionsContainer) -> None:
    """The configuration file."""
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration file (default: the daemon's)")


def add_hub_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments by which every verb finds the hub."""
    group = parser.add_argument_group("which hub")
    add_config(group)
    group.add_argument("--router", metavar="ENDPOINT", help="zenoh endpoint of the router, as tcp/192.168.1.4:7447")
    group.add_argument("--hub-domain", type=int, metavar="N", help="the hub's domain; default the configuration's")


def number_in(least: float, most: float) -> Callable[[str], float]:
    """The type of an argument that takes a number above 0 and within these limits."""

    def read(text: str) -> float:
        value = float(text)
        if not (value > 0 and least <= value <= most):
            raise argparse.ArgumentTypeError(f"{text} is not between {least:g} and {most:g}")
        return value

    return read
