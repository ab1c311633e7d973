"""The checks of the hub's router."""

from __future__ import annotations

from bridge.doctor.check import Check
from bridge.doctor.checks import connections, hub

CHECKS = (
    Check("router-port", "the router's port", hub.check_port),
    Check(
        "keys",
        "the certificates and connections of other machines (`hub.open`)",
        connections.check_connections,
        seconds=connections.SECONDS,
    ),
)
