"""The hub's graph as this session sees it: nodes, endpoints and origins, from the liveliness tokens of all sessions."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Lock

import zenoh

from bridge.hub.errors import HubWireError
from bridge.hub.graph.best_available import BestAvailable
from bridge.hub.graph.hashes import KindOfEndpoint, TypeHashes
from bridge.hub.graph.tokens import (
    ADMIN_SPACE,
    BRIDGE_ENCLAVE,
    MIDSPAN_SPACE,
    EndpointKind,
    EndpointToken,
    NodeToken,
    Origin,
    gid_of,
    has_buffers,
    member_key,
    parse_member,
    parse_origin,
    parse_token,
    parse_velocity,
    parse_wire,
    qos_text,
    velocity_key,
)
from bridge.hub.wire.keys import NO_HASH
from bridge.hub.wire.qos import Qos, unknown_policies
from bridge.hub.wire.version import refusal
from bridge.hub.zenoh_compat import follow_tokens, undeclare

_log = logging.getLogger(__name__)

_MAX_UNKNOWN = 100
"""Unknown QoS policies that one graph reports, each once."""


@dataclass(frozen=True, slots=True)
class HubNode:
    """A node on the hub."""

    zid: str
    node: str
    namespace: str
    origin: Origin | None
    own: bool


@dataclass(frozen=True, slots=True)
class HubEndpoint:
    """An endpoint on the hub.

    Attributes:
        type_name: as ROS 2 spells it, ``std_msgs/msg/String``.
        type_hash: of an endpoint that announces none, the hash that others of its kind, topic and type announce, or
            `NO_HASH`; it changes with these.
        qos: with open policies (BEST_AVAILABLE) resolved against the topic's endpoints; it changes with these.
        gid: the 16 bytes that rmw_zenoh derives from the token; a publisher's samples carry them.
        origin: the foreign network of the session, None if the endpoint is native or the origin is not known yet.
        buffers: it announces backends of buffers; see `bridge.hub.wire.buffers`.
        hashless: it announces no type hash.
        pending: a bridge made it, and its origin is not known (yet): nothing of it may cross.
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


def origin_side(endpoint: HubEndpoint) -> str:
    """The side that a hub publisher's messages come from, ``zenoh`` for a native participant of the hub."""
    return "zenoh" if endpoint.origin is None else endpoint.origin.side


class HubGraph:
    """Nodes, endpoints and origins. Safe to use from any thread.

    Attributes:
        epoch: another object after each token that appears or disappears.
        refused: number of tokens left out because they are malformed or too many.
        trouble: the reason for the last of them.
    """

    def __init__(self, session: zenoh.Session, domain: int, max_tokens: int) -> None:
        self._zid = str(session.zid())
        self._domain = domain
        self._max_tokens = max_tokens
        self._member_space = f"{MIDSPAN_SPACE}/{domain}/member/"
        self._lock = Lock()
        self._nodes: dict[str, NodeToken] = {}
        self._endpoints: dict[str, HubEndpoint] = {}
        self._marked: set[str] = set()
        self._topics: dict[str, dict[str, HubEndpoint]] = {}
        self._best_available = BestAvailable()
        self._hashes = TypeHashes()
        self._buffered = 0
        self._unknown: set[str] = set()
        self._sessions: dict[str, dict[str, None]] = {}
        self._origin_tokens: dict[str, dict[str, Origin]] = {}
        self._origins: dict[str, Origin] = {}
        self._members: dict[str, dict[str, None]] = {}
        self._velocities: set[tuple[str, str, str]] = set()
        self._strangers: set[str] = set()
        self._zids: dict[bytes, str] = {}
        self._own: dict[str, zenoh.LivelinessToken] = {}
        self._watches: dict[object, Callable[[], None]] = {}
        self.epoch = object()
        self.refused = 0
        self.trouble = ""
        self._liveliness = session.liveliness()
        origins, members = f"{MIDSPAN_SPACE}/{domain}/origin/**", f"{MIDSPAN_SPACE}/{domain}/member/**"
        self._wire_space = f"{MIDSPAN_SPACE}/{domain}/wire/"
        self._velocity_space = f"{MIDSPAN_SPACE}/{domain}/velocity/"
        midspan = (f"{self._wire_space}**", origins, members, f"{self._velocity_space}**")
        spaces = (*midspan, f"{ADMIN_SPACE}/{domain}/**")
        self._subscribers = [follow_tokens(session, space, self._on_sample) for space in spaces]

    def endpoints(self) -> list[HubEndpoint]:
        """All endpoints, this session's own among them."""
        with self._lock:
            self._resolve()
            return list(self._endpoints.values())

    def endpoint(self, gid: bytes) -> HubEndpoint | None:
        """Return the endpoint with this GID, None if it is unknown; too slow to call for each sample."""
        return next((endpoint for endpoint in self.endpoints() if endpoint.gid == gid), None)

    def publishers(self, topic: str | None = None) -> list[HubEndpoint]:
        """All publishers, or those of one topic."""
        return self._of_kind(EndpointKind.PUBLISHER, topic)

    def subscriptions(self, topic: str | None = None) -> list[HubEndpoint]:
        """All subscriptions, or those of one topic."""
        return self._of_kind(EndpointKind.SUBSCRIPTION, topic)

    def servers(self, name: str | None = None) -> list[HubEndpoint]:
        """All servers, or those of one service."""
        return self._of_kind(EndpointKind.SERVER, name)

    def clients(self, name: str | None = None) -> list[HubEndpoint]:
        """All clients, or those of one service."""
        return self._of_kind(EndpointKind.CLIENT, name)

    def nodes(self) -> list[HubNode]:
        """All nodes, this session's own among them."""
        with self._lock:
            return [
                HubNode(token.zid, token.node, token.namespace, self._origins.get(token.zid), token.zid == self._zid)
                for token in self._nodes.values()
            ]

    def origins(self) -> dict[str, Origin]:
        """The origin of each session that announces one, by zid."""
        with self._lock:
            return dict(self._origins)

    def members(self) -> dict[str, frozenset[str]]:
        """The members of the foreign network of each session that carries messages, as it announces them; by zid."""
        with self._lock:
            return {zid: frozenset(members) for zid, members in self._members.items()}

    def announce_member(self, member: str) -> Callable[[], None]:
        """Announce that another session's worker is on our foreign network, until the returned function is called."""
        return self.announce(member_key(self._domain, self._zid, member))

    def velocities(self) -> list[tuple[str, str, str]]:
        """Session (zid), hub topic and type of each topic of velocities that a side's own nodes subscribe to."""
        with self._lock:
            return sorted(self._velocities)

    def announce_velocity(self, topic: str, type_name: str) -> Callable[[], None]:
        """Announce that our side's own nodes subscribe to velocities, until the returned function is called."""
        return self.announce(velocity_key(self._domain, self._zid, topic, type_name))

    @property
    def variants_version(self) -> int:
        """A number that changes with each change of `other_hashes`, and each new publisher with buffers."""
        return self._hashes.version + self._buffered

    def has_buffers(self, topic: str, type_name: str) -> bool:
        """Return whether another session's publisher of this topic and type announces backends of buffers."""
        publishers = self.publishers(topic) if self._buffered else ()
        return any(end.buffers and end.type_name == type_name and not end.own for end in publishers)

    def other_hashes(self, wanted: KindOfEndpoint) -> dict[str, bool]:
        """Return the type hashes, or `NO_HASH`, that other sessions announce for a kind of endpoint.

        The value is whether an endpoint with this hash is latched.
        """
        with self._lock:
            self._resolve()
            return self._hashes.foreign(wanted, self._topics.get(wanted[1], {}))

    def origin_of(self, zid: str) -> Origin | None:
        """Return a session's origin. Fast enough to call for each sample."""
        return self._origins.get(zid)

    def zid_of(self, gid: bytes) -> str:
        """Return the session of the endpoint with this GID, "" if it is unknown."""
        return self._zids.get(gid, "")

    def watch(self, callback: Callable[[], None]) -> Callable[[], None]:
        """Call ``callback`` after each change, until the returned function is called.

        It runs on zenoh's thread, so it must only set a flag and wake another thread.
        """
        watch = object()
        self._watches[watch] = callback

        def close() -> None:
            self._watches.pop(watch, None)

        return close

    def catch_up(self, seconds: float) -> None:
        """Wait, in a zenoh client, until the router has sent all tokens that it had at the time of the call.

        The router answers in order. The key asked for does not exist, and this session does not watch it, because
        zenoh would answer for a watched one itself.
        """
        for _ in self._liveliness.get(f"{MIDSPAN_SPACE}/{self._domain}/told/{self._zid}", timeout=seconds):
            pass

    def close(self) -> None:
        """Stop watching tokens. Safe to call twice."""
        self._watches.clear()
        undeclare(*self._subscribers)
        self._subscribers.clear()

    def _of_kind(self, kind: EndpointKind, topic: str | None) -> list[HubEndpoint]:
        with self._lock:
            self._resolve()
            known = self._endpoints if topic is None else self._topics.get(topic, {})
            return [endpoint for endpoint in known.values() if endpoint.kind is kind]

    def announce(self, key: str) -> Callable[[], None]:
        """Declare a token of this session's own, until the returned function is called."""
        self._own[key] = self._liveliness.declare_token(key)
        # not read back from zenoh, which drops a client's tokens when it loses its router
        with self._lock:
            changed = self._put_token(key)
        self._notify(changed)

        def withdraw() -> None:
            with self._lock:
                changed = self._delete_token(key)
                token = self._own.pop(key, None)
            if token is not None:
                undeclare(token)
            self._notify(changed)

        return withdraw

    def _on_sample(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if f"/{self._zid}/" in key:
            return
        with self._lock:
            changed = self._delete_token(key) if sample.kind == zenoh.SampleKind.DELETE else self._put_token(key)
        self._notify(changed)

    def _put_token(self, key: str) -> bool:
        try:
            if not key.startswith(MIDSPAN_SPACE):
                return self._learn(key, parse_token(key))
            if key.startswith(self._member_space):
                return self._put_member(key, *parse_member(key))
            if key.startswith(self._velocity_space):
                return self._put_velocity(key, parse_velocity(key))
            if key.startswith(self._wire_space):
                return self._put_wire(key, *parse_wire(key))
            token = parse_origin(key)
        except HubWireError as err:
            self._refuse(key, str(err))
            return False
        if token.zid not in self._origin_tokens and len(self._origin_tokens) >= self._max_tokens:
            self._refuse(key, f"more than {self._max_tokens} origins")
            return False
        tokens = self._origin_tokens.setdefault(token.zid, {})
        # the newest of a session's origins is valid; the token that it replaces is removed right after
        tokens.pop(key, None)
        tokens[key] = token.origin
        self._settle(token.zid, token.origin)
        return True

    def _delete_token(self, key: str) -> bool:
        if not key.startswith(MIDSPAN_SPACE):
            return self._remove(key)
        try:
            if key.startswith(self._member_space):
                return self._delete_member(*parse_member(key))
            if key.startswith(self._velocity_space):
                return self._delete_velocity(parse_velocity(key))
            if key.startswith(self._wire_space):
                return self._delete_wire(parse_wire(key)[0])
            zid = parse_origin(key).zid
        except HubWireError:
            return False
        tokens = self._origin_tokens.get(zid, {})
        if tokens.pop(key, None) is None:
            return False
        if tokens:
            self._settle(zid, next(reversed(tokens.values())))
        else:
            del self._origin_tokens[zid]
            self._settle(zid, None)
        return True

    def _put_member(self, key: str, zid: str, member: str) -> bool:
        if sum(map(len, self._members.values())) >= self._max_tokens:
            self._refuse(key, f"more than {self._max_tokens} members of networks")
            return False
        self._members.setdefault(zid, {})[member] = None
        return True

    def _delete_member(self, zid: str, member: str) -> bool:
        members = self._members.get(zid, {})
        if member not in members:
            return False
        del members[member]
        if not members:
            del self._members[zid]
        return True

    def _put_velocity(self, key: str, velocity: tuple[str, str, str]) -> bool:
        if len(self._velocities) >= self._max_tokens:
            self._refuse(key, f"more than {self._max_tokens} topics of velocities")
            return False
        self._velocities.add(velocity)
        return True

    def _delete_velocity(self, velocity: tuple[str, str, str]) -> bool:
        known = velocity in self._velocities
        self._velocities.discard(velocity)
        return known

    def _put_wire(self, key: str, zid: str, version: str, release: str) -> bool:
        """Endpoints of a session with an incompatible version stay of unknown origin."""
        reason = refusal(version)
        if not reason or zid in self._strangers:
            return False
        if len(self._strangers) >= self._max_tokens:
            self._refuse(key, f"more than {self._max_tokens} versions")
            return False
        self._strangers.add(zid)
        _log.warning("a Midspan %.40s on the hub is refused, session %s: %s", release, zid, reason)
        self._settle(zid, None)
        return True

    def _delete_wire(self, zid: str) -> bool:
        if zid not in self._strangers:
            return False
        self._strangers.remove(zid)
        tokens = self._origin_tokens.get(zid)
        self._settle(zid, next(reversed(tokens.values())) if tokens else None)
        return True

    def _settle(self, zid: str, origin: Origin | None) -> None:
        if origin is None or zid in self._strangers:
            self._origins.pop(zid, None)
        else:
            self._origins[zid] = origin
        for key in self._sessions.get(zid, ()):
            endpoint = self._endpoints.get(key)
            if endpoint is not None:
                self._place(key, endpoint)

    def _learn(self, key: str, token: NodeToken | EndpointToken) -> bool:
        owner = token if isinstance(token, NodeToken) else token.owner
        if owner.domain != self._domain or key in self._nodes or key in self._endpoints:
            return False
        if len(self._nodes) + len(self._endpoints) >= self._max_tokens:
            self._refuse(key, f"more than {self._max_tokens} tokens")
            return False
        self._sessions.setdefault(owner.zid, {})[key] = None
        if isinstance(token, NodeToken):
            self._nodes[key] = token
            return True
        if owner.enclave == BRIDGE_ENCLAVE:
            self._marked.add(key)
        gid = gid_of(key)
        self._zids[gid] = owner.zid
        name = token.topic, token.type_name, token.type_hash
        place = owner.zid, owner.node, owner.namespace, token.kind
        is_own = owner.zid == self._zid
        buffers, hashless = has_buffers(key), token.type_hash == NO_HASH
        endpoint = HubEndpoint(*place, *name, token.qos, gid, None, False, is_own, buffers, hashless)
        self._buffered += buffers and token.kind is EndpointKind.PUBLISHER and not is_own
        self._warn_of_unknown(key, endpoint)
        self._best_available.added(key, token.topic, token.qos)
        self._place(key, endpoint)
        self._hashes.added(key, endpoint)
        return True

    def _place(self, key: str, endpoint: HubEndpoint) -> None:
        origin = self._origins.get(endpoint.zid)
        endpoint = replace(endpoint, origin=origin, pending=origin is None and key in self._marked)
        self._endpoints[key] = endpoint
        self._topics.setdefault(endpoint.topic, {})[key] = endpoint

    def _resolve(self) -> None:
        for name, key, qos in self._best_available.resolved(self._topics):
            self._endpoints[key] = self._topics[name][key] = replace(self._endpoints[key], qos=qos)
        for name, key, type_hash in self._hashes.resolved(self._topics):
            self._endpoints[key] = self._topics[name][key] = replace(self._endpoints[key], type_hash=type_hash)

    def _warn_of_unknown(self, key: str, endpoint: HubEndpoint) -> None:
        """Report each unknown policy once, however many endpoints have it."""
        for policy in unknown_policies(qos_text(key)):
            if policy not in self._unknown and len(self._unknown) < _MAX_UNKNOWN:
                self._unknown.add(policy)
                _log.warning("%.200s, %s of node %.100s: %s", endpoint.topic, endpoint.kind, endpoint.node, policy)

    def _remove(self, key: str) -> bool:
        endpoint = self._endpoints.pop(key, None)
        known = endpoint or self._nodes.pop(key, None)
        if known is None:
            return False
        if endpoint is not None:
            self._marked.discard(key)
            self._zids.pop(endpoint.gid, None)
            topic = self._topics[endpoint.topic]
            del topic[key]
            if not topic:
                del self._topics[endpoint.topic]
            self._best_available.removed(key, endpoint.topic, last=not topic)
            self._hashes.removed(key, endpoint, last=not topic)
        keys = self._sessions[known.zid]
        del keys[key]
        if not keys:
            del self._sessions[known.zid]
        return True

    def _refuse(self, key: str, why: str) -> None:
        level = logging.DEBUG if self.refused else logging.WARNING
        self.refused += 1
        self.trouble = f"{why}: {key:.100}"
        _log.log(level, "liveliness token left out, %s: %.200s", why, key)

    def renew(self) -> None:
        """Begin a new epoch: another session may have declared subscribers."""
        self.epoch = object()

    def _notify(self, changed: bool) -> None:
        self.renew()
        if changed:
            for callback in tuple(self._watches.values()):
                callback()
