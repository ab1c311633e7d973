"""One key of the store: its value, and who wrote it when, knowing what.

A version's ``seen`` tells, for each replica, the latest of its changes to this key that the writer knew of, itself
among them. So two versions of a key can be told apart into one that follows the other and two that were made apart,
however many changes lie between (a version vector; Parker et al., Detection of mutual inconsistency in distributed
systems, 1983).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

MOST_SEEN = 32
"""Replicas that a version remembers; the longest silent ones are forgotten first."""

OLDEST = 1
"""The time of what is imported: older than anything that was ever written."""

LATEST = (1 << 32) * 1_000_000_000
"""Nanoseconds since 1970 that a stamp stays below: what zenoh's 64-bit NTP time can tell."""


@dataclass(frozen=True, slots=True, order=True)
class Stamp:
    """When a change was made, and by which replica; the order that decides which change holds.

    Attributes:
        ns: nanoseconds since 1970.
        replica: the replica's id, hexadecimal.
    """

    ns: int
    replica: str


@dataclass(frozen=True, slots=True)
class Version:
    """One version of a key.

    Attributes:
        stamp: when and by which replica it was written.
        origin: the daemon's name, for people.
        seen: see above.
    """

    stamp: Stamp
    origin: str
    seen: Mapping[str, int] = field(default_factory=dict)

    def knows(self, other: Version) -> bool:
        """Whether whoever wrote this version knew of the other one."""
        return self.seen.get(other.stamp.replica, -1) >= other.stamp.ns or self.stamp == other.stamp


@dataclass(frozen=True, slots=True)
class Entry:
    """A key and one version of its value.

    Attributes:
        kind: what it is, ``location`` for example.
        name: its own name within the kind.
        body: the value's bytes; None where it was deleted.
        encoding: of the body, as zenoh spells it.
    """

    kind: str
    name: str
    body: bytes | None
    encoding: str
    version: Version

    @property
    def key(self) -> tuple[str, str]:
        """Kind and name."""
        return self.kind, self.name


def follow(before: Version | None, stamp: Stamp, origin: str) -> Version:
    """The version that a replica writes over the one that it has."""
    seen = {} if before is None else {**before.seen, before.stamp.replica: before.stamp.ns}
    seen[stamp.replica] = stamp.ns
    latest = sorted(seen.items(), key=lambda item: item[1], reverse=True)[:MOST_SEEN]
    return Version(stamp, origin, dict(latest))
