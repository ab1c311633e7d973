"""What came, went and was lost on a port or a connection."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class Counters:
    """Messages, by one direction each; ``dropped`` by reason.

    The reasons: ``replaced`` (a newer message took its place), ``full`` (the oldest of a strict queue that was full),
    ``lost`` (the connection ended first), ``interrupted`` (the port was), ``malformed`` (above the limit too),
    ``no reader``, ``failed`` (the port's owner raised an error), ``no text`` (no Bottle, for a reader of text), and for
    datagrams ``checksum`` and ``incomplete``.
    """

    received: int = 0
    sent: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
