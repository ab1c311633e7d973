"""Which of two versions of a key holds, and whether they were made apart."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass

from bridge.stores.entry import OLDEST, Entry

_MOST_TEXT = 300


@dataclass(frozen=True, slots=True)
class Conflict:
    """Two changes of one key of which neither knew of the other. The later holds.

    Attributes:
        holds: the later.
        lost: the other.
    """

    holds: Entry
    lost: Entry

    def __str__(self) -> str:
        """For people, with what was lost, so that it can be put back by hand."""
        return (
            f"{self.lost.kind} {self.lost.name!r} was changed at {self.holds.version.origin} and at"
            f" {self.lost.version.origin} apart from each other; the later holds, of {self.holds.version.origin},"
            f" {_when(self.holds)}: {_what(self.holds)}; lost is that of {self.lost.version.origin},"
            f" {_when(self.lost)}: {_what(self.lost)}"
        )


def conflict(one: Entry, other: Entry) -> Conflict | None:
    """The conflict of two entries of one key, None where one followed the other or both say the same."""
    if one.version.knows(other.version) or other.version.knows(one.version) or one.body == other.body:
        return None
    if (one.version.stamp.ns == OLDEST) is not (other.version.stamp.ns == OLDEST):
        return None  # what was imported gives way to what was written
    lost, holds = sorted((one, other), key=lambda entry: entry.version.stamp)
    return Conflict(holds, lost)


def _when(entry: Entry) -> str:
    seconds, rest = divmod(entry.version.stamp.ns, 1_000_000_000)
    return f"{time.strftime('%Y-%m-%d %H:%M:%S', time.gmtime(seconds))}.{rest // 1_000_000:03} UTC"


def _what(entry: Entry) -> str:
    if entry.body is None:
        return "deleted"
    if entry.encoding.startswith("application/json"):
        text = json.dumps(entry.body.decode(errors="replace"), ensure_ascii=False)[1:-1].replace('\\"', '"')
        return text if len(text) <= _MOST_TEXT else f"{text[:_MOST_TEXT]}..."
    return f"{len(entry.body)} bytes"
