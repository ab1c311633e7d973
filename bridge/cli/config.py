"""``midspan config``: checks a configuration file, and prints what is generated from the model."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser = subparsers.add_parser(
        "config",
        help="check a configuration file; print its schema or an example",
        description="Check a configuration file, or print what helps to write one.",
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    check = actions.add_parser(
        "check",
        help="check a file and name every problem",
        description="Check a file: every problem with its line, column and cure.",
    )
    check.add_argument("file", type=Path, nargs="?", metavar="FILE", help="the file (default: where one is found)")
    check.add_argument("--json", action="store_true", help="print JSON")
    actions.add_parser(
        "schema", help="print the JSON schema, for editors", description="Print the JSON schema, for editors."
    )
    actions.add_parser(
        "example",
        help="print a file with all keys at their defaults",
        description="Print a file with all keys at their defaults and what each does.",
    )
    actions.add_parser(
        "reference",
        help="print the reference page (Markdown)",
        description="Print the reference page in Markdown, as in docs/config.md.",
    )


def run(args: argparse.Namespace) -> int:
    """Check or print."""
    if args.action == "check":
        return _check(args.file, as_json=args.json)
    from bridge.config import generate

    text = {"schema": generate.schema, "example": generate.example, "reference": generate.reference}[args.action]()
    sys.stdout.write(text)
    return 0


def _check(file: Path | None, *, as_json: bool) -> int:
    from bridge.config.load import find, load
    from bridge.config.problems import ConfigError

    used = file if file is not None else find()
    problems: list[dict[str, Any]] = []
    try:
        load(used)
    except ConfigError as err:
        problems = [
            {"file": str(p.file), "line": p.line, "column": p.column, "key": p.key, "text": p.text}
            for p in err.problems
        ]
        if not as_json:
            print(err, file=sys.stderr)
    if as_json:
        print(json.dumps({"file": None if used is None else str(used), "problems": problems}, indent=2))
    elif not problems:
        print(f"{used}: no problem" if used is not None else "no file found: the defaults are used")
    return 1 if problems else 0
