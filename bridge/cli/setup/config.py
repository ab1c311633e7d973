"""``midspan config`` and ``midspan import``: check and update configuration files, and convert other bridges' files."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.cli.arguments import add_verb, add_verbs

if TYPE_CHECKING:
    from bridge.config.document import Problem
    from bridge.config.importers.draft import Draft


def register_config(parser: argparse.ArgumentParser) -> None:
    actions = add_verbs(parser, "Checks a configuration file, or prints examples and references.", dest="action")
    check = add_verb(actions, "check", run_config, "check a file; report every problem with place and cure", hub=False)
    check.add_argument("file", type=Path, nargs="?", metavar="FILE", help="the file (default: the daemon's)")
    check.add_argument("--json", action="store_true", help="print JSON")
    migrate = add_verb(
        actions, "migrate", run_migrate, "update an older file to the current keys, and keep its comments", hub=False
    )
    migrate.add_argument("file", type=Path, nargs="?", metavar="FILE", help="the file (default: the daemon's)")
    migrate.add_argument("--print", action="store_true", help="print the new text without changing the file")
    for name, text in (
        ("schema", "print the JSON schema, for editors"),
        ("example", "print a file with all keys, their defaults and descriptions"),
        ("reference", "print the reference page in Markdown, as in docs/operate/config.md"),
    ):
        add_verb(actions, name, run_config, text, hub=False)


def run_config(args: argparse.Namespace) -> int:
    if args.action == "check":
        return _check_file(args.file, as_json=args.json)
    from bridge.config import generate

    text = {"schema": generate.schema, "example": generate.example, "reference": generate.reference}[args.action]()
    sys.stdout.write(text)
    return 0


def _check_file(file: Path | None, *, as_json: bool) -> int:
    from bridge.config.document import ConfigError
    from bridge.config.load import find, load

    used = file if file is not None else find()
    problems: list[dict[str, Any]] = []
    try:
        load(used)
    except ConfigError as err:
        problems = [{**dataclasses.asdict(problem), "file": str(problem.file)} for problem in err.problems]
        if not as_json:
            print(err, file=sys.stderr)
    if as_json:
        print(json.dumps({"file": None if used is None else str(used), "problems": problems}, indent=2))
    elif not problems:
        print(f"{used}: no problem" if used is not None else "no file found: the defaults are used")
    return 1 if problems else 0


NOT_ALL = 3


def run_migrate(args: argparse.Namespace) -> int:
    """Migrate the file, and save the former text next to it."""
    from bridge.cli.output import CliError
    from bridge.config.document import ConfigError, text_of
    from bridge.config.load import find, loads
    from bridge.config.migrate import migrate

    file = args.file if args.file is not None else find()
    if file is None:
        raise CliError("no file found: the defaults are used, nothing to migrate")
    before = text_of(file)
    migration = migrate(before, file)
    if args.print:
        sys.stdout.write(migration.text)
    elif migration.text == before:
        print(f"{file}: already has the current format")
    else:
        _replace_file(file, migration.text)
    for done in migration.done:
        print(f"{file}: {done}", file=sys.stderr)
    left: list[Problem] = [*migration.left]
    try:
        loads(migration.text, file)
    except ConfigError as err:
        left += err.problems
    for problem in left:
        print(problem, file=sys.stderr)
    return NOT_ALL if left else 0


def _replace_file(file: Path, text: str) -> None:
    """Write a file's new text atomically; the former file stays as ``<name>.old``."""
    from bridge.cli.output import CliError

    file = file.resolve()
    old, new = (file.with_name(f"{file.name}.{end}") for end in ("old", "new"))
    if old.exists():
        raise CliError(f"{old} already exists from an earlier migration; move it away")
    new.write_text(text, encoding="utf-8", newline="")
    shutil.copymode(file, new)
    with contextlib.suppress(AttributeError, PermissionError):  # Windows lacks chown; elsewhere only root may use it
        os.chown(new, file.stat().st_uid, file.stat().st_gid)
    shutil.copy2(file, old)
    new.replace(file)
    print(f"{file}: migrated; the former text is kept in {old}")


def register_import(parser: argparse.ArgumentParser) -> None:
    peers = add_verbs(
        parser,
        "Converts another bridge's configuration. Entries without a counterpart are reported with their line numbers,"
        " on standard error and in the new file; in that case the exit code is 3.",
        "BRIDGE",
        dest="peer",
    )
    ros1 = add_verb(
        peers, "ros1_bridge", run_import, "convert the parameter file of ros1_bridge's parameter_bridge", hub=False
    )
    ros1.add_argument(
        "--mapping-rules", type=Path, action="append", default=[], metavar="RULES",
        help="a mapping-rule file with which the bridge was built; Midspan reads it unchanged; may be repeated",
    )  # fmt: skip
    domain = add_verb(
        peers, "domain_bridge", run_import, "convert domain_bridge's file, to one configuration per domain", hub=False
    )
    for peer, kind, meta in ((ros1, "file", "FILE"), (domain, "folder", "FOLDER")):
        peer.add_argument("file", type=Path, metavar="FILE", help="the other bridge's file")
        peer.add_argument("-o", "--output", type=Path, metavar=meta, help=f"the {kind} to write to (default: print)")
        peer.add_argument("--force", action="store_true", help="overwrite existing files")


def run_import(args: argparse.Namespace) -> int:
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
        print(f"{len(drafts)} configurations, one for each domain; -o FOLDER writes them to files", file=sys.stderr)
    return NOT_ALL if notes else 0


def _drafts(args: argparse.Namespace) -> tuple[Sequence[Draft], Sequence[Problem]]:
    if args.peer == "ros1_bridge":
        from bridge.config.importers import ros1_bridge
        from bridge.messages.mapping.rules import load_rules

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
    from bridge.cli.output import CliError

    existing = [str(file) for file in files if file.exists()]
    if existing and not force:
        raise CliError(f"{', '.join(existing)}: file exists; --force overwrites")
    for draft, file in zip(drafts, files, strict=True):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(draft.text(), encoding="utf-8")
        print(file)
