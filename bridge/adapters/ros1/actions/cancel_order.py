"""Keeps the order of one client's goals and cancel requests, which arrive on two TCP connections.

An actionlib client sends a cancel request after the goal that it names. The goal is late if its connection is read
later, or if TCP has to repeat a segment; so a request that may have overtaken a goal waits for it here. Nothing else
waits: a request that concerns known goals cancels these at once. No waiting request ever makes a goal start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from bridge.adapters.ros1.actions.wire import ZERO, GoalId

CROSSING_SECONDS = 1.0
"""How long a cancel request waits for a goal that nobody has seen, once the connection of its client's goals is read.
TCP repeats a lost segment after 0.2 to 1 s (RFC 6298)."""

LONGEST_SECONDS = 30.0
"""How long it waits if that connection never is."""

MAX_HELD = 1000
"""Requests that wait at most; the oldest then count as if their time was over."""

Client = tuple[str, str]
"""Name and XML-RPC address of a client's node."""


class GoalServer(Protocol):
    """The parts of `bridge.adapters.ros1.actions.server.ActionlibServer` that are called here."""

    def goal(self, goal: GoalId, body: bytes) -> str:
        """Accept a goal; returns the id under which it is listed, "" if it is not."""

    def cancel(self, request: GoalId) -> None:
        """Cancel goals."""

    def knows(self, goal: str) -> bool:
        """Whether a goal of this id is listed."""


class UnreadGoals(Protocol):
    """Whether a client may have sent a goal that has not been delivered yet; ``listed``: even without a connection."""

    def __call__(self, client: Client, *, listed: bool) -> bool:
        """See the class."""


@dataclass(eq=False, slots=True)
class _Held:
    """A request that waits: for the goal that it names, or for the unread goals of its client."""

    request: GoalId
    client: Client
    since: float
    until: float


class CancelOrder:
    """Passes goals and cancel requests on to a server in each client's order. ``clock`` gives monotonic seconds."""

    def __init__(self, server: GoalServer, unread: UnreadGoals, clock: Callable[[], float]) -> None:
        self._server, self._unread, self._clock = server, unread, clock
        self._held: list[_Held] = []

    def goal(self, goal: GoalId, body: bytes, client: Client) -> None:
        """Pass a goal on at once, and then the requests that overtook it."""
        listed = self._server.goal(goal, body)
        if not self._held:
            return
        overtaken = [h for h in self._held if _concerns(h, listed, client)]
        self._held = [h for h in self._held if not (h in overtaken and h.request.id)]
        if overtaken and listed:
            self._server.cancel(GoalId(ZERO, listed))
        self.release()

    def cancel(self, request: GoalId, client: Client, *, unread: bool) -> None:
        """Pass a request on; ``unread``: its client had unread goals when it came."""
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
        """Pass on the requests whose time is over; called some ten times a second."""
        now = self._clock()
        for held in list(self._held):
            if now < held.since + LONGEST_SECONDS and self._unread(held.client, listed=bool(held.request.id)):
                held.until = max(held.until, now + CROSSING_SECONDS) if held.request.id else now
            elif now >= held.until:
                self._let_go(held)

    def _hold(self, held: _Held) -> None:
        self._held.append(held)
        if len(self._held) > MAX_HELD:
            self._let_go(self._held[0])

    def _let_go(self, held: _Held) -> None:
        self._held.remove(held)
        if held.request.id:  # the server remembers it, as actionlib's does; one without an id was passed on already
            self._server.cancel(held.request)


def _concerns(held: _Held, goal: str, client: Client) -> bool:
    return held.request.id == goal if held.request.id else held.client == client
