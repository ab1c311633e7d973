"""Counters of one service's route."""

from __future__ import annotations

from typing import Any

from bridge.routing.counters import Counters


class CallCounters(Counters):
    """What became of the calls: each is a reply, an error, abandoned by its caller, or pending.

    ``messages`` counts the calls, and the latencies are those of whole calls. Calls that were refused are among the
    errors, and counted by reason among the drops: ``queue`` (too many at once), ``bad``, ``large``, ``standby``.
    """

    __slots__ = ("abandoned", "errors", "pending", "replies")

    def __init__(self) -> None:
        super().__init__()
        self.replies = self.errors = self.abandoned = self.pending = 0

    def as_dict(self) -> dict[str, Any]:
        """The counters as they stand in the status document."""
        calls = {name: getattr(self, name) for name in ("replies", "errors", "abandoned", "pending")}
        return {**super().as_dict(), "calls": self.messages, **calls}
