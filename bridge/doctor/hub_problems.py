"""Problems that the hub's graph and the workers' documents show: differing types, a missing planner."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bridge.client.graph import owners
from bridge.config.sections.navigation import OURS, NavigationSection, Planner
from bridge.doctor.relayed import Relayed, is_relayed
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import UNKNOWN_HASH, EndpointKind
from bridge.hub.wire.keys import NO_HASH
from bridge.messages.actions import split
from bridge.module_keys import GatewayKeys
from bridge.sides import label
from bridge.status import StatusDocument, refused_routes
from navigation import lifecycle

if TYPE_CHECKING:
    from bridge.hub.endpoints.variants import TypeVersions

CURE = "install the same version of the message package on both machines, or name its folder in types.folders"

CURE_SEPARATED = (
    "Midspan relays between versions that it knows while a worker of a side runs and no rule denies it; otherwise use"
    " the same release for both, or run one of them on DDS (docs/sides/hub.md)"
)
_TOPIC_ENDS = (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION)


@dataclass(frozen=True, slots=True)
class Note:
    """An observation or problem, and its cure if there is one."""

    text: str
    cure: str = ""


def conflicts(
    endpoints: Iterable[HubEndpoint],
    workers: Collection[str] = (),
    versions: Callable[[], TypeVersions] | None = None,
    relayed: Relayed = (),
) -> list[Note]:
    """Return topics of the hub with several types, or with several hashes of one type that are not converted.

    Args:
        endpoints: of the hub.
        workers: sessions (zid) of Midspan workers, which convert between the known versions of a type.
        versions: returns the known versions; called only if hashes differ. None: no version is converted.
        relayed: what workers relay.
    """
    topics: dict[str, dict[str, dict[str, list[HubEndpoint]]]] = {}
    ends: dict[str, list[HubEndpoint]] = {}
    for endpoint in endpoints:
        if endpoint.kind in (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION):
            ends.setdefault(endpoint.topic, []).append(endpoint)
            hashes = topics.setdefault(endpoint.topic, {}).setdefault(endpoint.type_name, {})
            if endpoint.type_hash not in (NO_HASH, UNKNOWN_HASH):
                hashes.setdefault(endpoint.type_hash, []).append(endpoint)
    notes: list[Note] = []
    for topic, types in sorted(topics.items()):
        if len(types) > 1 and not _all_received(ends[topic]):
            text = f"{topic} has {len(types)} types on the hub ({', '.join(sorted(types))}) that do not match"
            notes.append(Note(text, "give one of them another name, or rename one with a rule"))
        for type_name, hashes in sorted(types.items()):
            if len(hashes) > 1 and not _is_converted(type_name, hashes, workers, versions, relayed):
                holders = "; ".join(f"{owners(e)} {h[:17]}..." for h, e in sorted(hashes.items()))
                text = f"{topic}: the definitions of {type_name} differ ({holders}); no messages are exchanged"
                notes.append(Note(text, CURE))
    return notes


def _is_converted(
    type_name: str, hashes: Mapping[str, list[HubEndpoint]], workers: Collection[str],
    versions: Callable[[], TypeVersions] | None, relayed: Relayed,
) -> bool:  # fmt: skip
    """Return whether all versions are known, and are relayed between native publishers and subscriptions."""
    native = [e for ends in hashes.values() for e in ends if not (e.origin or e.zid in workers)]
    published, subscribed = ([e for e in native if e.kind is kind] for kind in _TOPIC_ENDS)
    if versions is None or any(
        one.type_hash != other.type_hash and not is_relayed(one, [other], relayed)
        for one in published
        for other in subscribed
    ):
        return False
    known = versions()
    return len({known.here(type_name, type_hash) for type_hash in hashes}) == 1


def separated(endpoints: Iterable[HubEndpoint], workers: Collection[str] = (), relayed: Relayed = ()) -> list[Note]:
    """Return which native nodes of different releases on the hub do not reach each other, and are not relayed.

    rmw_zenoh shows such nodes as connected, since its graph compares only names. Topics whose hashes differ are among
    the `conflicts`.

    Args:
        endpoints: of the hub.
        workers: sessions (zid) of Midspan workers, whose servers accept all versions.
        relayed: what workers relay.
    """
    ends: dict[tuple[str, str], dict[EndpointKind, list[HubEndpoint]]] = {}
    for end in endpoints:
        ends.setdefault((end.topic, end.type_name), {}).setdefault(end.kind, []).append(end)
    notes: list[Note] = []
    for (name, type_name), kinds in sorted(ends.items()):
        native = {
            kind: [e for e in of_kind if not (e.origin or e.pending or e.own or e.zid in workers)]
            for kind, of_kind in kinds.items()
        }
        servers = native.get(EndpointKind.SERVER, [])
        clients = [
            e
            for e in native.get(EndpointKind.CLIENT, ())
            if e.key_hash not in {server.key_hash for server in servers} and not is_relayed(e, servers, relayed)
        ]
        if clients and servers and len(servers) == len(kinds[EndpointKind.SERVER]):
            text = f"{name}: {owners(clients)} never get a reply from {owners(servers)} on the hub"
            notes.append(Note(f"{text}: they have different versions of {type_name}", CURE_SEPARATED))
        publishers, subscriptions = (native.get(kind, []) for kind in _TOPIC_ENDS)
        for sender in publishers:
            receivers = [e for e in subscriptions if _misses(e, sender) and not is_relayed(sender, [e], relayed)]
            if receivers:
                why = (
                    "only nodes of Lyrical receive its buffers" if sender.buffers else "one of them has no type hashes"
                )
                text = (
                    f"{name}: {owners(receivers)} do not receive the messages of {owners([sender])} on the hub: {why}"
                )
                notes.append(Note(text, CURE_SEPARATED))
    return notes


def _misses(subscription: HubEndpoint, publisher: HubEndpoint) -> bool:
    if subscription.type_hash == UNKNOWN_HASH:  # it accepts all
        return False
    return subscription.hashless is not publisher.hashless or (publisher.buffers and not subscription.buffers)


def _all_received(endpoints: Iterable[HubEndpoint]) -> bool:
    """Whether each subscribing node receives from every publisher of a topic with several types."""
    published: set[str] = set()
    publishers: dict[tuple[str, str, str], set[str]] = {}
    for e in endpoints:
        if e.kind is EndpointKind.PUBLISHER:
            published.add(e.type_name)
        else:
            publishers.setdefault((e.zid, e.namespace, e.node), set()).add(e.type_name)
    common = set.intersection(*publishers.values()) if publishers else set()
    return bool(common) and published <= common


def inactive_nodes(gateway: StatusDocument) -> Note | None:
    """Return a note on the planner's inactive lifecycle nodes, from a gateway's status document; None without any."""
    states = gateway.other(GatewayKeys).inactive_nodes
    return Note(lifecycle.trouble(states), lifecycle.cure(states)) if states else None


_CHECKS = {"ros1": "ros1-packages and ros1-master", "ros2": "ros2-packages and ros2-environment"}


def absence(
    section: NavigationSection, planner: str, endpoints: Iterable[HubEndpoint], documents: Sequence[StatusDocument]
) -> Note | None:
    """Return why a planner is absent; None if its action is on the hub, or if it is not configured for the gateway."""
    if planner not in section.choices:
        return None
    action = section.at(planner)
    if any(e.kind is EndpointKind.SERVER and split(e.topic)[0] == action for e in endpoints):
        return None
    other = None if planner in OURS else section.others[planner]
    if other is None:
        reason, cure = _of_module(f"modules.{planner}.enabled: true; if it is")
    elif other.factory:
        reason, cure = _of_module(f"put the folder of {other.factory.partition(':')[0]} on PYTHONPATH; if it is there")
    else:
        reason, cure = _of_program(other, documents)
    return Note(f"the planner {planner} is not available: {reason}", cure)


def _of_module(cure: str) -> tuple[str, str]:
    return "its module does not run", f"{cure}, 'midspan status' and the log show why it does not start"


def _of_program(planner: Planner, documents: Sequence[StatusDocument]) -> tuple[str, str]:
    side = planner.side
    where = "the hub" if side == "zenoh" else label(side)
    workers = [document for document in documents if document.side == side]
    if side in _CHECKS and not workers:
        return f"no worker of the {where} side answers", f"see the checks {_CHECKS[side]}, and 'midspan status'"
    if side in _CHECKS and all(document.state == "waiting" for document in workers):
        return f"its side, {where}, is unavailable", f"see the checks {_CHECKS[side]}"
    for document in workers:
        for route in refused_routes(document):
            if route.direction == "in" and route.topic.startswith(f"{planner.action}/"):
                return f"its action {planner.action} cannot be bridged: {route.reason}", route.cure
    return (
        f"no node serves its action {planner.action} on {where}",
        f"start {planner.name} there, or name another planner in navigation.planner",
    )
