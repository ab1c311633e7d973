"""Whether a planner responds; a killed program stays on the graph for its lease, 20 s with Fast DDS."""

from __future__ import annotations

import time
from collections.abc import Set as AbstractSet

TRIAL_SECONDS = 3.0
"""A planner that did not answer is tried again after this time, or earlier if it publishes something."""

PROOF_SECONDS = 1.0
"""A trial that has not failed for this time has succeeded."""


class Contact:
    """Contact with one action server, judged by calls to it; new GIDs of its parts mean that it has been restarted."""

    def __init__(self) -> None:
        self._lost_at: float | None = None  # monotonic; None: contact is not in doubt
        self._parts: AbstractSet[bytes] = frozenset()

    @property
    def proven(self) -> bool:
        """Whether nothing has failed since the server was last known to respond."""
        return self._lost_at is None

    def lose(self, parts: AbstractSet[bytes]) -> None:
        """Note that a call failed although these parts are on the hub."""
        self._lost_at, self._parts = time.monotonic(), parts

    def prove(self) -> None:
        """Note that the server published something."""
        self._lost_at = None

    def excuse(self, seconds: float) -> None:
        """Do not count time for which this process stood still: nothing can fail meanwhile."""
        if self._lost_at is not None:
            self._lost_at = min(time.monotonic(), self._lost_at + seconds)

    def answers(self, parts: AbstractSet[bytes]) -> bool:
        """Whether the server with these parts is expected to answer, or is worth a trial."""
        if self._lost_at is None:
            return True
        now = time.monotonic()
        if parts != self._parts or now > self._lost_at + TRIAL_SECONDS + PROOF_SECONDS:
            self._lost_at = None
            return True
        return now > self._lost_at + TRIAL_SECONDS
