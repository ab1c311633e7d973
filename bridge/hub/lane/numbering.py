"""Numbers the samples at both ends of a lane, in C if possible (``links.c``, ``receiving.c``)."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

try:
    from bridge.hub.lane.links import Epoch, Link, Sender, flush, join
    from bridge.hub.lane.receiving import Receiver, Track, read_lane
except ImportError:  # there was no compiler, or the system has no lanes
    if not TYPE_CHECKING:
        Link = flush = join = Receiver = read_lane = None

        class Epoch:
            """A number that changes with the graph."""

            def __init__(self) -> None:
                self.value = 0
                self._values = itertools.count(1)

            def renew(self) -> None:
                """Begin a new epoch; safe in any thread."""
                self.value = next(self._values)

        class Sender:
            """Numbers a publisher's samples, and stores whether zenoh has a subscriber."""

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
                """Count a match, after which zenoh may have a subscriber."""
                self.matches += 1

            def rest(self, epoch: int, matches: int) -> None:
                """Store the epoch and the number of matches in which zenoh had no subscriber."""
                self._quiet = (epoch, matches)

            def is_quiet(self) -> bool:
                """Return whether zenoh has no subscriber."""
                return self._quiet == (self._epoch.value, self.matches)

        class Track:
            """The number and source time of a publisher's last sample, and those that wait for earlier ones."""

            def __init__(self) -> None:
                self.sequence = None
                self.time_ns = 0
                self.held = {}


__all__ = ["Epoch", "Link", "Receiver", "Sender", "Track", "flush", "join", "read_lane"]
