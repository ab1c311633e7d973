"""Commands and calls from other machines that a router refuses (`hub.open.trusted`).

zenoh drops them at the external listener without a report, so they are derived. The routers' status documents show
the untrusted machines and their sessions; the hub's graph shows what these sessions publish and call.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import zenoh

from bridge.client.graph import owners
from bridge.client.session import Client
from bridge.config.rules import commands
from bridge.config.sections.routing import RoutingSection
from bridge.hub.errors import HubWireError
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import EndpointKind
from bridge.hub.security.access import QUESTIONS, harmless_keys
from bridge.hub.wire.keys import topic_key
from bridge.status import MachineStatus, RouterStatus, StatusDocument, read_status, routers_of
from bridge.text import plural

_QUESTIONS = [zenoh.KeyExpr(key) for key in QUESTIONS]


@dataclass(frozen=True, slots=True)
class Refusal:
    """Commands on one topic, or calls to one service, from one machine that another machine refuses.

    ``daemon`` is the refusing daemon; ``machine`` is the name in the refused machine's certificate, "" if it has none;
    ``messages`` is the number of messages or calls that the machine's bridge has sent, None if no bridge counts them.
    """

    daemon: str
    machine: str
    topic: str
    type: str
    nodes: str
    messages: int | None
    is_service: bool

    @property
    def text(self) -> str:
        """Return the refusal as a sentence."""
        machine = self.machine or "a machine without a certificate"
        unit, phrase = (
            ("call", f"calls of {machine} to") if self.is_service else ("message", f"commands of {machine} on")
        )
        count = "" if self.messages is None else f"; {plural(self.messages, unit)} so far"
        return f"{self.daemon} refuses the {phrase} {self.topic} ({self.nodes}){count}"

    @property
    def cure(self) -> str:
        """Return what to change if the commands should be accepted."""
        name = f"name {self.machine!r}" if self.machine else "give it a certificate (midspan keys), and write its name"
        return f"if that is not intended, {name} in hub.open.trusted of {self.daemon} and reload"


def refusals(client: Client, documents: Sequence[StatusDocument]) -> list[Refusal]:
    """Wait until the hub's graph has settled; return what routers refuse according to it and the status documents."""
    graph = client.hub.graph
    refused: list[Refusal] = []
    for router in routers_of(documents):
        distrusted = [machine for machine in router.machines if not machine.trusted]
        if not distrusted:
            continue
        harmless = _harmless(router.commands)
        zids = {endpoint.zid for endpoint in graph.endpoints()}
        for machine in distrusted:
            sessions = _sessions(router, machine, documents, zids)
            served = {server.topic for server in graph.servers() if server.zid not in sessions}
            for endpoints, allowed in ((graph.publishers(), harmless), (graph.clients(), _QUESTIONS)):
                groups = _by_topic(e for e in endpoints if e.zid in sessions)
                refused_groups = [g for g in groups if not _is_among(allowed, _key(g[0], client.hub.domain))]
                reports = (_refusal(router, machine, group, documents) for group in refused_groups)
                refused += [r for r in reports if not r.is_service or (r.topic in served and r.messages != 0)]
    return refused


def refusals_of_own(client: Client, published: Iterable[tuple[str, str, str]]) -> list[Refusal]:
    """Return what routers refuse of this program's topics; ``published``: name, type and type hash of each topic."""
    answers = client.ask("status", worker="router")
    routers = routers_of(read_status(a.value, a.daemon, a.worker, a.error) for a in answers)
    topics, refused, own = list(published), list[Refusal](), client.hub.zid
    for router in routers:
        harmless = _harmless(router.commands)
        for machine in router.machines:
            if machine.trusted or own not in _sessions(router, machine, routers, {own}):
                continue
            for topic, type_name, type_hash in topics:
                if not _is_among(harmless, topic_key(client.hub.domain, topic, type_name, type_hash)):
                    names = router.daemon, machine.name, topic, type_name
                    refused.append(Refusal(*names, "this command", None, is_service=False))
    return refused


def _refusal(
    router: RouterStatus,
    machine: MachineStatus,
    endpoints: Sequence[HubEndpoint],
    documents: Iterable[StatusDocument],
) -> Refusal:
    first = endpoints[0]
    is_service = first.kind is EndpointKind.CLIENT
    direction = "out" if is_service else "in"
    zids = {endpoint.zid for endpoint in endpoints}
    counted = [
        (route.calls if is_service else route.messages) or 0
        for document in documents
        if document.zid in zids
        for route in document.routes
        if (route.direction, route.hub_topic) == (direction, first.topic)
    ]
    return Refusal(
        router.daemon,
        machine.name,
        first.topic,
        first.type_name,
        owners(endpoints),
        sum(counted) if counted else None,
        is_service,
    )


def _sessions(
    router: RouterStatus, machine: MachineStatus, documents: Sequence[StatusDocument], known: Collection[str]
) -> set[str]:
    """Return the sessions that reach a router through its link with a machine, from ``known`` and from the documents.

    These are the sessions of the machine and of the routers connected to it, even if the machine is a router without a
    status document, such as zenohd. If the router has no other machine, these are all sessions except the router's own.
    """
    links: dict[str, set[str]] = defaultdict(set)
    members: dict[str, set[str]] = {}
    for other_router in routers_of(documents):
        if external := other_router.door:
            members[external] = set(other_router.members)
            for other in other_router.machines:
                links[external].add(other.zid)
                links[other.zid].add(external)
    door = router.door
    visited, unvisited = links[door] | {door}, [machine.zid]  # another machine of the router has its own link
    sessions = {machine.zid}
    while unvisited:
        zid = unvisited.pop()
        sessions |= {zid} | members.get(zid, set())
        unvisited += links[zid] - visited
        visited |= links[zid]
    own = members.get(door, set())
    if len(links[door]) == 1 and len(own) >= (router.sessions or 1):  # the list of the router's sessions is complete
        own |= {document.zid for document in documents if document.daemon == router.daemon}
        sessions |= set(known) - own
    return sessions


def _by_topic(endpoints: Iterable[HubEndpoint]) -> Iterable[list[HubEndpoint]]:
    groups: dict[tuple[str, str], list[HubEndpoint]] = {}
    for endpoint in endpoints:
        groups.setdefault((endpoint.topic, endpoint.type_name), []).append(endpoint)
    return [groups[key] for key in sorted(groups)]


def _harmless(commanding: Mapping[str, Sequence[str]]) -> list[zenoh.KeyExpr]:
    """Return the keys on which every machine may publish, given the commands in the router's status document."""
    usual = commands(RoutingSection())
    table = usual | {name: frozenset(parts) for name, parts in commanding.items()}
    try:
        return [zenoh.KeyExpr(key) for key in harmless_keys(table)]
    except (HubWireError, zenoh.ZError):  # invalid types or names
        return [zenoh.KeyExpr(key) for key in harmless_keys(usual)]


def _key(endpoint: HubEndpoint, domain: int) -> str:
    return topic_key(domain, endpoint.topic, endpoint.type_name, endpoint.type_hash)


def _is_among(allowed: Iterable[zenoh.KeyExpr], key: str) -> bool:
    return any(expression.includes(zenoh.KeyExpr(key)) for expression in allowed)
