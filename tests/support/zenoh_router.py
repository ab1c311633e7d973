"""Zenoh routers in the test's process."""

from __future__ import annotations

import zenoh

from bridge.hub.freeing import keep


def open_router(config: zenoh.Config) -> zenoh.Session:
    """Open a router, which is freed without stopping the other threads of the tests for 10 s (`bridge.hub.freeing`)."""
    return keep(zenoh.open(config))
