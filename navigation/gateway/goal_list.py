"""The goals of an action server, from the list that it publishes on its ``status`` topic."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping

from bridge.messages.actions import GoalState
from navigation.gateway.motion import STALL_SECONDS

EARLY_SECONDS = 1.0
"""A list may arrive this long before the graph shows its publisher."""

EMPTY_SECONDS = 2.0
"""An rcl server publishes its list with its first goal, so a server without a list for this time has no goals."""


class GoalList:
    """The newest list of one action server, and whether it is valid: "no list yet" is not "no goals".

    Args:
        always: the server publishes its list as soon as it starts, as servers of Midspan and ROS 1 do. In that
            case, the goals are unknown until the list arrives.
    """

    def __init__(self, *, always: bool) -> None:
        self._always = always
        self._publishers: dict[bytes, float] = {}  # GIDs of the topic's publishers on the hub: when each appeared
        self._publisher = b""  # the publisher of the newest list
        self._shown = False  # whether the graph has shown that publisher
        self._refreshed_at = self._running_since = 0.0  # the last `refresh`, and the end of the last stall (monotonic)
        self._received = 0.0  # when the newest list arrived (monotonic); 0: never
        self.active_since = 0.0  # since when any goal has been active (monotonic); 0: none is
        self._statuses: dict[bytes, GoalState] = {}
        self._empty = False  # no list has arrived from these publishers for a long time, so they have no goals
        self.known = False  # whether the list belongs to an available server

    @property
    def any(self) -> bool:
        """Whether any list has arrived, or has been missing for so long that the server has no goals."""
        return self._received > 0.0 or self._empty

    @property
    def all(self) -> tuple[bytes, ...]:
        """The goals of the newest list, including those that have ended."""
        return tuple(self._statuses)

    @property
    def active(self) -> tuple[bytes, ...]:
        """The goals that have not ended according to the newest list, even an invalid one."""
        return tuple(goal for goal, status in self._statuses.items() if not status.ended)

    def status(self, goal: bytes) -> GoalState | None:
        """Return the state of a goal in the newest list; None if the list does not have it."""
        return self._statuses.get(goal)

    def _latest_sign(self) -> float:
        """Return when a publisher last appeared, a list arrived, or a stall of this process ended (monotonic)."""
        return max(self._received, self._running_since, *self._publishers.values())

    def receive(self, publisher: bytes, statuses: Mapping[bytes, GoalState]) -> bool:
        """Store a list; return whether it differs from the previous one."""
        changed = self._statuses != statuses
        self._shown = publisher in self._publishers or (self._shown and publisher == self._publisher)
        self._publisher, self._statuses, self._received = publisher, dict(statuses), time.monotonic()
        self.active_since = (self.active_since or self._received) if self.active else 0.0
        self.known, self._empty = True, False
        return changed

    def refresh(self, publishers: Collection[bytes]) -> None:
        """Set the topic's publishers; a list is valid while its publisher exists. Called about ten times a second."""
        now, before = time.monotonic(), self._publishers
        if now > self._refreshed_at + STALL_SECONDS:
            self._running_since = now  # a list may have arrived that has not been read yet
        self._refreshed_at = now
        self._publishers = {gid: before.get(gid, now) for gid in publishers}
        self._empty = self._empty and bool(self._publishers) and self._publishers.keys() <= before.keys()
        if self._publisher in self._publishers:
            self.known = self._shown = True
        elif self._publishers and not self._shown and now < self._received + EARLY_SECONDS:
            self.known = True  # the graph does not show its publisher yet
        elif not self._always and self._publishers and now >= self._latest_sign() + EMPTY_SECONDS:
            self._publisher, self._statuses, self._empty = b"", {}, True
            self.known, self.active_since = True, 0.0
        else:
            self.known = self._empty
