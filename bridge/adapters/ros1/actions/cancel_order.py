"""Keeps the order of one client's goals and cancel requests, which arrive on two TCP connections.

An actionlib client sends a cancel request after the goal that it names. The goal arrives after the request if its
connection is read later, or if TCP has to retransmit a segment; therefore a request that may have overtaken a goal is
held here until the goal arrives, which is then canceled at once. Nothing else is held: a request for known goals
cancels them at once.

A request for all goals has neither an id nor a stamp. If a goal of its client is still unread when the request arrives,
the goal may have been sent before or after the request. Such a goal is canceled, because a request that misses its goal
would not stop the robot. An actionlib server, too, handles goals and requests in any order (``action_server.py`` in
actionlib 1.14).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from bridge.adapters.ros1.actions.wire import ZERO, GoalId

CROSSING_SECONDS = 1.0
"""How long a cancel request for an unknown goal is still held once everything on its client's goal connection is read.
TCP retransmits a lost segment after 0.2 to 1 s (RFC 6298)."""

LONGEST_SECONDS = 30.0
"""How long a cancel request is held if its client's goal connection is never read."""

MAX_HELD = 1000
"""Maximum number of held requests; beyond it, the oldest are released early."""

Client = tuple[str, str]
"""Name and XML-RPC address of a client's node."""


class GoalServer(Protocol):
    """The methods of `bridge.adapters.ros1.actions.server.ActionlibServer` that are used here."""

    def goal(self, goal: GoalId, body: bytes) -> str:
        """Accept a goal; return the id under which it is listed, "" if it is not listed."""

    def cancel(self, request: GoalId) -> None:
        """Cancel goals."""

    def knows(self, goal: str) -> bool:
        """Return whether a goal with this id is listed."""


class UnreadGoals(Protocol):
    """Returns whether a client may have sent a goal that is not delivered yet.

    With ``listed``, it may also have if the master lists it as a publisher but this node is not connected to it yet.
    """

    def __call__(self, client: Client, *, listed: bool) -> bool:
        """Return whether the client may have such a goal."""


@dataclass(eq=False, slots=True)
class _Held:
    """A held request, which waits for the goal that it names, or for the unread goals of its client."""

    request: GoalId
    client: Client
    since: float
    until: float


class CancelOrder:
    """Forwards goals and cancel requests to a server, in the order in which their client sent them.

    ``clock`` returns monotonic seconds.
    """

    def __init__(self, server: GoalServer, unread: UnreadGoals, clock: Callable[[], float]) -> None:
        self._server, self._unread, self._clock = server, unread, clock
        self._held: list[_Held] = []

    def goal(self, goal: GoalId, body: bytes, client: Client) -> None:
        """Forward a goal at once, and then the held requests that concern it."""
        listed = self._server.goal(goal, body)
        if not self._held:
            return
        overtaken = [h for h in self._held if _concerns(h, listed, client)]
        self._held = [h for h in self._held if not (h in overtaken and h.request.id)]
        if overtaken and listed:
            self._server.cancel(GoalId(ZERO, listed))
        self.release()

    def cancel(self, request: GoalId, client: Client, *, unread: bool) -> None:
        """Forward or hold a request; ``unread``: its client had unread goals when the request arrived."""
        now = self._clock()
        if request.id and not self._server.knows(request.id):
            self._hold(_Held(GoalId(ZERO, request.id), client, now, now + CROSSING_SECONDS))
            request = GoalId(request.stamp, "")
            if request.stamp == ZERO:
                return
        elif unread and request == GoalId(ZERO, ""):
            self._hold(_Held(request, client, now, now))
        self._server.cancel(request)

    def release(self) -> None:
        """Forward held requests whose time is over; called about ten times per second."""
        now = self._clock()
        for held in list(self._held):
            if now < held.since + LONGEST_SECONDS and self._unread(held.client, listed=bool(held.request.id)):
                held.until = max(held.until, now + CROSSING_SECONDS) if held.request.id else now
            elif now >= held.until:
                self._release(held)

    def _hold(self, held: _Held) -> None:
        self._held.append(held)
        if len(self._held) > MAX_HELD:
            self._release(self._held[0])

    def _release(self, held: _Held) -> None:
        self._held.remove(held)
        # the server remembers the id, as an actionlib server does; requests without an id were forwarded on arrival
        if held.request.id:
            self._server.cancel(held.request)


def _concerns(held: _Held, goal: str, client: Client) -> bool:
    return held.request.id == goal if held.request.id else held.client == client
