"""The ROS 2 releases that a node may belong to, by what it announces.

No node announces its release. What it does announce excludes some releases: Humble has no type hashes, and only later
releases have certain types, or certain definitions of a type (`bridge.messages.definitions.versions`). On the hub,
tokens differ too (`bridge.hub.graph.releases`).
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from functools import cache

from typing_extensions import override

from bridge.messages.definitions.versions import ReleaseTypes


class Release(IntEnum):
    """A release of ROS 2; the numbers are in order of time."""

    HUMBLE = 0
    IRON = 1
    JAZZY = 2
    KILTED = 3
    LYRICAL = 4

    @override
    def __str__(self) -> str:
        return self.name.capitalize()


Releases = frozenset[Release]

ALL: Releases = frozenset(Release)
WITHOUT_HASHES: Releases = frozenset({Release.HUMBLE})
WITH_HASHES = ALL - WITHOUT_HASHES

_EARLIER = {"jazzy": frozenset({Release.IRON, Release.JAZZY})}
"""The releases that a definition of Jazzy may belong to, because Midspan does not have the definitions of Iron."""

_types = cache(ReleaseTypes)


def by_hash(type_name: str, type_hash: str) -> Releases:
    """Return the releases with this definition of a type; all with hashes if it is the same in all, or unknown."""
    named = (_EARLIER.get(name) or {Release[name.upper()]} for name in _types().with_hash(type_name, type_hash))
    return frozenset().union(*named) or WITH_HASHES


def common(announced: Iterable[Releases]) -> Releases:
    """Return the releases that no announcement of one node excludes."""
    return ALL.intersection(*announced)


def release_text(releases: Releases) -> str:
    """Return the releases in words; "" if none or all of them are excluded.

    Releases after the newest known one may announce the same, so a range that ends with it is open.
    """
    if not releases or releases == ALL:
        return ""
    names = sorted(releases)
    if names[-1] is max(Release):
        return f"{names[0]} or later"
    return " or ".join(map(str, names)) if len(names) < 3 else f"{names[0]} to {names[-1]}"
