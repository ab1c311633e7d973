"""Where tables are written: the terminal's width where there is one, and whole lines where there is none."""

from __future__ import annotations

import json
import sys
from typing import Any

from rich.console import Console

_WIDE = 250
"""Columns where nobody looks at it directly (a pipe, a file): nothing is cut."""


def make_console() -> Console:
    """A console on the standard output; plain text unless that is a terminal."""
    width = None if sys.stdout.isatty() else _WIDE
    return Console(file=sys.stdout, width=width, highlight=False, markup=False, emoji=False)


def print_json(value: Any, *, lines: bool = False) -> None:
    """Write a value as JSON: indented, or on one line of its own."""
    print(json.dumps(value, indent=None if lines else 2, ensure_ascii=False), flush=True)
