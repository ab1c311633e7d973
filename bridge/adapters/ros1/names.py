"""Maps topic names that ROS 1 allows and ROS 2 forbids to legal names on the hub, and back.

ROS 2's rule for a full topic name (rmw's validate_full_topic_name): absolute, letters, digits, ``_`` and ``/`` only, no
``//``, no trailing ``/``, no part that starts with a digit, at most 247 characters. ROS 1's masters enforce nothing,
and ROS 1's rule (rosgraph.names) allows parts that start with digits.

The mapping of an illegal name, part by part:

1. empty parts are removed (``//`` becomes ``/``, a trailing ``/`` is dropped), and a leading ``/`` is added if missing;
   a name without any other part becomes ``/_``;
2. every character other than ``[A-Za-z0-9_]`` becomes ``_``;
3. a part that starts with a digit is prefixed with ``n``: ``/camera/1/image`` becomes ``/camera/n1/image``;
4. a name that is still longer than 247 characters is cut, and ends in ``_`` and eight hex digits of its SHA-256.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping

MAX_LENGTH = 247
"""rmw's RMW_TOPIC_MAX_NAME_LENGTH."""

MAX_NAMES = 20000
"""Maximum number of illegal names in a `NameTable`; beyond it, names that have left the graph are dropped."""

_LEGAL = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_FORBIDDEN = re.compile(r"[^A-Za-z0-9_]")


def hub_name(side_name: str) -> str:
    """Return the hub's spelling of a ROS 1 topic name, by the mapping above."""
    if _LEGAL.fullmatch(side_name) and len(side_name) <= MAX_LENGTH:
        return side_name
    parts = [_FORBIDDEN.sub("_", part) for part in side_name.split("/") if part]
    name = "".join(f"/n{part}" if part[0].isdigit() else f"/{part}" for part in parts) or "/_"
    if len(name) > MAX_LENGTH:
        digest = hashlib.sha256(side_name.encode(errors="surrogatepass")).hexdigest()[:8]
        name = f"{name[: MAX_LENGTH - 9].rstrip('/')}_{digest}"
    return name


class NameTable:
    """Maps hub names back to ROS 1 names that are or were on the ROS 1 graph.

    A ROS 1 name that equals the hub name has precedence; otherwise the first name in alphabetical order is used. Names
    that are illegal on the hub stay in the table when they leave the graph, so that a topic keeps its name when its
    subscriber is restarted.
    """

    def __init__(self) -> None:
        self._listed: frozenset[str] = frozenset()
        self._renamed: dict[str, str] = {}
        self._unchanged: set[str] = set()
        self._side_names: Mapping[str, str] = {}

    def learn(self, side_names: Iterable[str]) -> None:
        """Update the names that are on the graph."""
        names, before = frozenset(side_names), self._listed
        self._listed = names
        new = names - before
        changed = {name: legal for name in new if (legal := hub_name(name)) != name}
        if len(self._renamed) + len(changed) > MAX_NAMES:
            self._renamed = {name: hub_name(name) for name in names if hub_name(name) != name}
            self._unchanged = set()
        else:
            self._renamed |= changed
        taken = names.intersection(self._renamed.values())
        if changed or not taken <= self._unchanged:
            self._unchanged |= taken
            back: dict[str, str] = {}
            for name in sorted(self._renamed):
                if self._renamed[name] not in self._unchanged:
                    back.setdefault(self._renamed[name], name)
            self._side_names = back

    def side_name(self, hub_name: str) -> str:
        """Return the ROS 1 spelling of a hub topic name; unchanged if no ROS 1 name was mapped to it."""
        return self._side_names.get(hub_name, hub_name)
