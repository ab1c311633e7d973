"""Which of the hub's own nodes need a relay, because the keys of their endpoints have different type hashes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from bridge.hub.endpoints.variants import REQUEST, RESPONSE, TypeVersions
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import UNKNOWN_HASH, EndpointKind
from bridge.hub.wire.keys import NO_HASH, has_key


class RelayKey(NamedTuple):
    """The publishers of a topic, or the clients of a service, whose keys have the same hash, which may be `NO_HASH`.

    ``grouped``: only what publishers with buffers send to the CPU group of their hash (`bridge.hub.wire.buffers`).
    """

    topic: str
    type_name: str
    type_hash: str
    grouped: bool = False


@dataclass(frozen=True, slots=True)
class TopicPair:
    """The publishers of one key, and the subscriptions that they do not reach.

    Attributes:
        publishers: the hub's own nodes that publish under the key.
        subscriptions: subscriptions of the hub's own nodes, by the hash of their key.
        others: GIDs of all other publishers of the topic.
    """

    publishers: tuple[HubEndpoint, ...]
    subscriptions: Mapping[str, tuple[HubEndpoint, ...]]
    others: frozenset[bytes]


@dataclass(frozen=True, slots=True)
class ServicePair:
    """The present clients of one key, and the servers of another key that can answer after a conversion.

    Attributes:
        clients: clients of the hub's own nodes; there may be none yet.
        type_hash: the hash of the servers' key, `NO_HASH` before the first server appears.
        servers: servers of the hub's own nodes, sorted by their sessions; there may be none yet.
    """

    clients: tuple[HubEndpoint, ...]
    type_hash: str
    servers: tuple[HubEndpoint, ...]


def is_native(endpoint: HubEndpoint, midspan: Collection[str]) -> bool:
    """Return whether an endpoint belongs to a node of the hub that is not Midspan's.

    ``midspan`` contains the sessions (zid) of Midspan programs.
    """
    return not (endpoint.own or endpoint.origin or endpoint.pending or endpoint.zid in midspan)


def _is_relayable(endpoint: HubEndpoint, midspan: Collection[str]) -> bool:
    return is_native(endpoint, midspan) and has_key(endpoint.key_hash)


def topic_pairs(
    endpoints: Iterable[HubEndpoint], midspan: Collection[str], versions: TypeVersions
) -> dict[RelayKey, TopicPair]:
    """Return the publishers that need a relay to subscriptions with another version that can be converted.

    Publishers with buffers also need one to subscriptions with the same hash that are not in the CPU group. These are
    served only if all subscriptions with this hash are such, because the others would receive each message twice.
    """
    publishers: dict[RelayKey, list[HubEndpoint]] = defaultdict(list)
    subscriptions: dict[tuple[str, str], dict[str, list[HubEndpoint]]] = defaultdict(lambda: defaultdict(list))
    gids: dict[str, set[bytes]] = defaultdict(set)
    for end in endpoints:
        if end.kind is EndpointKind.PUBLISHER:
            gids[end.topic].add(end.gid)
            if _is_relayable(end, midspan):
                publishers[RelayKey(end.topic, end.type_name, end.key_hash)].append(end)
        elif end.kind is EndpointKind.SUBSCRIPTION and end.type_hash != UNKNOWN_HASH and _is_relayable(end, midspan):
            subscriptions[end.topic, end.type_name][end.key_hash].append(end)
    pairs: dict[RelayKey, TopicPair] = {}
    for key, senders in publishers.items():
        missed = {
            other: tuple(ends)
            for other, ends in subscriptions.get((key.topic, key.type_name), {}).items()
            if other != key.type_hash and versions.converter(key.type_name, key.type_hash, other) is not None
        }
        if missed:
            others = gids[key.topic] - {end.gid for end in senders}
            pairs[key] = TopicPair(tuple(senders), missed, frozenset(others))
        same = subscriptions.get((key.topic, key.type_name), {}).get(key.type_hash, [])
        buffered = tuple(end for end in senders if end.buffers)
        if buffered and same and not any(end.buffers for end in same):
            others = gids[key.topic] - {end.gid for end in buffered}
            pairs[key._replace(grouped=True)] = TopicPair(buffered, {key.type_hash: tuple(same)}, frozenset(others))
    return pairs


def topics_of(pairs: Mapping[RelayKey, TopicPair], sessions: Collection[str]) -> dict[RelayKey, TopicPair]:
    """Return the pairs with publishers of these sessions only."""
    chosen: dict[RelayKey, TopicPair] = {}
    for key, pair in pairs.items():
        publishers = tuple(end for end in pair.publishers if end.zid in sessions)
        if publishers:
            others = pair.others | {end.gid for end in pair.publishers if end.zid not in sessions}
            chosen[key] = TopicPair(publishers, pair.subscriptions, others)
    return chosen


def service_pairs(
    endpoints: Iterable[HubEndpoint], midspan: Collection[str], versions: TypeVersions
) -> dict[RelayKey, ServicePair]:
    """Return the keys on which no server answers, although a server with another version could, after a conversion.

    They include keys without a client, and keys of clients that wait for a server: a client may call as soon as it sees
    a server's token, and its call is not repeated. A service with a server of Midspan needs no relay, because that
    server accepts all versions. One with a client of Midspan is relayed only if it has a server, because that client
    regards any queryable as a server until a server announces a token. If the servers have several other versions,
    those with the smallest hash are called.
    """
    clients: dict[tuple[str, str], dict[str, list[HubEndpoint]]] = defaultdict(lambda: defaultdict(list))
    servers: dict[tuple[str, str], dict[str, list[HubEndpoint]]] = defaultdict(lambda: defaultdict(list))
    covered: set[tuple[str, str]] = set()
    expected: set[tuple[str, str]] = set()
    hashless = hashed = False
    for end in endpoints:
        name = end.topic, end.type_name
        if not is_native(end, midspan):
            if end.kind is EndpointKind.SERVER:
                covered.add(name)
            elif end.kind is EndpointKind.CLIENT:
                expected.add(name)
            continue
        if not has_key(end.key_hash):
            continue
        hashless, hashed = hashless or end.hashless, hashed or not end.hashless
        if end.kind is EndpointKind.CLIENT:
            clients[name][end.key_hash].append(end)
        elif end.kind is EndpointKind.SERVER:
            servers[name][end.key_hash].append(end)
    pairs: dict[RelayKey, ServicePair] = {}
    for name, known in servers.items():
        callers = clients.get(name, {})
        others = {*callers, *(versions.hashes(name[1]) if hashed else ()), *([NO_HASH] if hashless else [])}
        for other in others - known.keys() if name not in covered else ():
            key = RelayKey(*name, other)
            usable = [server for server in sorted(known) if _converts(versions, key, server)]
            if usable:
                ends = sorted(known[usable[0]], key=lambda end: end.zid)
                pairs[key] = ServicePair(tuple(callers.get(other, ())), usable[0], tuple(ends))
    for name in clients.keys() - servers.keys() - covered - expected:
        possible = {*(versions.hashes(name[1]) if hashed else ()), *([NO_HASH] if hashless else [])}
        for own, waiting in clients[name].items():
            key = RelayKey(*name, own)
            if any(_converts(versions, key, other) for other in possible - {own}):
                pairs[key] = ServicePair(tuple(waiting), NO_HASH, ())
    return pairs


def _converts(versions: TypeVersions, key: RelayKey, other: str) -> bool:
    name, own = key.type_name, key.type_hash
    request, response = versions.converter(name, own, other, REQUEST), versions.converter(name, other, own, RESPONSE)
    return request is not None and response is not None
