"""``midspan map``: list, show, import, export, edit-flags and use of the maps in the store."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.cli import map_files, map_flags, map_list, map_show

_VERBS = {
    "list": map_list.run_list,
    "use": map_list.run_use,
    "show": map_show.run,
    "import": map_files.run_import,
    "export": map_files.run_export,
    "edit-flags": map_flags.run,
}


def register(subparsers: Any) -> None:
    """Add the verb's parser, and one for each of its own verbs."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "map",
        help="list, show, import, export, edit-flags and use of the stored maps",
        description="Looks at the maps in the store that all daemons of a deployment share, and changes them.",
    )
    verbs = parser.add_subparsers(dest="map_verb", metavar="VERB", required=True)
    map_list.register(verbs)
    map_show.register(verbs)
    map_files.register(verbs)
    map_flags.register(verbs)


def run(args: argparse.Namespace) -> int:
    """Run one of the verbs."""
    return _VERBS[args.map_verb](args)
