"""For the doctor: why the gateway waits or warns."""

from __future__ import annotations

from bridge.doctor.context import CheckContext
from bridge.doctor.hub_problems import Note, absence, inactive_nodes
from bridge.module_keys import GatewayKeys
from bridge.status import StatusDocument


def cause(context: CheckContext, gateway: StatusDocument) -> Note | None:
    """Return what is wrong with the planner, for a gateway on another machine only what its status document shows."""
    inactive = inactive_nodes(gateway)
    if inactive is not None or gateway.daemon != context.config.name:
        return inactive
    planner = gateway.other(GatewayKeys).planner
    return absence(context.config.navigation, planner, context.hub.endpoints, context.hub.documents)
