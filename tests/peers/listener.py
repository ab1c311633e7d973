"""Records the reports of an adapter that has no engine."""

from __future__ import annotations


class Listener:
    """Counts changes of the graph, and records failures."""

    def __init__(self) -> None:
        self.changes = 0
        self.failures: list[str] = []

    def graph_changed(self) -> None:
        """Count the change."""
        self.changes += 1

    def presence_changed(self) -> None:
        """Ignore the change."""

    def message_refused(self, topic: str, reason: str, why: str) -> None:
        """Ignore the message."""

    def edge_failed(self, reason: str) -> None:
        """Record the reason."""
        self.failures.append(reason)
