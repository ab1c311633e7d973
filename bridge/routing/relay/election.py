"""Elects which worker relays for which sessions of the hub's own nodes, so that nothing is relayed twice.

Each worker of a side announces the time of its start and the router of its machine. On each machine, the worker that
started first is the candidate. If there are candidates on several machines, that of a session's own machine relays for
it: messages between nodes of one machine then stay there, and a machine that another one does not trust cannot relay
that machine's commands. This candidate has a direct link to the session, and announces that. For sessions without such
a candidate, such as those of machines without Midspan, the candidate that started first relays, a second later.

A worker joins the election when it is linked to a router, and relays nothing before it knows all sessions on the hub.
A candidate that takes a session over from one that is still on the hub starts a second later, so that the other one has
seen that and has stopped: no message is relayed twice. A worker that hung for long enough that others may have taken
over joins again, as the newest one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping

from bridge.hub.node import Hub
from bridge.routing.peer_watch import HUB_AGAIN, HubViews

GRACE = 1.0
"""Seconds for which a candidate on another machine waits for the announcement of one with a direct link, and for which
a candidate waits until another one has stopped."""


class RelayElection:
    """One worker's part in the election. Used by the relay's loop, except that `stop` follows it."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._views = HubViews(hub)
        self._settled = False
        self._since = time.time_ns()
        self._router: str | None = None
        self._withdraw: Callable[[], None] | None = None
        self._near: dict[str, Callable[[], None]] = {}
        self._seen: dict[str, float] = {}
        self._winners: dict[str, str] | None = None  # the candidate of each session; None unless this is a candidate
        self._won: dict[str, float] = {}  # when it won each session from another candidate; -inf if there was none

    def rejoin(self) -> None:
        """Join again after a hang, as the last one, unless this is the only worker that may relay."""
        if self._router is None or self._hub.graph.relays().keys() <= {self._hub.zid}:
            return
        self._views.restart(time.monotonic(), HUB_AGAIN)
        self._settled, self._since = False, time.time_ns()
        self._announce(self._router)

    def stop(self) -> None:
        """Leave the election."""
        self._follow_near(())
        if self._withdraw is not None:
            self._withdraw()

    def _announce(self, router: str) -> None:
        before, self._router = self._withdraw, router
        self._withdraw = self._hub.graph.announce_relay(self._since, router)
        if before is not None:
            before()

    def poll(self) -> bool:
        """Follow changes that the graph does not report; return whether the outcome may have changed."""
        now, router = time.monotonic(), self._hub.router()
        if router and router != self._router:
            self._announce(router)
        if not self._settled:
            self._settled = self._views.now(now).settled
            return self._settled
        return len(_candidates(self._hub.graph.relays())) > 1 and (
            any(now - seen < 2 * GRACE for seen in (*self._seen.values(), *self._won.values()))
            or any(zid not in self._near for zid in self._hub.neighbors() & self._seen.keys())
        )

    @property
    def is_candidate(self) -> bool:
        """Whether this worker may relay for any session."""
        return self._settled and self._hub.zid in _candidates(self._hub.graph.relays())

    def elect(self, sessions: Collection[str]) -> frozenset[str]:
        """Return for which of these sessions (zid) this worker relays."""
        relays = self._hub.graph.relays()  # read once, because a worker may leave at any time
        now, me, candidates = time.monotonic(), self._hub.zid, _candidates(relays)
        if not self._settled or me not in candidates:
            self._seen, self._winners, self._won = {}, None, {}
            self._follow_near(())
            return frozenset()
        self._seen = {zid: self._seen.get(zid, now) for zid in sessions}
        if len(candidates) == 1:
            self._follow_near(())
            self._winners, self._won = dict.fromkeys(sessions, me), dict.fromkeys(sessions, -math.inf)
            return frozenset(sessions)
        # a link that is lost for a moment must not end a call that waits for its reply
        self._follow_near((self._hub.neighbors() | self._near.keys()) & set(sessions))
        near = self._hub.graph.near()

        def winner(session: str) -> str:
            linked = [zid for zid in candidates if (zid, session) in near]
            return min(linked or candidates, key=lambda zid: (relays[zid][0], zid))

        self._follow_winners({session: winner(session) for session in sessions}, candidates, now)
        linked = {session for zid, session in near if zid in candidates}
        return frozenset(
            session
            for session, won in self._won.items()
            if now - won >= GRACE and (session in linked or now - self._seen[session] >= GRACE)
        )

    def _follow_winners(self, winners: dict[str, str], candidates: Collection[str], now: float) -> None:
        """Note which sessions this worker wins, and whether another candidate may still relay for them."""
        before, self._winners = self._winners, winners
        won: dict[str, float] = {}
        for session in (session for session, winner in winners.items() if winner == self._hub.zid):
            seen = self._seen[session]
            relayed = before is None or (before.get(session) in candidates and now - seen >= GRACE)
            won[session] = self._won.get(session, now if relayed else -math.inf)
        self._won = won

    def _follow_near(self, sessions: Collection[str]) -> None:
        for zid in self._near.keys() - set(sessions):
            self._near.pop(zid)()
        for zid in set(sessions) - self._near.keys():
            self._near[zid] = self._hub.graph.announce_near(zid)


def _candidates(relays: Mapping[str, tuple[int, str]]) -> set[str]:
    """Return the session (zid) of each machine's candidate, from the announcements of `HubGraph.relays`."""
    first: dict[str, tuple[int, str]] = {}
    for zid, (since, router) in relays.items():
        first[router] = min(first.get(router, (since, zid)), (since, zid))
    return {zid for _, zid in first.values()}
