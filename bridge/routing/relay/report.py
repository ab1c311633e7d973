"""What a worker relays, for the status document."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

from bridge.hub.endpoints.variants import REQUEST, RESPONSE, TypeVersions
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.owners import owner
from bridge.routing.relay.pairs import RelayKey
from bridge.routing.relay.service import RelayedService
from bridge.routing.relay.topic import RelayedTopic
from bridge.status import RelayedStatus

_MAX_ROWS = 1000


def relayed_rows(
    topics: Iterable[RelayedTopic], services: Iterable[RelayedService], versions: TypeVersions
) -> list[RelayedStatus]:
    """Return the relayed topics, and the relayed services that have a client."""
    rows = [
        *(_topic_row(topic, versions) for topic in topics),
        *(_service_row(service, versions) for service in services if service.pair.clients),
    ]
    return sorted(rows, key=lambda row: (row.topic, row.hash))[:_MAX_ROWS]


def _topic_row(relayed: RelayedTopic, versions: TypeVersions) -> RelayedStatus:
    (topic, type_name, source, _), pair, counters = relayed.key, relayed.pair, relayed.counters
    drops = {reason: count for reason, count in counters.drops.items() if count}
    return RelayedStatus(
        kind="topic", topic=topic, type=type_name, hash=source, others=sorted(pair.subscriptions),
        senders=_names(pair.publishers), receivers=_names(end for ends in pair.subscriptions.values() for end in ends),
        messages=counters.messages, drops=drops, error=counters.error,
        losses=_losses(relayed.key, ((source, target, "") for target in pair.subscriptions), versions),
    )  # fmt: skip


def _service_row(relayed: RelayedService, versions: TypeVersions) -> RelayedStatus:
    (name, type_name, own, _), pair, other = relayed.key, relayed.pair, relayed.pair.type_hash
    return RelayedStatus(
        kind="service", topic=name, type=type_name, hash=own, others=[other],
        senders=_names(pair.clients), receivers=_names(pair.servers),
        messages=relayed.counters.messages, error=relayed.counters.error,
        losses=_losses(relayed.key, ((own, other, REQUEST), (other, own, RESPONSE)), versions),
    )  # fmt: skip


def _names(endpoints: Iterable[HubEndpoint]) -> list[str]:
    return sorted({owner(endpoint) for endpoint in endpoints})


def _losses(key: RelayKey, conversions: Iterable[tuple[str, str, str]], versions: TypeVersions) -> str:
    """Return the fields that conversions (source hash, target hash, part) leave out or change, "" if none."""
    lost: dict[str, None] = {}
    changed: dict[str, None] = {}
    for source, target, part in conversions:
        left_out, other = versions.losses(key.type_name, source, target, part)
        lost.update(dict.fromkeys(left_out))
        changed.update(dict.fromkeys(other))
    return "; ".join(_texts(lost, changed))


def _texts(lost: Collection[str], changed: Collection[str]) -> Iterator[str]:
    if lost:
        yield f"{', '.join(lost)} {'is' if len(lost) == 1 else 'are'} left out"
    yield from changed
