"""Pauses between restarts."""

from __future__ import annotations

FIRST = 0.2
LONGEST = 10.0
GOOD_LIFE = 30.0


class Backoff:
    """Doubles from 0.2 s to 10 s, and begins again after a life of 30 s."""

    def __init__(self, first: float = FIRST, longest: float = LONGEST, good_life: float = GOOD_LIFE) -> None:
        self._first = first
        self._longest = longest
        self._good_life = good_life
        self._next = first

    def pause(self, lived: float) -> float:
        """Seconds to wait after a life of ``lived`` seconds."""
        if lived >= self._good_life:
            self._next = self._first
        pause = self._next
        self._next = min(self._next * 2, self._longest)
        return pause

    def reset(self) -> None:
        """Begin again, as after a change of the configuration."""
        self._next = self._first
