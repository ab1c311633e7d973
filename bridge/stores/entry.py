"""One key of the store: its name, its value, and who wrote it when, knowing what.

Names stand in zenoh keys as they are, and never become paths. A version's ``seen`` holds, for each replica, the latest
of its changes to this key that the writer knew of, itself among them. So two versions of a key can be told apart into
one that follows the other and two that were made apart, however many changes lie between (a version vector; Parker et
al., Detection of mutual inconsistency in distributed systems, 1983).
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


class StoreError(RuntimeError):
    """The store refuses or cannot do what it was asked; nothing has changed, and the text says why."""


def json_object(data: bytes, refusal: str = "it is not a JSON object") -> dict[str, Any]:
    """The JSON object in some bytes; raises `StoreError` with the text of the refusal where they hold none."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise StoreError(refusal)
    return value


MAX_NAME = 254  # bytes; YARP's longest name of a map (MapGrid2D::read)
_FORBIDDEN = frozenset("/\\*$?#%")
"""Separators of paths and keys, and what zenoh's key expressions and selectors use."""


def check_name(name: str) -> str:
    """Return a name that can stand in the store, or raise `StoreError`."""
    size = len(name.encode(errors="replace"))
    if not 0 < size <= MAX_NAME:
        msg = f"the name {name[:40]!r} has {size} bytes; a name has 1 to {MAX_NAME}"
    elif not name.isprintable():
        msg = f"the name {name!r} has characters that cannot be printed"
    elif forbidden := sorted(_FORBIDDEN & set(name)):
        msg = f"the name {name!r} has {' '.join(forbidden)}; a name has none of {' '.join(sorted(_FORBIDDEN))}"
    elif name[0] in "@." or name != name.strip():
        msg = f"the name {name!r} begins with @ or a dot, or has blanks at its ends"
    else:
        return name
    raise StoreError(msg)


MOST_SEEN = 32  # replicas that a version remembers; the longest silent ones are forgotten first
OLDEST = 1  # the time of what is imported: older than anything that was ever written
LATEST = (1 << 32) * 1_000_000_000
"""Nanoseconds since 1970 that a stamp stays below: what zenoh's 64-bit NTP time can hold."""


@dataclass(frozen=True, slots=True, order=True)
class ChangeStamp:
    """When a change was made, and by which replica; the order that decides which change holds."""

    ns: int
    replica: str


@dataclass(frozen=True, slots=True)
class Version:
    """One version of a key; ``origin`` is the daemon's name."""

    stamp: ChangeStamp
    origin: str
    seen: Mapping[str, int] = field(default_factory=dict)

    def knows(self, other: Version) -> bool:
        """Whether whoever wrote this version knew of the other one."""
        return self.seen.get(other.stamp.replica, -1) >= other.stamp.ns or self.stamp == other.stamp


@dataclass(frozen=True, slots=True)
class StoreEntry:
    """A key and one version of its value; ``body`` is None where it was deleted, ``encoding`` is zenoh's."""

    kind: str
    name: str
    body: bytes | None
    encoding: str
    version: Version

    @property
    def key(self) -> tuple[str, str]:
        """Kind and name."""
        return self.kind, self.name


def follow(before: Version | None, stamp: ChangeStamp, origin: str) -> Version:
    """The version that a replica writes over the one that it has."""
    seen = {} if before is None else {**before.seen, before.stamp.replica: before.stamp.ns}
    seen[stamp.replica] = stamp.ns
    latest = sorted(seen.items(), key=lambda item: item[1], reverse=True)[:MOST_SEEN]
    return Version(stamp, origin, dict(latest))


_MOST_TEXT = 300


@dataclass(frozen=True, slots=True)
class Conflict:
    """Two changes of one key of which neither knew of the other. The later holds."""

    holds: StoreEntry
    lost: StoreEntry

    def __str__(self) -> str:
        """For people, with what was lost, so that it can be put back by hand."""
        return (
            f"{self.lost.kind} {self.lost.name!r} was changed at {self.holds.version.origin} and at"
            f" {self.lost.version.origin} apart from each other; the later holds, of {self.holds.version.origin},"
            f" {_when(self.holds)}: {_what(self.holds)}; lost is that of {self.lost.version.origin},"
            f" {_when(self.lost)}: {_what(self.lost)}"
        )


def conflict(one: StoreEntry, other: StoreEntry) -> Conflict | None:
    """The conflict of two entries of one key, None where one followed the other or both say the same."""
    if one.version.knows(other.version) or other.version.knows(one.version) or one.body == other.body:
        return None
    if (one.version.stamp.ns == OLDEST) is not (other.version.stamp.ns == OLDEST):
        return None  # what was imported gives way to what was written
    lost, holds = sorted((one, other), key=lambda entry: entry.version.stamp)
    return Conflict(holds, lost)


def _when(entry: StoreEntry) -> str:
    seconds, nanoseconds = divmod(entry.version.stamp.ns, 1_000_000_000)
    return f"{time.strftime('%Y-%m-%d %H:%M:%S', time.gmtime(seconds))}.{nanoseconds // 1_000_000:03} UTC"


def _what(entry: StoreEntry) -> str:
    if entry.body is None:
        return "deleted"
    if entry.encoding.startswith("application/json"):
        text = json.dumps(entry.body.decode(errors="replace"), ensure_ascii=False)[1:-1].replace('\\"', '"')
        return text if len(text) <= _MOST_TEXT else f"{text[:_MOST_TEXT]}..."
    return f"{len(entry.body)} bytes"
