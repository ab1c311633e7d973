"""One key of the store: its name, its value, and its version (who wrote it, when, and based on what).

Names are used in zenoh keys unchanged, and never become paths. A version's ``seen`` has, for each replica, the stamp of
the replica's latest change to this key that the writer knew of, including this change. It distinguishes a version that
follows another from a concurrent one, however many changes lie between (a version vector; Parker et al., Detection of
mutual inconsistency in distributed systems, 1983).
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from typing_extensions import override


class StoreError(RuntimeError):
    """The store refuses an operation or cannot perform it; nothing has changed, and the text is the reason."""


def json_object(data: bytes, refusal: str = "it is not a JSON object") -> dict[str, Any]:
    """Parse a JSON object; raises `StoreError` with the text ``refusal`` if the bytes are not a JSON object."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise StoreError(refusal)
    return value


MAX_NAME = 254  # bytes; YARP's longest name of a map (MapGrid2D::read)
_FORBIDDEN = frozenset("/\\*$?#%")
"""Separators of paths and keys, and characters of zenoh's key expressions and selectors."""


def check_name(name: str) -> str:
    """Return the name if it is valid in the store, else raise `StoreError`."""
    size = len(name.encode(errors="replace"))
    if not 0 < size <= MAX_NAME:
        msg = f"the name {name[:40]!r} has {size} bytes; a name has 1 to {MAX_NAME}"
    elif not name.isprintable():
        msg = f"the name {name!r} has unprintable characters"
    elif forbidden := sorted(_FORBIDDEN & set(name)):
        msg = f"the name {name!r} has {' '.join(forbidden)}; a name has none of {' '.join(sorted(_FORBIDDEN))}"
    elif name[0] in "@." or name != name.strip():
        msg = f"the name {name!r} starts with @ or a dot, or has spaces at its ends"
    else:
        return name
    raise StoreError(msg)


MOST_SEEN = 32  # replicas listed in a version; those with the oldest changes are dropped first
OLDEST = 1  # the stamp of imported values, which is older than the stamp of any written value
LATEST = (1 << 32) * 1_000_000_000
"""Upper bound of a stamp, in nanoseconds since 1970: the limit of zenoh's 64-bit NTP time."""


@dataclass(frozen=True, slots=True, order=True)
class ChangeStamp:
    """When, and by which replica, a change was made. The later stamp wins."""

    ns: int
    replica: str


@dataclass(frozen=True, slots=True)
class Version:
    """One version of a key; ``origin`` is the name of the daemon that wrote it."""

    stamp: ChangeStamp
    origin: str
    seen: Mapping[str, int] = field(default_factory=dict)

    def has_seen(self, other: Version) -> bool:
        """Return whether the writer of this version knew of the other version."""
        return self.seen.get(other.stamp.replica, -1) >= other.stamp.ns or self.stamp == other.stamp


@dataclass(frozen=True, slots=True)
class StoreEntry:
    """A key and one version of its value; ``body`` is None if it was deleted, ``encoding`` is a zenoh encoding."""

    kind: str
    name: str
    body: bytes | None
    encoding: str
    version: Version

    @property
    def key(self) -> tuple[str, str]:
        """Return kind and name."""
        return self.kind, self.name


def follow(before: Version | None, stamp: ChangeStamp, origin: str) -> Version:
    """Return the version for a replica's change to a key whose current version is ``before``."""
    seen = {} if before is None else {**before.seen, before.stamp.replica: before.stamp.ns}
    seen[stamp.replica] = stamp.ns
    latest = sorted(seen.items(), key=lambda item: item[1], reverse=True)[:MOST_SEEN]
    return Version(stamp, origin, dict(latest))


_MOST_TEXT = 300


@dataclass(frozen=True, slots=True)
class Conflict:
    """Two concurrent changes of one key; the later change wins."""

    winner: StoreEntry
    lost: StoreEntry

    @override
    def __str__(self) -> str:
        """Describe the conflict with the lost value, so that it can be restored by hand."""
        return (
            f"{self.lost.kind} {self.lost.name!r} was changed at {self.winner.version.origin} and at"
            f" {self.lost.version.origin} concurrently; the later change wins: {self.winner.version.origin},"
            f" {_when(self.winner)}: {_what(self.winner)}; the other is lost: {self.lost.version.origin},"
            f" {_when(self.lost)}: {_what(self.lost)}"
        )


def conflict(first: StoreEntry, other: StoreEntry) -> Conflict | None:
    """Return the conflict of two entries of one key; None if one version follows the other, or the values are equal."""
    if first.version.has_seen(other.version) or other.version.has_seen(first.version) or first.body == other.body:
        return None
    if (first.version.stamp.ns == OLDEST) is not (other.version.stamp.ns == OLDEST):
        return None  # a written value replaces an imported one
    lost, winner = sorted((first, other), key=lambda entry: entry.version.stamp)
    return Conflict(winner, lost)


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
