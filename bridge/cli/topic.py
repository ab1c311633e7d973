"""``midspan topic``: list, info, echo, hz and pub on any topic, whichever side it lives on."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.cli import topic_echo, topic_hz, topic_info, topic_list, topic_pub

_VERBS = {"list": topic_list, "info": topic_info, "echo": topic_echo, "hz": topic_hz, "pub": topic_pub}


def register(subparsers: Any) -> None:
    """Add the verb's parser, and one for each of its own verbs."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "topic",
        help="list, info, echo, hz and pub on any side's topics",
        description="Looks at topics and publishes on them, whichever side they live on. What crosses is heard on the"
        " hub; what does not cross (private to a side, or denied by a rule) is asked of the worker of its side.",
    )
    verbs = parser.add_subparsers(dest="topic_verb", metavar="VERB", required=True)
    for module in _VERBS.values():
        module.register(verbs)


def run(args: argparse.Namespace) -> int:
    """Run one of the topic verbs."""
    code: int = _VERBS[args.topic_verb].run(args)
    return code
