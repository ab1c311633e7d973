"""A hub whose router runs in the test's process and is available at once, for tests that do not test the router."""

from __future__ import annotations

from typing import Any

import zenoh

from bridge.hub.control import Control
from bridge.hub.links import MEMBERS
from bridge.hub.rejoin import REJOIN, Rejoins
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, router_tree
from tests.peers.hub.network import HubNetwork
from tests.support.zenoh_router import open_router


class QuickHub(HubNetwork):
    """A `tests.peers.hub.network.HubNetwork` whose router lists its sessions as Midspan's router does.

    Attributes:
        unanswered: number of further requests for the list to leave unanswered.
        answered: number of answered requests.
    """

    unanswered = answered = 0
    _others: tuple[str, ...] = ()
    _session: zenoh.Session | None = None
    _control: Control

    def start_router(self) -> None:
        """Start the router."""
        session = open_router(make_config(router_tree([self.endpoint], max_payload=MAX_PAYLOAD), None))
        self._session, self._control = session, Control(session, self.domain, "quick", "router")
        self._control.serve(MEMBERS, lambda _: self._members(session))
        self._control.serve(REJOIN, Rejoins(session).answer)

    def _members(self, session: zenoh.Session) -> dict[str, Any]:
        if self.unanswered:
            self.unanswered -= 1
            return {}
        self.answered += 1
        members = [*(str(t.zid) for t in session.info.transports()), *self._others]
        peers = [*(str(zid) for zid in session.info.peers_zid()), *self._others]
        return {"zid": str(session.zid()), "members": members, "peers": peers}

    def serve_conflicting_list(self, members: Any) -> None:
        """Reply to requests for the list of sessions with these members, too, in the router's name."""
        assert self._session is not None
        router = str(self._session.info.zid())
        self._control.serve(MEMBERS, lambda _: {"zid": router, "members": members})

    def list_also(self, *zids: str) -> None:
        """List further peers, which do not exist."""
        self._others = zids

    def stop_router(self) -> None:
        """Stop the router."""
        session, self._session = self._session, None
        if session is not None:
            session.close()
            self._control.close()
