"""Merges texts with the same cause: twenty topics with the same problem become one line, which names some of them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

_NAME = re.compile(r"\w+://[^\s,;)]+|(?<![\w/.])/[\w/.~-]*[\w~]")
"""Names of topics, services, nodes and ports, and addresses; not types: ``std_msgs/String`` has no leading slash."""

_PLACE = "\0"
"""Stands for a name; unlike a glob such as ``/*``, it is in no text."""

_SHOWN = 5


def cause(text: str) -> str:
    """Return a text without the names in it: texts with the same result have the same cause."""
    return _NAME.sub(_PLACE, text)


def grouped(texts: Iterable[str]) -> list[str]:
    """Return one line for each cause, in the order of the texts."""
    groups: dict[str, list[str]] = {}
    for text in texts:
        groups.setdefault(cause(text), []).append(text)
    return [one_line(group) for group in groups.values()]


def one_line(texts: Sequence[str]) -> str:
    """Return texts of one cause as one line: the first of them, and the names by which the others differ."""
    first, *others = dict.fromkeys(texts)
    if not others:
        return first
    rows = [_NAME.findall(text) for text in (first, *others)]
    column = next(column for column, names in enumerate(zip(*rows, strict=True)) if len(set(names)) > 1)
    names = [name for name in dict.fromkeys(row[column] for row in rows) if name != rows[0][column]]
    return first + same_for(names)


def same_for(names: Sequence[str]) -> str:
    """Return the end of a line that also applies to other names; "" without any."""
    more = len(names) - _SHOWN
    shown = ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
    return f" (the same for {shown})" if names else ""


class Shared(NamedTuple):
    """A cause that several owners report, as one line."""

    line: str
    owners: Sequence[str]


def shared(texts: Mapping[str, Iterable[str]]) -> dict[str, Shared]:
    """Return what several owners report, by `cause`; ``texts`` are the reports by owner."""
    owners: dict[str, dict[str, list[str]]] = {}
    for owner, reported in texts.items():
        for text in reported:
            owners.setdefault(cause(text), {}).setdefault(owner, []).append(text)
    return {
        key: Shared(one_line([text for group in by_owner.values() for text in group]), list(by_owner))
        for key, by_owner in owners.items()
        if len(by_owner) > 1
    }
