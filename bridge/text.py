"""Formats texts for people: numbers with units, similar names, and sanitized text from the network."""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, TypeGuard

from bridge.sides import label

if TYPE_CHECKING:
    from rich.console import Console


_LARGEST = 1e15
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def side_name(side: object) -> str:
    """Return a side's name for people."""
    return label(str(side)) or clean(side)


def arrow(side: object, direction: object) -> str:
    """Return ``ROS 1 -> hub`` or ``hub -> ROS 2``."""
    return f"{side_name(side)} -> hub" if direction == "in" else f"hub -> {side_name(side)}"


def clean(value: object) -> str:
    """Sanitize text from the network for a terminal: replace control characters and unprintable characters."""
    return _CONTROL.sub("?", str(value)).replace("\n", " ").replace("\t", " ")


def is_number(value: object) -> TypeGuard[int | float]:
    """Return whether a value from the network is a finite number."""
    return isinstance(value, int | float) and abs(value) < _LARGEST


def duration(seconds: object) -> str:
    """Format a time: ``0.12 s``, ``4.5 s``, ``3 min``, ``2 h``, ``5 d``; ``-`` if unknown."""
    if not is_number(seconds):
        return "-"
    if seconds < 1:
        return f"{seconds:.2f} s"
    if seconds < 120:
        return f"{seconds:.1f} s"
    for size, unit in ((60, "min"), (3600, "h")):
        if seconds < 120 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds / 86400:.0f} d"


def size(count: object) -> str:
    """Format a size: ``340 B``, ``12 kB``, ``1.4 MB``; ``-`` if unknown."""
    if not is_number(count):
        return "-"
    value = float(count)
    for unit in ("B", "kB", "MB"):
        if value < 1000:
            return f"{value:.0f} {unit}" if unit == "B" or value >= 10 else f"{value:.1f} {unit}"
        value /= 1000
    return f"{value:.1f} GB"


def rate(value: object) -> str:
    """Format messages per second: ``9.8``, ``340``; ``-`` if zero or unknown."""
    if not is_number(value) or not value:
        return "-"
    return f"{value:.2g}" if value < 1 else f"{value:.1f}" if value < 100 else f"{value:.0f}"


def milliseconds(value: object) -> str:
    """Format milliseconds: ``0.31``, ``12``; ``-`` if unknown."""
    if not is_number(value):
        return "-"
    return f"{value:.2f}" if value < 10 else f"{value:.0f}"


def plural(count: int, noun: str) -> str:
    """Format a count with its noun: ``1 route``, ``3 routes``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def listed(names: Sequence[str], most: int = 10) -> str:
    """Return the first ``most`` names, and the number of the others, as text."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def near(name: str, names: Iterable[str], count: int = 3) -> list[str]:
    """Return up to ``count`` names that are similar to ``name``, most similar first."""
    known = sorted(set(names))
    inside = [n for n in known if name.strip("/") and name.strip("/").lower() in n.lower()]
    return list(dict.fromkeys([*difflib.get_close_matches(name, known, count, 0.6), *inside]))[:count]


_WIDE = 250
"""Columns for a pipe or file, so that nothing is truncated."""


def make_console() -> Console:
    """Return a console on standard output, with plain text unless that is a terminal."""
    from rich.console import Console  # many commands need no tables

    width = None if sys.stdout.isatty() else _WIDE
    return Console(file=sys.stdout, width=width, highlight=False, markup=False, emoji=False)
