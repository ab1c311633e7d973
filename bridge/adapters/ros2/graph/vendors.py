"""Nodes on Cyclone DDS, whose requests and replies have a different form from Fast DDS's.

The first two bytes of a GUID prefix are its vendor's (DDSI-RTPS 2.5, 9.3.1.5): 01 0f is eProsima, whose Fast DDS
Midspan uses, 01 10 is Eclipse Cyclone DDS. A server on Cyclone DDS would execute a request in Fast DDS's form shifted
by 16 bytes, which for most types means all zeros (see `bridge.adapters.ros2.services.cyclone`). DDS delivers a request
to all servers of a service, so the clients here filter requests (`bridge.adapters.ros2.filters`): if a service has
servers of both kinds, its servers on Cyclone DDS are not called. Without the filter, none of its servers is called.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.messages.actions import split
from bridge.routing.edge import Endpoint, Kind, MadeBy, Obstacle

CYCLONE = b"\x01\x10"
CLIENT_NOT_ON_CYCLONE = "its client is not on Cyclone DDS, and gets no replies while ros2.rmw is rmw_cyclonedds_cpp"
CURE = "stop one of them, or rename one with a remapping of its node"
CURE_MIXED = "run both on the same RMW_IMPLEMENTATION, or in two domains, each with a Midspan daemon"
_CURE_ON_CYCLONE = "remove ros2.rmw (on Fast DDS Midspan reaches services of both), or run these nodes on Cyclone DDS"
_MIXED = (
    "between two kinds of DDS, ROS 2 executes requests with wrong values (mostly zeros), and the client gets no reply"
)
UNNAMED = "a node with an unknown name"

_OF_EACH_NODE = ("rcl_interfaces/srv/", "type_description_interfaces/srv/")
"""Types of services that every node has."""


def is_cyclone(gid: bytes) -> bool:
    """Return whether a GUID, or its prefix, is of Cyclone DDS."""
    return gid.startswith(CYCLONE)


class ClosedEndpoints:
    """Detects endpoints on Cyclone DDS that have closed, although Fast DDS still lists them; thread-safe.

    Cyclone DDS announces the end of an endpoint by its GUID in a parameter list, without a key hash. Fast DDS (2.14.5
    and 3.2, ``MessageReceiver.cpp``) does not read the list, which is longer than a key hash, and lists the endpoint
    until its participant leaves. But a ROS program also announces which endpoints each of its nodes has. So an endpoint
    that has belonged to a node, and no longer does, has closed. Older versions of rmw_cyclonedds_cpp do not announce
    the end of subscriptions in this way (ros2/rmw_cyclonedds #594).
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._of_nodes: set[bytes] = set()

    def is_closed(self, gid: bytes, node: str) -> bool:
        """Return whether a listed endpoint has closed; ``node`` is the node that it belongs to now, "" for none."""
        if not is_cyclone(gid):
            return False
        with self._lock:
            if node:
                self._of_nodes.add(gid)
            return not node and gid in self._of_nodes

    def retain(self, participants: Collection[bytes]) -> None:
        """Forget the endpoints of all participants except those with these GUID prefixes."""
        with self._lock:
            self._of_nodes = {gid for gid in self._of_nodes if gid[:PREFIX_BYTES] in participants}


def _is_cyclone_endpoint(endpoint: Endpoint) -> bool:
    return endpoint.made_by is MadeBy.NATIVE and endpoint.id.startswith(CYCLONE.hex())


def _by_dds(endpoints: Iterable[Endpoint]) -> tuple[list[Endpoint], list[Endpoint]]:
    """Return the native servers (or clients) on Cyclone DDS, and the native ones on another DDS."""
    native = [server for server in endpoints if server.made_by is MadeBy.NATIVE]
    cyclone = [server for server in native if _is_cyclone_endpoint(server)]
    return cyclone, [server for server in native if server not in cyclone]


def called(servers: Iterable[Endpoint]) -> list[Endpoint]:
    """Return the native servers of a service that get its requests: if any is on another DDS, none on Cyclone DDS."""
    cyclone, others = _by_dds(servers)
    return others or cyclone


def mixed(endpoints: Iterable[Endpoint]) -> dict[str, str]:
    """Return which native clients and servers have different forms of requests, by the service's name.

    ROS 2 itself delivers the requests: the server executes them with wrong values, and its replies are lost.
    """
    clients: dict[str, list[Endpoint]] = {}
    servers: dict[str, list[Endpoint]] = {}
    for endpoint in endpoints:
        if endpoint.made_by is MadeBy.NATIVE and endpoint.kind in (Kind.CLIENT, Kind.SERVER):
            of_kind = clients if endpoint.kind is Kind.CLIENT else servers
            of_kind.setdefault(endpoint.topic, []).append(endpoint)
    pairs: dict[str, str] = {}
    for name in clients.keys() & servers.keys():
        cyclone_clients, other_clients = _by_dds(clients[name])
        cyclone, others = _by_dds(servers[name])
        texts = []
        if other_clients and cyclone:
            texts.append(f"client {_nodes(other_clients)}, server {_nodes(cyclone)} on Cyclone DDS")
        if cyclone_clients and others:
            texts.append(f"client {_nodes(cyclone_clients)} on Cyclone DDS, server {_nodes(others)}")
        if texts:
            pairs[name] = "; ".join(texts)
    return pairs


def _by_service(pairs: Mapping[str, str]) -> list[str]:
    """Return the pairs of `mixed` as text, with one entry for all parts of an action."""
    return sorted({f"{split(name)[0] or name} ({text})" for name, text in pairs.items()})


def mixed_warning(pairs: Sequence[str]) -> str:
    """Return a one-line warning for these pairs of `report`, "" without any."""
    return f"{', '.join(pairs)}: {_MIXED}; {CURE_MIXED}" if pairs else ""


def mixed_notes(endpoints: Iterable[Endpoint]) -> dict[str, list[str]]:
    """Return texts about the pairs of `mixed`, by service."""
    return {name: [f"{text}: {_MIXED}; {CURE_MIXED}"] for name, text in mixed(endpoints).items()}


def notes(endpoints: Collection[Endpoint]) -> dict[str, list[str]]:
    """Return texts by service: which servers are called, and which native clients get no replies."""
    texts = mixed_notes(endpoints)
    for name, text in _called_of_both(endpoints).items():
        texts.setdefault(name, []).insert(0, text)
    return texts


def _called_of_both(endpoints: Iterable[Endpoint]) -> dict[str, str]:
    """Return which servers are called, for each name that is served both on Cyclone DDS and on another DDS."""
    by_name: dict[str, list[Endpoint]] = {}
    for endpoint in endpoints:
        if endpoint.kind is Kind.SERVER:
            by_name.setdefault(endpoint.topic, []).append(endpoint)
    both = {name: _by_dds(servers) for name, servers in by_name.items()}
    return {
        name: f"calls go to {_nodes(others)}, and not to {_nodes(cyclone)} on Cyclone DDS"
        for name, (cyclone, others) in both.items()
        if cyclone and others
    }


def are_cyclone(servers: Iterable[Endpoint]) -> bool:
    """Return whether requests to these servers need Cyclone DDS's form."""
    cyclone, others = _by_dds(servers)
    return bool(cyclone) and not others


def of_servers(service: str, servers: Iterable[Endpoint]) -> Obstacle | None:
    """Return why a service with these servers cannot be called without a filter; None if it can."""
    cyclone, others = _by_dds(servers)
    if not cyclone or not others:
        return None
    reason = (
        f"{service} is served on Cyclone DDS ({_nodes(cyclone)}) and on another DDS ({_nodes(others)}): DDS delivers"
        " each request to all servers, and a server would execute a request in the other DDS's form with wrong values,"
        " so the request was not sent"
    )
    return Obstacle(reason, CURE)


def not_on_cyclone(service: str, servers: Iterable[Endpoint] = ()) -> Obstacle:
    """Return why a client on Cyclone DDS cannot call a service; ``servers`` are its servers on another DDS."""
    reason = (
        f"{service} is served on a DDS other than Cyclone DDS ({_nodes(servers) or UNNAMED}): Midspan, which is on"
        " Cyclone DDS, can neither send a request in the other's form nor match its reply"
    )
    return Obstacle(reason, _CURE_ON_CYCLONE)


def of_servers_not_on_cyclone(service: str, servers: Iterable[Endpoint]) -> Obstacle | None:
    """Return why a client on Cyclone DDS cannot call a service with these servers; None if it can."""
    _, others = _by_dds(servers)
    return not_on_cyclone(service, others) if others else None


def report(endpoints: Collection[Endpoint]) -> dict[str, list[str]]:
    """Return a report, empty if no node is on Cyclone DDS.

    ``nodes`` are the nodes on Cyclone DDS; ``both`` are the names served both there and on another DDS, without the
    services that every node has, such as those of its parameters; ``mixed`` has the pairs of `mixed`.
    """
    by_name: dict[str, list[Endpoint]] = {}
    nodes: set[str] = set()
    for endpoint in endpoints:
        if _is_cyclone_endpoint(endpoint):
            nodes.add(endpoint.node or UNNAMED)
        if endpoint.kind is Kind.SERVER and not endpoint.type.startswith(_OF_EACH_NODE):
            by_name.setdefault(endpoint.topic, []).append(endpoint)
    if not nodes:
        return {}
    both = {split(name)[0] or name for name, servers in by_name.items() if of_servers(name, servers)}
    return {"nodes": sorted(nodes), "both": sorted(both), "mixed": _by_service(mixed(endpoints))}


def warning(cyclone: dict[str, Any]) -> str:
    """Return a one-line warning for the result of `report`, "" if ``both`` is empty."""
    if not cyclone["both"]:
        return ""
    names = ", ".join(cyclone["both"])
    return f"{names}: served on Cyclone DDS and on another DDS, so the servers on Cyclone DDS are not called; {CURE}"


def _served_elsewhere(endpoints: Iterable[Endpoint]) -> list[Endpoint]:
    """Return the native servers on a DDS other than Cyclone DDS."""
    return _by_dds(end for end in endpoints if end.kind is Kind.SERVER)[1]


def report_on_cyclone(endpoints: Collection[Endpoint]) -> dict[str, list[str]]:
    """Return what a worker on Cyclone DDS reports: the ``nodes`` on it, ``mixed`` pairs, and what it cannot call.

    ``foreign`` are the nodes on another DDS that have servers, ``uncallable`` the services and actions of these nodes,
    without the services that every node has.
    """
    servers = _served_elsewhere(endpoints)
    names = {split(end.topic)[0] or end.topic for end in servers if not end.type.startswith(_OF_EACH_NODE)}
    return {
        "nodes": sorted({end.node or UNNAMED for end in endpoints if _is_cyclone_endpoint(end)}),
        "both": [],
        "mixed": _by_service(mixed(endpoints)),
        "foreign": sorted({end.node or UNNAMED for end in servers}),
        "uncallable": sorted(names),
    }


def warnings_on_cyclone(endpoints: Collection[Endpoint], served: Collection[str]) -> list[str]:
    """Return the warnings of a worker on Cyclone DDS about nodes on another DDS.

    Args:
        endpoints: all endpoints of the graph.
        served: the services that the worker serves.
    """
    report = report_on_cyclone(endpoints)
    warnings = [text] if (text := mixed_warning(report["mixed"])) else []
    names = report["uncallable"]
    if names:
        text = "served on a DDS other than Cyclone DDS, so they cannot be called"
        warnings.append(f"{', '.join(names)}: {text}; {_CURE_ON_CYCLONE}")
    clients = [end for end in endpoints if end.kind is Kind.CLIENT and end.topic in served]
    _, others = _by_dds(clients)
    if others:
        names = sorted({split(end.topic)[0] or end.topic for end in others})
        text = f"{_nodes(others)} on a DDS other than Cyclone DDS may call them, but gets no replies"
        warnings.append(f"{', '.join(names)}: {text}; {_CURE_ON_CYCLONE}")
    return warnings


def _nodes(endpoints: Iterable[Endpoint]) -> str:
    return ", ".join(sorted({endpoint.node or UNNAMED for endpoint in endpoints}))
