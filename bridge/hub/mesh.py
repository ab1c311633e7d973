"""The direct links between this machine's sessions, made again where one of them alone was given up.

Peers learn of each other when one of them joins the router (zenoh calls it gossip) and link directly then. A link that
is given up later is not tried again, and zenoh's routers pass nothing on between two peers (zenoh 1.10:
``closed_session`` of ``orchestrator.rs`` connects anew to configured endpoints only, ``peers_failover_brokering`` has
no effect any more). Who stands still for about the lease of 3 s loses some of his links and keeps others: if the
router's is among those that he keeps, he and a lost peer hear nothing of each other until one of them is restarted.
Seen with a worker that was stopped for 3 s again and again: the fourth time.

A session that joins has the router and all peers speak of each other again. So who lost a peer that is still at the
router opens one for a moment.
"""

from __future__ import annotations

import contextlib
import json
import logging
import secrets
import time
from collections.abc import Callable, Collection
from threading import Event, Thread
from typing import Any

import zenoh

from bridge.hub.errors import HubError, zenoh_reason

_log = logging.getLogger(__name__)

MEMBERS = "members"
"""The verb by which a router of ours tells who is there."""

_MARK = "d0c0ffee"
"""Begins the zenoh ids of the sessions that introduce others: nobody misses these."""

_FIRST_SECONDS = 1.5
"""Longer than the others and the router take to notice a loss, too: else who stands still would be spoken of, and their
vain attempts to reach him be under way when he is back."""

_SOON_SECONDS = 0.2
_TOGETHER_SECONDS = 1.0
"""Who lost the router within this time of them is he who stood still, and is back: he need not wait."""

_LONGEST_SECONDS = 4.0
_INTRODUCTION_SECONDS = 2.0
_REMEMBERED_SECONDS = 60.0
"""So long one who is not at the router is remembered: he may come back and not be found."""

_MOST_EVENTS = 1000
"""Links' beginnings and ends that wait to be looked at."""

Members = Callable[[], set[str] | None]


class Mesh:
    """Watches the direct links of a session.

    Args:
        session: whose links.
        config: makes a configuration by which another session joins the same hub.
        members: zenoh ids of all that are linked with our routers; None where they do not tell.

    Attributes:
        mended: links that were lost and are there again.
    """

    def __init__(self, session: zenoh.Session, config: Callable[[], zenoh.Config], members: Members) -> None:
        self._session, self._config, self._members = session, config, members
        self._lost: dict[str, float] = {}
        self._adrift = float("-inf")
        self._closed = Event()
        self.mended = 0
        # Not a callback: zenoh's thread, which waits for Python's lock there, has links to make and to end
        channel: Any = zenoh.handlers.RingChannel(_MOST_EVENTS)
        self._listener: Any = session.info.declare_transport_events_listener(channel)
        # the listener itself can be undeclared by nobody while a thread begins to wait for it, nor be waited for after
        self._events: Any = self._listener.handler
        self._thread = Thread(target=self._run, name="hub-mesh", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Watch no more. Safe to call twice."""
        self._closed.set()
        with contextlib.suppress(zenoh.ZError):  # the session is closed already
            self._listener.undeclare()
        self._thread.join(2 * _INTRODUCTION_SECONDS)

    def _run(self) -> None:
        for event in self._events:  # until the listener is undeclared, or the session closed
            self._take(event)
            self._search()

    def _search(self) -> None:
        """Mend until nobody is lost any more."""
        pause = _SOON_SECONDS
        while self._lost and not self._closed.wait(pause):
            try:
                while (more := self._events.try_recv()) is not None:
                    self._take(more)
                self._mend()
            except (zenoh.ZError, HubError) as err:  # the session is being closed, or another cannot be opened
                _log.debug("lost links are not mended: %s", zenoh_reason(err))
            oldest = time.monotonic() - _REMEMBERED_SECONDS
            self._lost = {zid: at for zid, at in self._lost.items() if at > oldest}
            pause = min(2 * pause, _LONGEST_SECONDS)

    def _take(self, event: zenoh.TransportEvent) -> None:
        """Note who is lost."""
        if event.kind != zenoh.SampleKind.DELETE:
            return
        zid, now = str(event.transport.zid), time.monotonic()
        if event.transport.whatami == zenoh.WhatAmI.ROUTER:
            self._adrift = now
        elif event.transport.whatami == zenoh.WhatAmI.PEER and not zid.startswith(_MARK):
            self._lost[zid] = now

    def _mend(self) -> None:
        """Introduce those that are missing; at a router that does not tell who is there nobody is missed."""
        if not self._session.info.routers_zid():  # its return has all speak of each other
            return
        members = self._members()
        if members is None:
            self._lost.clear()
            return
        for zid in self._here() & self._lost.keys():
            del self._lost[zid]
        before = time.monotonic() - _FIRST_SECONDS
        due = {zid for zid, at in self._lost.items() if at < before or abs(at - self._adrift) < _TOGETHER_SECONDS}
        missing = due & members
        if missing:
            self._introduce(missing)

    def _here(self) -> set[str]:
        return {str(zid) for zid in self._session.info.peers_zid()}

    def _introduce(self, missing: Collection[str]) -> None:
        """Have a session join that speaks of them, until they are here."""
        config = self._config()
        config.insert_json5("id", json.dumps(_MARK + secrets.token_hex(12)))
        session = zenoh.open(config)
        try:
            deadline = time.monotonic() + _INTRODUCTION_SECONDS
            while time.monotonic() < deadline and not self._closed.wait(0.02):
                if self._here().issuperset(missing):
                    self.mended += len(missing)
                    _log.warning("the direct link to %s had been lost, and is there again", ", ".join(missing))
                    break
        finally:
            session.close()  # type: ignore[no-untyped-call]
