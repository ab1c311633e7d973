"""The type hashes of one graph's endpoints, for topics with several hashes and endpoints that announce none.

An endpoint without a hash, such as those of Humble, may use any version of its type, so the graph assumes the version
that other endpoints of its kind announce. Otherwise the hash remains `NO_HASH`, and readers of the graph use the
installed definition.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Protocol

from bridge.hub.graph.tokens import UNKNOWN_HASH, EndpointKind
from bridge.hub.wire.keys import NO_HASH
from bridge.hub.wire.qos import Qos


class HashedEndpoint(Protocol):
    """The properties of an endpoint that determine its hash."""

    @property
    def kind(self) -> EndpointKind: ...

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
    def qos(self) -> Qos: ...

    @property
    def own(self) -> bool:
        """Whether it belongs to this session."""


KindOfEndpoint = tuple[EndpointKind, str, str]
"""Kind, topic or service, and type of an endpoint."""


class TypeHashes:
    """The type hashes in one graph. Not thread-safe: the lock of the graph guards them.

    Attributes:
        version: a number that changes when another session's endpoint without a hash, or any endpoint of a topic and
            type with several hashes, appears or leaves.
    """

    def __init__(self) -> None:
        self.version = 0
        self._counts: dict[tuple[str, str], Counter[str]] = {}
        self._keys: set[str] = set()
        self._changed: set[str] = set()

    def add(self, key: str, endpoint: HashedEndpoint) -> None:
        """Add an endpoint, identified by its token."""
        type_hash = endpoint.type_hash
        if type_hash == NO_HASH:
            self._keys.add(key)
        if type_hash != UNKNOWN_HASH:
            counts = self._counts.setdefault((endpoint.topic, endpoint.type_name), Counter())
            counts[type_hash] += 1
            self.version += len(counts) > 1 or (type_hash == NO_HASH and not endpoint.own)
        if self._keys:
            self._changed.add(endpoint.topic)

    def remove(self, key: str, endpoint: HashedEndpoint, *, last: bool) -> None:
        """Remove an endpoint; ``last``: whether it was the topic's only endpoint."""
        type_hash = self.announced_hash(key, endpoint)
        self._keys.discard(key)
        name = endpoint.topic, endpoint.type_name
        if type_hash != UNKNOWN_HASH:
            counts = self._counts[name]
            self.version += len(counts) > 1 or (type_hash == NO_HASH and not endpoint.own)
            counts[type_hash] -= 1
            if not counts[type_hash]:
                del counts[type_hash]
            if not counts:
                del self._counts[name]
        if last:
            self._changed.discard(endpoint.topic)
        elif self._keys:
            self._changed.add(endpoint.topic)

    def pop_resolved(self, topics: Mapping[str, Mapping[str, HashedEndpoint]]) -> Iterator[tuple[str, str, str]]:
        """Yield topic, token and new hash of each endpoint that changed, given all endpoints by topic and token."""
        changed, self._changed = self._changed, set()
        for name in changed:
            topic = topics.get(name, {})
            for key in self._keys & topic.keys():
                type_hash = self._assumed(topic, topic[key])
                if type_hash != topic[key].type_hash:
                    yield name, key, type_hash

    def _assumed(self, topic: Mapping[str, HashedEndpoint], endpoint: HashedEndpoint) -> str:
        """Return the smallest hash that endpoints of the same kind and type announce, or `NO_HASH`."""
        like = (endpoint.kind, endpoint.type_name)
        others = (end for key, end in topic.items() if key not in self._keys and (end.kind, end.type_name) == like)
        return min((end.type_hash for end in others if end.type_hash != UNKNOWN_HASH), default=NO_HASH)

    def announced_hash(self, key: str, endpoint: HashedEndpoint) -> str:
        """Return the hash that an endpoint's token announces, or `NO_HASH`."""
        return NO_HASH if key in self._keys else endpoint.type_hash

    def foreign_hashes(self, wanted: KindOfEndpoint, topic: Mapping[str, HashedEndpoint]) -> dict[str, bool]:
        """Return the hashes that other sessions announce for a kind of endpoint, each with whether any is latched."""
        hashes: dict[str, bool] = {}
        for key, end in topic.items():
            type_hash = self.announced_hash(key, end)
            if not end.own and (end.kind, end.topic, end.type_name) == wanted and type_hash != UNKNOWN_HASH:
                hashes[type_hash] = hashes.get(type_hash, False) or end.qos.latched
        return hashes
