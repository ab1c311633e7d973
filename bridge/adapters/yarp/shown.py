"""What a port of ours carries, and who is connected to it: for ``midspan status`` and ``midspan explain``."""

from __future__ import annotations

from typing import Any

from bridge.adapters.yarp.plan import PortPlan
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.generation import Generations
from yarp_compat.wire.profile import Profile


def shown(plan: PortPlan, core: PortCore, generations: Generations) -> dict[str, Any]:
    """The port as it stands in the worker's status document."""
    connections = core.connections.outputs if plan.writes else core.connections.inputs
    peers = []
    for connection in connections:
        name = connection.route.target if plan.writes else connection.route.source
        peers.append(_peer(name, connection.carrier.name, connection.profile, plan, generations))
    answers = {} if plan.reply is None else {"direction": "rpc", "replies": plan.reply.shown(plan.type)}
    return {
        "port": core.name,
        "direction": "out" if plan.writes else "in",
        "topic": plan.topic,
        "type": plan.type,
        "carries": plan.content.shown(plan.type),
        "profile": plan.content.profile.value,
        "peers": sorted(peers, key=lambda peer: peer["port"]),
        **answers,
    }


def _peer(name: str, carrier: str, known: Profile | None, plan: PortPlan, generations: Generations) -> dict[str, str]:
    link = plan.links.get(name)
    if link is not None and link.profile is not None:
        profile, why = link.profile, "the rule for it says so"
    elif known is not None:
        profile, why = known, "it told so"
    else:
        profile, why = plan.content.profile, "as yarp.profile says; bytes that tell another are read as such"
    peer = {"port": name, "carrier": carrier, "profile": profile.value, "profile_why": why}
    return peer | generations.of(name, known).as_dict()
