"""A hub whose router is in the test's own process: it is there at once, where no test is about the router itself."""

from __future__ import annotations

from typing import Any

import zenoh

from bridge.hub.control import Control
from bridge.hub.links import MEMBERS
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, router_tree
from tests.support.hub import HubNetwork


class QuickHub(HubNetwork):
    """See `tests.support.hub.HubNetwork`. Its router tells who is there, as Midspan's does.

    Attributes:
        unanswered: so often it does not tell next.
        told: how often it has told.
    """

    unanswered = told = 0
    _others: tuple[str, ...] = ()
    _session: zenoh.Session | None = None
    _control: Control

    def start_router(self) -> None:
        """Run the router."""
        session = zenoh.open(make_config(router_tree([self.endpoint], max_payload=MAX_PAYLOAD), None))
        self._session, self._control = session, Control(session, self.domain, "quick", "router")
        self._control.serve(MEMBERS, lambda _: self._members(session))

    def _members(self, session: zenoh.Session) -> dict[str, Any]:
        if self.unanswered:
            self.unanswered -= 1
            return {}
        self.told += 1
        members = [*(str(t.zid) for t in session.info.transports()), *self._others]
        peers = [*(str(zid) for zid in session.info.peers_zid()), *self._others]
        return {"zid": str(session.zid()), "members": members, "peers": peers}

    def also_say(self, members: Any) -> None:
        """Have another answer in the router's name to who asks for its members."""
        assert self._session is not None
        router = str(self._session.info.zid())
        self._control.serve(MEMBERS, lambda _: {"zid": router, "members": members})

    def also_has(self, *zids: str) -> None:
        """Report peers that nobody reaches."""
        self._others = zids

    def stop_router(self) -> None:
        """End the router."""
        session, self._session = self._session, None
        if session is not None:
            session.close()
            self._control.close()
