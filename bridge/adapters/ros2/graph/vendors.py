"""Nodes on Cyclone DDS: their topics cross, their calls do not.

The first two bytes of a GUID prefix are its vendor's (DDSI-RTPS 2.5, 9.3.1.5): 01 0f is eProsima, whose Fast DDS
Midspan uses, 01 10 is Eclipse Cyclone DDS. rmw_fastrtps sends the identity of a request as inline QoS, rmw_cyclonedds
as the first 16 bytes of the payload (serdata.hpp). So a server on Cyclone DDS would execute Midspan's request shifted
by 16 bytes, which for most types means all zeros, and a request of a client on Cyclone DDS would arrive shifted in the
other direction.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bridge.messages.actions import split
from bridge.routing.edge import Endpoint, Kind, MadeBy, Obstacle

_CYCLONE = b"\x01\x10"
_CURE = "run that node on Fast DDS: RMW_IMPLEMENTATION=rmw_fastrtps_cpp"
_UNNAMED = "a node with an unknown name"

_OF_EACH_NODE = ("rcl_interfaces/srv/", "type_description_interfaces/srv/")
"""Types of services that every node has."""


def is_cyclone(gid: bytes) -> bool:
    """Return whether a GUID, or its prefix, is of Cyclone DDS."""
    return gid.startswith(_CYCLONE)


def _is_cyclone_endpoint(endpoint: Endpoint) -> bool:
    return endpoint.made_by is MadeBy.NATIVE and endpoint.id.startswith(_CYCLONE.hex())


def of_servers(service: str, servers: Iterable[Endpoint]) -> Obstacle | None:
    """Return why a service with these servers cannot be called; None if it can.

    DDS delivers a request to all servers of a name, so one on Cyclone DDS is enough.
    """
    servers = [server for server in servers if server.made_by is MadeBy.NATIVE]
    cyclone = [server for server in servers if _is_cyclone_endpoint(server)]
    if not cyclone:
        return None
    also = " too, and DDS delivers each request to all servers" if len(cyclone) < len(servers) else ""
    reason = (
        f"{service} is served on Cyclone DDS ({_nodes(cyclone)}){also}: Cyclone DDS expects another request header than"
        " Fast DDS writes and would execute the request with wrong values, so it was not sent"
    )
    return Obstacle(reason, _CURE)


def of_clients(service: str, clients: Iterable[Endpoint]) -> Obstacle | None:
    """Return why requests of these clients are refused; None without a client on Cyclone DDS."""
    cyclone = [client for client in clients if _is_cyclone_endpoint(client)]
    return _of_requests(service, _nodes(cyclone)) if cyclone else None


def of_unknown_client(service: str) -> Obstacle:
    """Return the same obstacle for a request whose client is not on the graph."""
    return _of_requests(service, _UNNAMED)


def _of_requests(service: str, nodes: str) -> Obstacle:
    reason = (
        f"requests for {service} from Cyclone DDS ({nodes}) are refused, and their clients get no reply: Cyclone DDS"
        " writes another request header than Fast DDS reads"
    )
    return Obstacle(reason, _CURE)


def report(endpoints: Iterable[Endpoint]) -> dict[str, list[str]]:
    """Return the ``nodes`` on Cyclone DDS, and the services and actions that they serve and call.

    Services that every node has, such as those of its parameters, are omitted.
    """
    cyclone = [endpoint for endpoint in endpoints if _is_cyclone_endpoint(endpoint)]

    def names(kind: Kind) -> list[str]:
        relevant = (e for e in cyclone if e.kind is kind and not e.type.startswith(_OF_EACH_NODE))
        return sorted({split(e.topic)[0] or e.topic for e in relevant})

    if not cyclone:
        return {}
    nodes = sorted({endpoint.node or _UNNAMED for endpoint in cyclone})
    return {"nodes": nodes, "served": names(Kind.SERVER), "called": names(Kind.CLIENT)}


def warning(cyclone: dict[str, Any]) -> str:
    """Return a one-line warning for the result of `report`."""
    served = f" ({', '.join(cyclone['served'])})" if cyclone["served"] else ""
    return (
        f"{', '.join(cyclone['nodes'])} on Cyclone DDS: topics cross; services, actions and parameters{served} cannot"
        " be called, and calls by these nodes are not answered"
    )


def _nodes(endpoints: Iterable[Endpoint]) -> str:
    return ", ".join(sorted({endpoint.node or _UNNAMED for endpoint in endpoints}))
