"""``midspan location``: list, add, remove and export of the locations, areas, paths, objects and links in the store."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.cli import location_add, location_export, location_list

_VERBS = {
    "list": location_list.run_list,
    "add": location_add.run,
    "remove": location_list.run_remove,
    "export": location_export.run,
}


def register(subparsers: Any) -> None:
    """Add the verb's parser, and one for each of its own verbs."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "location",
        help="list, add, remove and export of the stored locations",
        description="Looks at the locations in the store that all daemons of a deployment share, at areas, paths,"
        " objects and links besides, and changes them. 'midspan map import' brings them in from files.",
    )
    verbs = parser.add_subparsers(dest="location_verb", metavar="VERB", required=True)
    location_list.register(verbs)
    location_add.register(verbs)
    location_export.register(verbs)


def run(args: argparse.Namespace) -> int:
    """Run one of the verbs."""
    return _VERBS[args.location_verb](args)
