"""A hub whose router is in the test's own process: it is there at once, where no test is about the router itself."""

from __future__ import annotations

import zenoh

from bridge.hub.settings import MAX_PAYLOAD, make_config, router_tree
from tests.support.hub import HubNetwork


class QuickHub(HubNetwork):
    """See `tests.support.hub.HubNetwork`."""

    _session: zenoh.Session | None = None

    def start_router(self) -> None:
        """Run the router."""
        self._session = zenoh.open(make_config(router_tree([self.endpoint], max_payload=MAX_PAYLOAD), None))

    def stop_router(self) -> None:
        """End the router."""
        session, self._session = self._session, None
        if session is not None:
            session.close()
