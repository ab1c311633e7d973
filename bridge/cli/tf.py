"""``midspan tf``: the frames of all sides: list, tree, echo and monitor."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.cli import tf_echo, tf_monitor, tf_tree

_VERBS = {"list": tf_tree.run_list, "tree": tf_tree.run_tree, "echo": tf_echo.run, "monitor": tf_monitor.run}


def register(subparsers: Any) -> None:
    """Add the verb's parser, and one for each of its own verbs."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "tf",
        help="list, tree, echo and monitor of frames",
        description="Looks at the frames that are told on /tf and /tf_static, whichever side they come from. It hears"
        " the topics itself and needs no module.",
    )
    verbs = parser.add_subparsers(dest="tf_verb", metavar="VERB", required=True)
    tf_tree.register(verbs)
    tf_echo.register(verbs)
    tf_monitor.register(verbs)


def run(args: argparse.Namespace) -> int:
    """Run one of the verbs."""
    return _VERBS[args.tf_verb](args)
