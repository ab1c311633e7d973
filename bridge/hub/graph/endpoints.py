"""The nodes and endpoints of one graph, according to their liveliness tokens."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace

from bridge.hub.errors import HubWireError
from bridge.hub.graph.best_available import BestAvailable
from bridge.hub.graph.hashes import KindOfEndpoint, TypeHashes
from bridge.hub.graph.tokens import (
    BRIDGE_ENCLAVE,
    EndpointKind,
    EndpointToken,
    NodeToken,
    Origin,
    gid_of,
    has_buffers,
    qos_text,
)
from bridge.hub.wire.keys import NO_HASH
from bridge.hub.wire.qos import Qos, unknown_policies

_log = logging.getLogger(__name__)

_MAX_UNKNOWN = 100
"""Maximum number of unknown QoS policies that one graph reports, each once."""


@dataclass(frozen=True, slots=True)
class HubNode:
    """A node on the hub; ``origin`` is None if the node is native, or its origin is not known yet."""

    zid: str
    node: str
    namespace: str
    origin: Origin | None
    own: bool


@dataclass(frozen=True, slots=True)
class HubEndpoint:
    """An endpoint on the hub.

    Attributes:
        type_name: the type's name as in ROS 2, ``std_msgs/msg/String``.
        type_hash: the announced type hash. If the endpoint announces none, the hash that others of its kind, topic and
            type announce, or `NO_HASH`; this changes with those endpoints.
        qos: the QoS, with open policies (BEST_AVAILABLE) resolved against the topic's endpoints; it changes with these.
        gid: the 16 bytes that rmw_zenoh derives from the token; a publisher's samples contain them.
        origin: the foreign network of the session, None if the endpoint is native or the origin is not known yet.
        buffers: whether it announces buffer backends; see `bridge.hub.wire.buffers`.
        hashless: whether it announces no type hash.
        pending: a bridge created it, and its origin is not known yet, so nothing from it may be bridged.
    """

    zid: str
    node: str
    namespace: str
    kind: EndpointKind
    topic: str
    type_name: str
    type_hash: str
    qos: Qos
    gid: bytes
    origin: Origin | None
    pending: bool
    own: bool
    buffers: bool = False
    hashless: bool = False

    @property
    def key_hash(self) -> str:
        """The hash in the endpoint's key, or `NO_HASH`."""
        return NO_HASH if self.hashless else self.type_hash


def origin_side(endpoint: HubEndpoint) -> str:
    """Return the side from which a hub publisher's messages come, ``zenoh`` for a native participant on the hub."""
    return "zenoh" if endpoint.origin is None else endpoint.origin.side


class EndpointTable:
    """The nodes and endpoints of one graph. Not thread-safe: the lock of the graph guards them.

    Args:
        zid: the session that reads the graph.
        max_tokens: the maximum number of nodes and endpoints.
        origins: the origin of each session that announces one, by zid; the mapping changes.
    """

    def __init__(self, zid: str, domain: int, max_tokens: int, origins: Mapping[str, Origin]) -> None:
        self._zid, self._domain, self._max_tokens, self._origins = zid, domain, max_tokens, origins
        self._nodes: dict[str, NodeToken] = {}
        self._endpoints: dict[str, HubEndpoint] = {}
        self._topics: dict[str, dict[str, HubEndpoint]] = {}
        self._sessions: dict[str, dict[str, None]] = {}
        self._bridged: set[str] = set()
        self._best_available = BestAvailable()
        self._hashes = TypeHashes()
        self._buffered = 0
        self._unknown: set[str] = set()
        self.zids: dict[bytes, str] = {}
        """The session of each endpoint, by GID."""

    @property
    def variants_version(self) -> int:
        """A number that changes when `other_hashes` changes, or a new publisher with buffers appears."""
        return self._hashes.version + self._buffered

    @property
    def has_buffers(self) -> bool:
        """Whether any publisher of another session has announced buffer backends."""
        return bool(self._buffered)

    def nodes(self) -> list[HubNode]:
        """Return all nodes, including those of this session."""
        return [
            HubNode(token.zid, token.node, token.namespace, self._origins.get(token.zid), token.zid == self._zid)
            for token in self._nodes.values()
        ]

    def endpoints(self, topic: str | None = None) -> list[HubEndpoint]:
        """Return all endpoints, or those of one topic or service, including those of this session."""
        self._resolve()
        known = self._endpoints if topic is None else self._topics.get(topic, {})
        return list(known.values())

    def other_hashes(self, wanted: KindOfEndpoint) -> dict[str, bool]:
        """Return the type hashes, or `NO_HASH`, that other sessions announce for a kind of endpoint.

        The value is whether an endpoint with this hash is latched.
        """
        self._resolve()
        return self._hashes.foreign_hashes(wanted, self._topics.get(wanted[1], {}))

    def add(self, key: str, token: NodeToken | EndpointToken) -> bool:
        """Add a node or an endpoint; return False if it is known already. Raises `HubWireError` above the limit."""
        owner = token if isinstance(token, NodeToken) else token.owner
        if owner.domain != self._domain or key in self._nodes or key in self._endpoints:
            return False
        if len(self._nodes) + len(self._endpoints) >= self._max_tokens:
            raise HubWireError(f"more than {self._max_tokens} tokens")
        self._sessions.setdefault(owner.zid, {})[key] = None
        if isinstance(token, NodeToken):
            self._nodes[key] = token
            return True
        if owner.enclave == BRIDGE_ENCLAVE:
            self._bridged.add(key)
        gid = gid_of(key)
        self.zids[gid] = owner.zid
        name = token.topic, token.type_name, token.type_hash
        place = owner.zid, owner.node, owner.namespace, token.kind
        is_own = owner.zid == self._zid
        buffers, hashless = has_buffers(key), token.type_hash == NO_HASH
        endpoint = HubEndpoint(*place, *name, token.qos, gid, None, False, is_own, buffers, hashless)
        self._buffered += buffers and token.kind is EndpointKind.PUBLISHER and not is_own
        self._warn_of_unknown(key, endpoint)
        self._best_available.add(key, token.topic, token.qos)
        self._place(key, endpoint)
        self._hashes.add(key, endpoint)
        return True

    def remove(self, key: str) -> bool:
        """Remove a node or an endpoint; return whether it was known."""
        endpoint = self._endpoints.pop(key, None)
        known = endpoint or self._nodes.pop(key, None)
        if known is None:
            return False
        if endpoint is not None:
            self._bridged.discard(key)
            self.zids.pop(endpoint.gid, None)
            topic = self._topics[endpoint.topic]
            del topic[key]
            if not topic:
                del self._topics[endpoint.topic]
            self._best_available.remove(key, endpoint.topic, last=not topic)
            self._hashes.remove(key, endpoint, last=not topic)
        keys = self._sessions[known.zid]
        del keys[key]
        if not keys:
            del self._sessions[known.zid]
        return True

    def settle(self, zid: str) -> None:
        """Set the origin of a session's endpoints to the session's new origin."""
        for key in self._sessions.get(zid, ()):
            endpoint = self._endpoints.get(key)
            if endpoint is not None:
                self._place(key, endpoint)

    def _place(self, key: str, endpoint: HubEndpoint) -> None:
        origin = self._origins.get(endpoint.zid)
        endpoint = replace(endpoint, origin=origin, pending=origin is None and key in self._bridged)
        self._endpoints[key] = endpoint
        self._topics.setdefault(endpoint.topic, {})[key] = endpoint

    def _resolve(self) -> None:
        for name, key, qos in self._best_available.pop_resolved(self._topics):
            self._endpoints[key] = self._topics[name][key] = replace(self._endpoints[key], qos=qos)
        for name, key, type_hash in self._hashes.pop_resolved(self._topics):
            self._endpoints[key] = self._topics[name][key] = replace(self._endpoints[key], type_hash=type_hash)

    def _warn_of_unknown(self, key: str, endpoint: HubEndpoint) -> None:
        """Report each unknown policy once, regardless of how many endpoints have it."""
        for policy in unknown_policies(qos_text(key)):
            if policy not in self._unknown and len(self._unknown) < _MAX_UNKNOWN:
                self._unknown.add(policy)
                _log.warning("%.200s, %s of node %.100s: %s", endpoint.topic, endpoint.kind, endpoint.node, policy)
