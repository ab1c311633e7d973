"""State machines whose transitions are given by a table; states and events are enums.

An event that is not in a state's table changes nothing. ARCHITECTURE.md shows all tables.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from enum import Enum
from typing import Generic, TypeVar

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)
Table = Mapping[S, Mapping[E, S]]


class Machine(Generic[S, E]):
    """A state machine: its state, and the time since which it is in that state (monotonic seconds)."""

    def __init__(self, table: Table[S, E], state: S) -> None:
        self._table = table
        self.state = state
        self.since = time.monotonic()

    def on(self, event: E) -> bool:
        """Handle an event; return whether it changed the state."""
        following = self._table[self.state].get(event, self.state)
        if following is self.state:
            return False
        self.state, self.since = following, time.monotonic()
        return True

    def excuse(self, seconds: float) -> None:
        """Do not count some of the time that has passed in the current state."""
        self.since = min(time.monotonic(), self.since + seconds)

    @property
    def age(self) -> float:
        """Seconds since the current state was entered."""
        return time.monotonic() - self.since
