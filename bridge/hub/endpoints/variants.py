"""Key variants: additional keys of endpoints, one for each other type hash that peers on the same topic announce.

A key ends with the hash of its type (`bridge.hub.wire.keys`), which differs between releases of ROS 2. An endpoint uses
the key with its own hash, and the keys with the other hashes of its counterparts: subscriptions for a publisher,
publishers for a subscription, servers for a client. At present `NO_HASH` (Humble) is the only other hash. A publisher
or subscription uses a variant while the graph has such a counterpart. Subscriptions also have the key of the CPU group
(`bridge.hub.wire.buffers`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Lock
from typing import Protocol

from bridge.concurrency import SerialExecutor
from bridge.hub.graph import HubGraph
from bridge.hub.graph.hashes import KindOfEndpoint
from bridge.hub.graph.tokens import UNKNOWN_HASH, EndpointKind, EndpointToken, parse_token
from bridge.hub.wire.keys import NO_HASH

Variants = Mapping[str, bool]
"""The other hashes that the counterparts of an endpoint announce, and whether any of these is latched."""

_log = logging.getLogger(__name__)
_COUNTERPARTS = {
    EndpointKind.PUBLISHER: EndpointKind.SUBSCRIPTION,
    EndpointKind.SUBSCRIPTION: EndpointKind.PUBLISHER,
    EndpointKind.CLIENT: EndpointKind.SERVER,
}


class VariedEndpoint(Protocol):
    """An endpoint with key variants."""

    def follow_variants(self, variants: Variants) -> None:
        """Add and remove keys; called by one thread at a time, also after the endpoint has closed. It may block."""


@dataclass(frozen=True, slots=True)
class _Followed:
    """An endpoint's counterpart, None if its key covers all hashes, and the lock that serializes its updates."""

    topic: str
    counterpart: KindOfEndpoint | None
    updating: Lock = field(default_factory=Lock)


class KeyVariants:
    """Updates the key variants of one node's endpoints when the graph changes. Safe to use from any thread.

    The updates run on the executor, since zenoh's thread, which reports the tokens, must not block. No lock is held
    for all endpoints meanwhile: an update may wait for a congested link, and new endpoints must not wait for it.
    """

    def __init__(self, graph: HubGraph, executor: SerialExecutor) -> None:
        self._graph, self._executor = graph, executor
        self._endpoints: dict[VariedEndpoint, _Followed] = {}
        self._lock = Lock()
        self._version = 0
        self.close: Callable[[], None] = graph.watch(self._graph_changed)

    def add(self, endpoint: VariedEndpoint, token: str) -> None:
        """Add an endpoint's key variants, before its token announces it; then follow the graph."""
        about = parse_token(token)
        assert isinstance(about, EndpointToken)
        covered = about.type_hash in (NO_HASH, UNKNOWN_HASH)  # the latter's key covers all hashes
        counterpart = None if covered else (_COUNTERPARTS[about.kind], about.topic, about.type_name)
        followed = _Followed(about.topic, counterpart)
        with self._lock:
            self._endpoints[endpoint] = followed
        self._update(endpoint, followed)

    def remove(self, endpoint: VariedEndpoint) -> None:
        """Stop updating an endpoint; does not wait for an update of it."""
        with self._lock:
            self._endpoints.pop(endpoint, None)

    def _graph_changed(self) -> None:
        version = self._graph.variants_version
        if version != self._version:
            self._version = version
            self._executor.submit(self._follow)

    def _follow(self) -> None:
        with self._lock:
            endpoints = tuple(self._endpoints.items())
        for endpoint, followed in endpoints:
            try:
                self._update(endpoint, followed)
            except Exception as err:  # the next change of the graph repeats it
                _log.warning("%s: cannot update the keys for other releases: %s", followed.topic, err)

    def _update(self, endpoint: VariedEndpoint, followed: _Followed) -> None:
        with followed.updating:
            hashless, counterpart = self._graph.hashless(), followed.counterpart
            latched = None if counterpart is None else hashless.get(counterpart)
            endpoint.follow_variants({} if latched is None else {NO_HASH: latched})
