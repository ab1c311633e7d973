"""The numbers of a publisher's samples, in C if possible (``links.c``)."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

try:
    from bridge.hub.lane.links import Epoch, Link, Sender, flush, join
except ImportError:  # there was no compiler, or the system has no lanes
    if not TYPE_CHECKING:
        Link = flush = join = None

        class Epoch:
            """A number that changes with the graph."""

            def __init__(self) -> None:
                self.value = 0
                self._values = itertools.count(1)

            def renew(self) -> None:
                """Begin a new epoch; safe in any thread."""
                self.value = next(self._values)

        class Sender:
            """A publisher's numbers, and whether a put would reach a subscriber on zenoh."""

            def __init__(self, _gid: bytes, epoch: Epoch) -> None:
                self._epoch, self._quiet = epoch, (-1, -1)
                self.sequence = self.by_lane = self.matches = 0
                self.direct = self.busy = False

            def next(self) -> int:
                """Return the next number."""
                self.sequence += 1
                return self.sequence

            def send_to(self, links: object) -> None:
                """Set the links."""

            def match(self) -> None:
                """Note that a subscriber may exist on zenoh."""
                self.matches += 1

            def rest(self, epoch: int, matches: int) -> None:
                """Note that none existed in an epoch, after so many matches."""
                self._quiet = (epoch, matches)

            def is_quiet(self) -> bool:
                """Return whether none exists on zenoh."""
                return self._quiet == (self._epoch.value, self.matches)


MAX_TARGETS = 8
"""Maximum number of links of a sender; as in ``links.c``."""

__all__ = ["MAX_TARGETS", "Epoch", "Link", "Sender", "flush", "join"]
