"""Goals of ROS 1 clients that have ended for their clients, but may still be executed by the hub's servers."""

from __future__ import annotations

from collections.abc import Iterable
from threading import Lock

_MOST = 10_000
"""Maximum number of such goals; the oldest are dropped."""


class OrphanedGoals:
    """The UUIDs of such goals, for all actions; a server that returns is asked to cancel its own. Thread-safe."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._goals: dict[bytes, None] = {}

    def add(self, goal: bytes) -> None:
        """Add a goal."""
        with self._lock:
            self._goals[goal] = None
            if len(self._goals) > _MOST:
                del self._goals[next(iter(self._goals))]

    def among(self, goals: Iterable[bytes]) -> list[bytes]:
        """Return those of these goals that are orphaned."""
        with self._lock:
            return [goal for goal in goals if goal in self._goals]
