"""``midspan import``: another bridge's configuration, turned into ours.

Exit codes: 0 everything is carried over, 3 written but something has no counterpart, 1 the file is broken.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bridge.config.importers.draft import Draft
    from bridge.config.problems import Problem

NOT_ALL = 3


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser = subparsers.add_parser(
        "import",
        help="turn another bridge's configuration into ours",
        description="Turn another bridge's configuration into Midspan's. What has no counterpart is named by its line,"
        " on the standard error and in the file that is made. Exit code 3 where there is such.",
    )
    peers = parser.add_subparsers(dest="peer", metavar="BRIDGE", required=True)
    ros1 = peers.add_parser(
        "ros1_bridge",
        help="the parameter file of ros1_bridge's parameter_bridge",
        description="Turn the parameter file of ros1_bridge's parameter_bridge into a configuration.",
    )
    ros1.add_argument(
        "--mapping-rules", type=Path, action="append", default=[], metavar="RULES",
        help="a mapping-rule file that the bridge was built with; Midspan reads it as it is (may be repeated)",
    )  # fmt: skip
    domain = peers.add_parser(
        "domain_bridge",
        help="domain_bridge's file: one configuration for each domain",
        description="Turn domain_bridge's file into one configuration for each of its domains.",
    )
    for peer, what, meta in ((ros1, "file", "FILE"), (domain, "folder", "FOLDER")):
        peer.add_argument("file", type=Path, metavar="FILE", help="the other bridge's file")
        peer.add_argument("-o", "--output", type=Path, metavar=meta, help=f"the {what} to write to (default: print)")
        peer.add_argument("--force", action="store_true", help="overwrite what is there")


def run(args: argparse.Namespace) -> int:
    """Import."""
    drafts, notes = _drafts(args)
    _check(drafts)
    if args.output is None:
        sys.stdout.write("---\n".join(draft.text() for draft in drafts))
    else:
        files = [args.output] if args.peer == "ros1_bridge" else [args.output / f"{d.name}.yaml" for d in drafts]
        _write(drafts, files, force=args.force)
    for note in notes:
        print(note, file=sys.stderr)
    if len(drafts) > 1 and args.output is None:
        print(f"{len(drafts)} configurations, one for each domain: -o FOLDER writes them", file=sys.stderr)
    return NOT_ALL if notes else 0


def _drafts(args: argparse.Namespace) -> tuple[Sequence[Draft], Sequence[Problem]]:
    if args.peer == "ros1_bridge":
        from bridge.config.importers import ros1_bridge
        from bridge.messages.rules import load_rules

        for rules in args.mapping_rules:
            load_rules(rules)
        draft, notes = ros1_bridge.draft(args.file, args.mapping_rules)
        return [draft], notes
    from bridge.config.importers import domain_bridge

    return domain_bridge.drafts(args.file)


def _check(drafts: Sequence[Draft]) -> None:
    from bridge.config.load import loads

    for draft in drafts:
        loads(draft.text(), Path(f"{draft.name}.yaml"))


def _write(drafts: Sequence[Draft], files: Sequence[Path], *, force: bool) -> None:
    from bridge.cli.errors import CliError

    there = [str(file) for file in files if file.exists()]
    if there and not force:
        msg = f"{', '.join(there)} is there already; --force overwrites"
        raise CliError(msg)
    for draft, file in zip(drafts, files, strict=True):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(draft.text(), encoding="utf-8")
        print(file)
