"""The ROS 2 releases that a node may belong to, by what it announces.

No node announces its release. What it does announce excludes some: Humble has no type hashes, and only later releases
have certain types, or certain definitions of a type. Sources: the message packages of the releases (rosbags' stores of
types, ros2/rcl_interfaces), and rmw_zenoh_cpp 0.1.9 to 0.10.5 (`bridge.hub.wire.buffers`).
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum


class Release(IntEnum):
    """A release of ROS 2; the numbers are in order of time."""

    HUMBLE = 0
    IRON = 1
    JAZZY = 2
    KILTED = 3
    LYRICAL = 4

    def __str__(self) -> str:
        return self.name.capitalize()


Releases = frozenset[Release]

ALL: Releases = frozenset(Release)
WITHOUT_HASHES: Releases = frozenset({Release.HUMBLE})
WITH_HASHES = ALL - WITHOUT_HASHES

_BY_HASH: dict[str, dict[str, Releases]] = {
    "lifecycle_msgs/msg/TransitionEvent": {
        "RIHS01_d5f8873": frozenset({Release.IRON, Release.JAZZY, Release.KILTED}),
        "RIHS01_78b19e2": frozenset({Release.LYRICAL}),
    },
    "nav_msgs/msg/Goals": {"RIHS01_02305a5": frozenset({Release.KILTED, Release.LYRICAL})},
    "nav_msgs/msg/Trajectory": {"RIHS01_d3913ce": frozenset({Release.LYRICAL})},
    "rosgraph_msgs/msg/Graph": {"RIHS01_46e58f3": frozenset({Release.LYRICAL})},
}
_KEY = len("RIHS01_") + 7


def by_hash(type_name: str, type_hash: str) -> Releases:
    """Return the releases whose packages have this definition of a type; all with hashes if it excludes none."""
    return _BY_HASH.get(type_name, {}).get(type_hash[:_KEY], WITH_HASHES)


def common(announced: Iterable[Releases]) -> Releases:
    """Return the releases that all announcements of one node admit."""
    return ALL.intersection(*announced)


def release_text(releases: Releases) -> str:
    """Return the releases in words; "" if nothing, or everything, is excluded.

    Releases after the newest known one may announce the same, so a range that ends with it is open.
    """
    if not releases or releases == ALL:
        return ""
    names = sorted(releases)
    if names[-1] is max(Release):
        return f"{names[0]} or later"
    return " or ".join(map(str, names)) if len(names) < 3 else f"{names[0]} to {names[-1]}"
