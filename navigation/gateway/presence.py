"""Whether a planner is available: the parts of its action on the hub, its answers, and the report of its side."""

from __future__ import annotations

import time
from collections.abc import Sequence

from bridge.messages.actions import names
from bridge.modules.host import Host
from bridge.state_machine import Machine
from navigation.gateway.contact import Contact
from navigation.gateway.machine import PLANNER, PlannerEvent, PlannerState

ABSENT_SECONDS = 2.0
"""A planner that does not appear within this time after its side's worker has joined is not running there."""

UNSEEN_SECONDS = 10.0
"""The same while the base moves, because the worker of a busy machine may take this long to find the planner."""


class Presence:
    """Whether a planner is available, as a state machine.

    Args:
        action: the planner's action on the hub.
        side: the side that the planner runs on; "" for a planner that Midspan hosts.
        hosted: whether this process hosts the planner.
        topics: the topics on which the planner's first parts appear.
    """

    def __init__(self, host: Host, action: str, side: str, *, hosted: bool, topics: Sequence[str]) -> None:
        self._graph, self._names, self._side, self._hosted = host.node.hub.graph, names(action), side, hosted
        self._topics = (self._names.status, self._names.feedback, *topics)
        self.contact = Contact()
        self.machine: Machine[PlannerState, PlannerEvent] = Machine(PLANNER, PlannerState.UNKNOWN)
        self.seen_at = time.monotonic()  # when the planner was last reachable; before that, when this began
        self.unreachable_at = time.monotonic()  # when the planner was last seen to be unreachable
        self._side_since: float | None = None  # since when the planner's side has joined without showing the planner
        self._first_parts: set[bytes] = set()  # the planner's publishers when it became unreachable

    @property
    def coming_up(self) -> bool:
        """Whether new parts of the planner have appeared on the hub while others are missing."""
        return not self.machine.state.reachable and bool(self._publisher_gids() - self._first_parts)

    def refresh(self, *, complete: bool, moving: bool) -> None:
        """Read the graph again; ``complete``: all parts of the action are there, ``moving``: the base moves."""
        if complete and self.contact.answers(self._parts()):
            if self.contact.proven:
                self.seen_at = time.monotonic()
            self._side_since = None
            self.machine.on(PlannerEvent.FOUND)
        else:
            self._lose()
            if self._side_reported(moving=moving):
                self.machine.on(PlannerEvent.SIDE_REPORTED)

    def excuse(self, seconds: float) -> None:
        """Do not count time for which this process stood still, and read neither the graph nor any message."""
        now = time.monotonic()
        self.machine.excuse(seconds)
        self.contact.excuse(seconds)
        self.seen_at = min(now, self.seen_at + seconds)
        self.unreachable_at = min(now, self.unreachable_at + seconds)
        if self._side_since is not None:
            self._side_since = min(now, self._side_since + seconds)

    def lose_contact(self) -> None:
        """Count the planner as unreachable until its parts or its goal list change, because a call failed."""
        self.contact.lose(self._parts())
        self._lose()

    def _lose(self) -> None:
        if self.machine.state.reachable:
            self._first_parts = self._publisher_gids()
        self.machine.on(PlannerEvent.LOST)
        self.unreachable_at = time.monotonic()

    def _publisher_gids(self) -> set[bytes]:
        return {publisher.gid for topic in self._topics for publisher in self._graph.publishers(topic)}

    def _parts(self) -> set[bytes]:
        """Return the GIDs of all servers and publishers of the action."""
        parts = self._names
        servers = map(self._graph.servers, (parts.send_goal, parts.get_result, parts.cancel_goal))
        publishers = map(self._graph.publishers, (parts.feedback, parts.status))
        return {endpoint.gid for endpoints in (*servers, *publishers) for endpoint in endpoints}

    def _side_reported(self, *, moving: bool) -> bool:
        """Whether the planner is not running on its side: the worker joined long enough ago, but does not show it."""
        now = time.monotonic()
        joined = {origin.side for origin in self._graph.origins().values()} | {"zenoh"}
        if not self._hosted and self._side not in joined:
            self._side_since = None
            return False
        if self._side_since is None:
            self._side_since = now
        return now > self._side_since + (UNSEEN_SECONDS if moving else ABSENT_SECONDS)
