"""Endpoints that announce no type hash, such as those of Humble, and the hashes that the graph assumes for them.

Such an endpoint may use any version of its type, so the graph assumes the version that other endpoints of its kind
announce. Otherwise the hash remains `NO_HASH`, and readers of the graph use the installed definition.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

from bridge.hub.graph.tokens import UNKNOWN_HASH, EndpointKind
from bridge.hub.wire.keys import NO_HASH
from bridge.hub.wire.qos import Qos


class HashedEndpoint(Protocol):
    """The properties of an endpoint that determine its hash."""

    @property
    def kind(self) -> EndpointKind:
        """Publisher, subscription, server or client."""

    @property
    def topic(self) -> str:
        """The topic or service."""

    @property
    def type_name(self) -> str:
        """The type's ROS 2 name."""

    @property
    def type_hash(self) -> str:
        """The hash, or `NO_HASH`."""

    @property
    def qos(self) -> Qos:
        """The QoS."""

    @property
    def own(self) -> bool:
        """Whether it belongs to this session."""


KindOfEndpoint = tuple[EndpointKind, str, str]
"""Kind, topic or service, and type of an endpoint."""


class MissingHashes:
    """The endpoints without a hash on one graph, whose lock guards it.

    Attributes:
        version: changes whenever such an endpoint of another session appears or leaves.
    """

    def __init__(self) -> None:
        self.version = 0
        self._keys: set[str] = set()
        self._changed: set[str] = set()

    def added(self, key: str, endpoint: HashedEndpoint) -> None:
        """Add an endpoint, by its token."""
        if endpoint.type_hash == NO_HASH:
            self._keys.add(key)
            self.version += not endpoint.own
        if self._keys:
            self._changed.add(endpoint.topic)

    def removed(self, key: str, endpoint: HashedEndpoint, *, last: bool) -> None:
        """Remove an endpoint; ``last``: no endpoint is left on its topic."""
        if key in self._keys:
            self._keys.discard(key)
            self.version += not endpoint.own
        if last:
            self._changed.discard(endpoint.topic)
        elif self._keys:
            self._changed.add(endpoint.topic)

    def resolved(self, topics: Mapping[str, Mapping[str, HashedEndpoint]]) -> Iterator[tuple[str, str, str]]:
        """Yield topic, token and new hash of each endpoint that changed, given all endpoints by topic and token."""
        changed, self._changed = self._changed, set()
        for name in changed:
            topic = topics.get(name, {})
            for key in self._keys & topic.keys():
                type_hash = self._announced(topic, topic[key])
                if type_hash != topic[key].type_hash:
                    yield name, key, type_hash

    def _announced(self, topic: Mapping[str, HashedEndpoint], endpoint: HashedEndpoint) -> str:
        """Return the smallest hash that endpoints of the same kind and type announce, or `NO_HASH`."""
        like = (endpoint.kind, endpoint.type_name)
        others = (end for key, end in topic.items() if key not in self._keys and (end.kind, end.type_name) == like)
        return min((end.type_hash for end in others if end.type_hash != UNKNOWN_HASH), default=NO_HASH)

    def foreign(self, endpoints: Mapping[str, HashedEndpoint]) -> dict[KindOfEndpoint, bool]:
        """Return the kinds of endpoint that other sessions announce without a hash, and whether one is latched."""
        kinds: dict[KindOfEndpoint, bool] = {}
        for end in (endpoints[key] for key in self._keys):
            if not end.own:
                kind = end.kind, end.topic, end.type_name
                kinds[kind] = kinds.get(kind, False) or end.qos.latched
        return kinds
