"""For the doctor: services that a side's own map server and Map2DServer both serve."""

from __future__ import annotations

from bridge.doctor.context import CheckContext
from bridge.hub.graph.tokens import EndpointKind
from bridge.module_keys import MapServerKeys
from bridge.status import RefusedRoute, StatusDocument
from navigation.map2d_server import MODULE

_TWICE = "already"
"""The last word of the reason if a service has a server on both sides."""


def accepts(context: CheckContext, side: StatusDocument, route: RefusedRoute) -> str:
    """Return why a service is rightly refused: a Map2DServer that imports the side's map serves it too; else "".

    Both serve the same map, the side's own server on its side, so neither needs another name.
    """
    servers = [document for document in context.hub.documents if document.worker == MODULE.name]
    takers = {server.zid for server in servers if server.other(MapServerKeys).taken}
    twice = route.kind == "service" and route.reason.endswith(_TWICE)
    both = twice and any(
        e.kind is EndpointKind.SERVER and e.topic == route.hub_topic and e.zid in takers for e in context.hub.endpoints
    )
    answers = f"the map server there answers on {side.side}; Map2DServer imports its map, and answers everywhere else"
    return answers if both else ""
