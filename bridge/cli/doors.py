"""Commands of other machines that a door refuses (`hub.open.trusted`).

zenoh drops them at the door without a word, so it is told from who is where: which machines a router does not trust,
which sessions are theirs, and what those publish.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import zenoh

from bridge.cli.hubclient import Client
from bridge.cli.routes_table import Document, dicts, route_list
from bridge.cli.text import plural
from bridge.config.commands import commands
from bridge.config.sections.routing import RoutingSection
from bridge.doctor import hubtypes
from bridge.hub.errors import WireError
from bridge.hub.graph import HubEndpoint
from bridge.hub.keyexpr import topic_key
from bridge.hub.trust import harmless_keys


@dataclass(frozen=True, slots=True)
class Refusal:
    """One topic's commands of one machine, refused by another.

    Attributes:
        daemon: whose door refuses them.
        machine: whose they are, by the name in its certificate; "" where it showed none.
        nodes: its publishers of the topic, for people.
        messages: how many its bridge has said so far; None where its publishers are no bridge's, and nobody counts.
    """

    daemon: str
    machine: str
    topic: str
    type: str
    nodes: str
    messages: int | None

    @property
    def text(self) -> str:
        """For people."""
        who = self.machine or "a machine without a certificate"
        count = "" if self.messages is None else f"; {plural(self.messages, 'message')} so far"
        return f"{self.daemon} refuses the commands of {who} on {self.topic} ({self.nodes}){count}"

    @property
    def cure(self) -> str:
        """What to do where they are meant to be obeyed."""
        name = f"name {self.machine!r}" if self.machine else "give it a certificate (midspan keys), and name that"
        return f"where that is not meant, {name} in hub.open.trusted of {self.daemon} and reload"


def refusals(client: Client, documents: Iterable[Document]) -> list[Refusal]:
    """What the doors refuse now, by the workers' status documents and the hub's graph, which has settled."""
    documents = list(documents)
    publishers = client.hub.graph.publishers()
    found: list[Refusal] = []
    for router in documents:
        distrusted = [machine for machine in dicts(router.get("machines")) if not machine.get("trusted")]
        if not distrusted:
            continue
        harmless = _harmless(router.get("commands"))
        for machine in distrusted:
            theirs = _sessions(str(machine.get("zid")), documents)
            groups = _by_topic(e for e in publishers if e.zid in theirs)
            refused = [group for group in groups if not _is_among(harmless, group[0], client.hub.domain)]
            found += [_refusal(router, machine, group, documents) for group in refused]
    return found


def _refusal(
    router: Document, machine: Document, publishers: Sequence[HubEndpoint], documents: Iterable[Document]
) -> Refusal:
    first = publishers[0]
    zids = {publisher.zid for publisher in publishers}
    counted = [
        int(route.get("messages") or 0)
        for document in documents
        if document.get("zid") in zids
        for route in route_list(document)
        if (route.get("direction"), route.get("hub_topic")) == ("in", first.topic)
    ]
    return Refusal(
        str(router.get("daemon")),
        str(machine.get("name") or ""),
        first.topic,
        first.type_name,
        hubtypes.nodes(publishers),
        sum(counted) if counted else None,
    )


def _sessions(zid: str, documents: Iterable[Document]) -> set[str]:
    """The sessions of the machine that a door is linked to: its own, or those of the router behind its own door."""
    behind = [document.get("members") or () for document in documents if document.get("door") == zid]
    return {zid} | {str(session) for members in behind for session in members}


def _by_topic(publishers: Iterable[HubEndpoint]) -> Iterable[list[HubEndpoint]]:
    groups: dict[tuple[str, str], list[HubEndpoint]] = {}
    for publisher in publishers:
        groups.setdefault((publisher.topic, publisher.type_name), []).append(publisher)
    return [groups[key] for key in sorted(groups)]


def _harmless(commanding: object) -> list[zenoh.KeyExpr]:
    """The keys that a router lets everybody say, by the commands of its document."""
    usual = commands(RoutingSection())
    told = commanding.items() if isinstance(commanding, Mapping) else ()
    table = usual | {str(name): frozenset(map(str, parts)) for name, parts in told if isinstance(parts, list)}
    try:
        return [zenoh.KeyExpr(key) for key in harmless_keys(table)]
    except (WireError, zenoh.ZError):  # no types, or no names
        return [zenoh.KeyExpr(key) for key in harmless_keys(usual)]


def _is_among(keys: Iterable[zenoh.KeyExpr], endpoint: HubEndpoint, domain: int) -> bool:
    key = zenoh.KeyExpr(topic_key(domain, endpoint.topic, endpoint.type_name, endpoint.type_hash))
    return any(each.includes(key) for each in keys)
