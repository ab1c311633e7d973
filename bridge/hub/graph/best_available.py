"""Resolves the policies that an endpoint leaves open (BEST_AVAILABLE) against the endpoints that it matches.

rmw_zenoh writes such policies into the token as they are (rmw_zenoh_cpp 0.2.10, qos.cpp, ``best_available_qos``), so
each reader of the graph resolves them. The rules are those of rmw_dds_common (Jazzy, qos.cpp; from ros2/rmw #320): the
strongest policy that matches all endpoints of the topic. The policy of a DDS endpoint is fixed when it is created; here
the policy follows the graph, because rmw_zenoh delivers under any combination of policies.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Protocol

from bridge.hub.graph.tokens import EndpointKind
from bridge.hub.wire.qos import BEST_AVAILABLE_NS, Durability, Qos, Reliability
from bridge.messages.velocities import VELOCITIES


class GraphEndpoint(Protocol):
    """The properties of an endpoint that its resolution needs."""

    @property
    def kind(self) -> EndpointKind: ...

    @property
    def type_name(self) -> str:
        """The type's ROS 2 name."""

    @property
    def qos(self) -> Qos:
        """The QoS, with open policies as they were last resolved."""


class BestAvailable:
    """The open policies in one graph, resolved only when the graph is read, because thousands of tokens may arrive."""

    def __init__(self) -> None:
        self._announced: dict[str, Qos] = {}
        self._changed: set[str] = set()

    def add(self, key: str, topic: str, qos: Qos) -> None:
        """Add an endpoint, identified by its token, with the QoS that it announced."""
        if qos.best_available:
            self._announced[key] = qos
        if self._announced:
            self._changed.add(topic)

    def remove(self, key: str, topic: str, *, last: bool) -> None:
        """Remove an endpoint; ``last``: whether it was the topic's only endpoint."""
        if last:
            self._changed.discard(topic)
        elif self._announced:
            self._changed.add(topic)
        self._announced.pop(key, None)

    def pop_resolved(self, topics: Mapping[str, Mapping[str, GraphEndpoint]]) -> Iterator[tuple[str, str, Qos]]:
        """Yield topic, token and new QoS of each endpoint that changed, given all endpoints by topic and token."""
        changed, self._changed = self._changed, set()
        for name in changed:
            topic = topics.get(name, {})
            for type_name in {topic[key].type_name for key in self._announced.keys() & topic.keys()}:
                matched = {key: endpoint for key, endpoint in topic.items() if endpoint.type_name == type_name}
                announced = {key: (end.kind, self._announced.get(key, end.qos)) for key, end in matched.items()}
                for key, qos in resolve(type_name, announced).items():
                    if qos != matched[key].qos:
                        yield name, key, qos


def resolve(type_name: str, announced: Mapping[str, tuple[EndpointKind, Qos]]) -> dict[str, Qos]:
    """Return the QoS of each endpoint of one topic and type, by the same keys, with all open policies resolved.

    Publishers are resolved first, because the policies of subscriptions depend on those of publishers.
    """
    requested = [qos for kind, qos in announced.values() if kind is EndpointKind.SUBSCRIPTION]
    finite = (qos.deadline_ns for qos in requested if qos.deadline_ns != BEST_AVAILABLE_NS)
    shortest = min((deadline for deadline in finite if deadline is not None), default=None)
    # rmw_zenoh stores nothing for a volatile publisher, and a bridge must not store velocities either
    durability = Durability.VOLATILE if type_name in VELOCITIES else Durability.TRANSIENT_LOCAL
    offer = Qos(Reliability.RELIABLE, durability, deadline_ns=shortest)
    resolved = {key: _fill_open(qos, offer) for key, (kind, qos) in announced.items() if kind is EndpointKind.PUBLISHER}
    request = _strongest(resolved.values())
    for key, (kind, qos) in announced.items():
        if kind is EndpointKind.SUBSCRIPTION:
            resolved[key] = _fill_open(qos, request)
        elif kind is not EndpointKind.PUBLISHER:
            resolved[key] = _fill_open(qos, Qos())  # services: ``rmw_qos_profile_services_default``
    return resolved


def _strongest(offered: Iterable[Qos]) -> Qos:
    """Return the strongest policies that all of these publishers offer; without publishers, the strongest possible."""
    offers = list(offered)
    reliable = all(qos.reliability is Reliability.RELIABLE for qos in offers)
    durable = all(qos.durability is Durability.TRANSIENT_LOCAL for qos in offers)
    deadlines = [qos.deadline_ns for qos in offers if qos.deadline_ns is not None]
    return Qos(
        Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT,
        Durability.TRANSIENT_LOCAL if durable else Durability.VOLATILE,
        deadline_ns=max(deadlines) if offers and len(deadlines) == len(offers) else None,
    )


def _fill_open(qos: Qos, best: Qos) -> Qos:
    """Return ``qos`` with its open policies set to those of ``best``."""
    if not qos.best_available:
        return qos
    return replace(
        qos,
        reliability=best.reliability if qos.reliability is Reliability.BEST_AVAILABLE else qos.reliability,
        durability=best.durability if qos.durability is Durability.BEST_AVAILABLE else qos.durability,
        deadline_ns=best.deadline_ns if qos.deadline_ns == BEST_AVAILABLE_NS else qos.deadline_ns,
    )
